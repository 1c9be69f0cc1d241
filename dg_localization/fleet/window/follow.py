# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""State between estimates: numbers of hypotheses, forgotten observations, earlier pose sets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain, count
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.contradictions.suspects import Record
from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind, Placement
from dg_localization.fleet.frames.odometry_frame import StandingFrame
from dg_localization.fleet.rotations import best_rotation
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import also_forgotten, left_out_until_s
from dg_localization.fleet.window.memory import Ends, Spans
from dg_localization.fleet.window.proved import Proved, chain_seconds

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Framed:
    """A placement and the frame of its coordinates."""

    placement: Placement
    frame: FixedFrame | None


class Follower:
    """
    The state that one estimate leaves to the next.

    Each estimate changes its own copy, so that an estimate that fails, or is overtaken by a later
    one, leaves nothing half done.

    Parameters
    ----------
    numbers : iterator of int, optional
        The numbers of new hypotheses, shared by all copies.
    frame : FixedFrame, optional
        The frame of the estimate before.

    Attributes
    ----------
    forgotten : mapping of (str, str) to tuple of (float, float)
        Spans of forgotten observations.
    left_out : mapping of (str, str) to float
        Times up to which observations are left out of the measurements of the moment.
    earlier : EarlierSets
        Pose sets that are carried from estimate to estimate.

    """

    def __init__(
        self, numbers: Iterator[int] | None = None, frame: FixedFrame | None = None
    ) -> None:
        self._numbers = count(1) if numbers is None else numbers
        self._frame = frame
        # The numbered placements of the last estimate, and its time.
        self._last: tuple[Framed, ...] = ()
        self._last_s = 0.0
        self.forgotten: Spans = {}
        self.left_out: Mapping[Ends, float] = {}
        self._proved: tuple[Proved, ...] = ()
        self._standing_frame = StandingFrame()
        self._frame_changes = 0
        self._record = Record()
        self.earlier = EarlierSets()

    def started_anew(self) -> Follower:
        """Return a follower without hypotheses; their numbers are not used again."""
        return Follower(self._numbers, self._frame)

    def copied(self) -> Follower:
        """Return an independent copy."""
        other = copy(self)
        other._standing_frame, other._record = copy(self._standing_frame), copy(self._record)
        other.earlier = self.earlier.copied()
        return other

    def proved_for(self, snapshot: Snapshot) -> tuple[Proved, ...]:
        """Return the proved bounds of the estimate before, unless too old or in the future."""
        longest_s = chain_seconds(snapshot.config)
        return tuple(
            proved
            for proved in self._proved
            if proved.stamp_s <= snapshot.stamp_s <= proved.since_s + longest_s
        )

    def forget(self, snapshot: Snapshot, estimate: Estimate) -> None:
        """
        Forget the observations that an estimate names.

        This also holds for a cancelled estimate: its sets have been carried on.
        """
        oldest_s = snapshot.stamp_s - snapshot.config.memory_s
        if self._last_s > snapshot.stamp_s:
            # The clock was set back: these times mean nothing any more.
            self.forgotten, self.left_out = {}, {}
        self.forgotten = also_forgotten(self.forgotten, estimate.forgotten, oldest_s)
        self.left_out = left_out_until_s(self.left_out, estimate.forgotten)
        self.earlier.forget(snapshot.config, estimate.forgotten)
        if estimate.forgotten:
            # Proved bounds may rest on the forgotten observations.
            self._proved = ()

    def follow(
        self, snapshot: Snapshot, estimate: Estimate, proved: tuple[Proved, ...]
    ) -> Estimate:
        """
        Return an estimate that continues the one before, and keep its proved bounds.

        The hypotheses get their numbers, and a change of the frame is announced.
        """
        suspected = estimate.suspected_sensors, estimate.suspects_in_window
        self._record.add(snapshot.stamp_s, snapshot.config.memory_s, *suspected)
        estimate = replace(estimate, offenders=self._record.offenders())
        estimate = self._standing_frame.turn(snapshot, self._numbered(snapshot, estimate))
        self._proved = proved
        for one in _listed(estimate):
            one.placement.protect()
        if estimate.frame is None:
            return estimate
        previous, self._frame = self._frame, estimate.frame
        changed = previous is not None and previous != estimate.frame
        self._frame_changes += changed
        return replace(
            estimate,
            previous_frame=previous if changed else None,
            frame_changes=self._frame_changes,
        )

    def _numbered(self, snapshot: Snapshot, estimate: Estimate) -> Estimate:
        """Return an estimate with numbers for its hypotheses."""
        listed = _listed(estimate)
        pairs = matches(snapshot, self._last_s, self._last, listed)
        numbered = []
        for row, one in enumerate(listed):
            known = self._last[pairs[row]].placement.number if row in pairs else None
            number = next(self._numbers) if known is None else known
            numbered.append(replace(one, placement=replace(one.placement, number=number)))
        self._last, self._last_s = tuple(numbered), snapshot.stamp_s
        return _with_placements(estimate, [one.placement for one in numbered])


def _listed(estimate: Estimate) -> list[Framed]:
    """Return the placements of an estimate, followed by the placements of its groups."""
    groups = (
        (Framed(placement, group.frame) for placement in group.placements)
        for group in estimate.groups
    )
    main = (Framed(placement, estimate.frame) for placement in estimate.placements)
    return [*main, *chain.from_iterable(groups)]


def _with_placements(estimate: Estimate, placements: list[Placement]) -> Estimate:
    """Return an estimate with replaced placements, in the order of `_listed`."""
    rest = iter(placements)
    main = tuple(next(rest) for _ in estimate.placements)
    groups = tuple(
        replace(group, placements=tuple(next(rest) for _ in group.placements))
        for group in estimate.groups
    )
    return replace(estimate, placements=main, groups=groups)


def matches(
    snapshot: Snapshot, before_s: float, before: Sequence[Framed], now: Sequence[Framed]
) -> dict[int, int]:
    """
    Match placements with the earlier placements that they continue.

    Two placements can belong to one hypothesis if their distances agree within the greatest motion
    of the robots. Of these, the placements whose positions differ least are matched. Positions are
    compared in the frame of the anchors only. Any other frame moves with the fleet: there the
    shapes are compared, and a mirror image is another shape.
    """
    moved_m = np.array(
        [
            snapshot.motion.displacement_m(robot, before_s, snapshot.stamp_s)
            for robot in snapshot.config.robots
        ]
    )
    slack_m = moved_m[:, None] + moved_m[None]
    costs_m2 = {
        (row, number): cost_m2
        for row, old in enumerate(before)
        for number, new in enumerate(now)
        if (cost_m2 := _difference_m2(old, new, slack_m)) < math.inf
    }
    found: dict[int, int] = {}
    for row, number in sorted(costs_m2, key=lambda pair: costs_m2[pair]):
        if number not in found and row not in found.values():
            found[number] = row
    return found


def _difference_m2(before: Framed, now: Framed, slack_m: FloatArray) -> float:
    """Return the mean squared difference of positions; infinite if the hypotheses differ."""
    old, new = before.placement, now.placement
    meet = (old.lower_m - slack_m <= new.upper_m) & (new.lower_m <= old.upper_m + slack_m)
    placed = [np.isfinite(one.positions_m).all(axis=1) for one in (old, new)]
    shared = placed[0] & placed[1]
    # They share at least two robots, or all robots of one of them.
    fewest = min(int(one.sum()) for one in placed)
    if not meet.all() or shared.sum() < min(max(fewest, 1), 2):
        return math.inf
    first_m, second_m = old.positions_m[shared], new.positions_m[shared]
    is_at_rest = now.frame is not None and now.frame.kind is FrameKind.ANCHORS
    if not (is_at_rest and before.frame == now.frame):
        first_m, second_m = first_m - first_m.mean(axis=0), second_m - second_m.mean(axis=0)
        first_m = first_m @ best_rotation(first_m, second_m).T
    return float(((first_m - second_m) ** 2).sum(axis=1).mean())
