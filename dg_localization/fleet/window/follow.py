# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From one estimate to the next: hypotheses keep their numbers, what is forgotten stays so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain, count

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.contradictions.suspects import Record
from dg_localization.fleet.estimate import Estimate, FixedFrame, FrameKind, Placement
from dg_localization.fleet.frames.odometry_frame import StandingFrame
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import also_forgotten, left_out_until_s
from dg_localization.fleet.window.memory import Ends, Spans
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import chain_seconds

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Framed:
    """A placement and the frame of its coordinates."""

    placement: Placement
    frame: FixedFrame | None


@dataclass(frozen=True)
class _Followed:
    """The placements of an estimate, numbered, and what they were found from."""

    placements: tuple[Framed, ...]
    stamp_s: float


class Follower:
    """
    What estimates leave to the next one.

    An estimate changes a copy of its own, so that one that fails, or is overtaken by a later one,
    leaves nothing half done.

    Parameters
    ----------
    memory_s : float
        As of the configuration of the fleet.
    numbers : iterator of int, optional
        Of hypotheses that are new; all copies take theirs from it.
    frame : FixedFrame, optional
        Of the estimate before.

    Attributes
    ----------
    forgotten : mapping of (str, str) to tuple of (float, float)
        Spans of observations that are not remembered.
    left_out : mapping of (str, str) to float
        Up to when observations do not count as measurements of the moment.
    earlier : EarlierSets
        Pose sets that are carried from estimate to estimate.

    """

    def __init__(
        self,
        memory_s: float,
        numbers: Iterator[int] | None = None,
        frame: FixedFrame | None = None,
    ) -> None:
        self._memory_s = memory_s
        self._numbers = count(1) if numbers is None else numbers
        self._frame = frame
        self._last = _Followed((), 0.0)
        self.forgotten: Spans = {}
        self.left_out: Mapping[Ends, float] = {}
        self._proved: tuple[Proved, ...] = ()
        self._standing_frame = StandingFrame()
        self._frame_changes = 0
        self._record = Record(memory_s)
        self.earlier = EarlierSets()

    def started_anew(self, memory_s: float | None = None) -> Follower:
        """Return one that knows no hypothesis; numbers are not used again."""
        kept_s = self._memory_s if memory_s is None else memory_s
        return Follower(kept_s, self._numbers, self._frame)

    def copied(self) -> Follower:
        """Return one that knows the same; what changes one does not change the other."""
        other = copy(self)
        other._standing_frame = copy(self._standing_frame)
        other._record = self._record.copied()
        other.earlier = self.earlier.copied()
        return other

    def proved_for(self, snapshot: Snapshot) -> tuple[Proved, ...]:
        """Return what the estimate before proved, unless that is out of memory or of later."""
        longest_s = chain_seconds(snapshot.config)
        return tuple(
            proved
            for proved in self._proved
            if proved.stamp_s <= snapshot.stamp_s <= proved.since_s + longest_s
        )

    def forget(self, snapshot: Snapshot, estimate: Estimate) -> None:
        """
        Forget what an estimate says has to be forgotten.

        That counts where an estimate was cancelled, too: its sets have gone on.
        """
        oldest_s = snapshot.stamp_s - snapshot.config.memory_s
        if self._last.stamp_s > snapshot.stamp_s:
            # The clock was set back: what is left out is of another time.
            self.forgotten, self.left_out = {}, {}
        self.forgotten = also_forgotten(self.forgotten, estimate.forgotten, oldest_s)
        self.left_out = left_out_until_s(self.left_out, estimate.forgotten)
        self.earlier.forget(snapshot.config, estimate.forgotten)
        if estimate.forgotten:
            # What was proved before may rest on what is forgotten.
            self._proved = ()

    def follow(
        self, snapshot: Snapshot, estimate: Estimate, proved: tuple[Proved, ...]
    ) -> Estimate:
        """
        Return an estimate as it goes on from the one before, and keep what it proved.

        Its hypotheses have their numbers, and a frame other than that of the estimate before is
        announced.
        """
        self._record.add(snapshot.stamp_s, estimate.suspected_sensors, estimate.suspects_in_window)
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
        """Return an estimate with the numbers of its hypotheses."""
        listed = _listed(estimate)
        before = self._last
        pairs = matches(snapshot, before.stamp_s, before.placements, listed)
        numbered = []
        for row, one in enumerate(listed):
            known = before.placements[pairs[row]].placement.number if row in pairs else None
            number = next(self._numbers) if known is None else known
            numbered.append(replace(one, placement=replace(one.placement, number=number)))
        self._last = _Followed(tuple(numbered), snapshot.stamp_s)
        return _with_placements(estimate, [one.placement for one in numbered])


def _listed(estimate: Estimate) -> list[Framed]:
    """Return the placements of an estimate, those of its groups last."""
    groups = (
        (Framed(placement, group.frame) for placement in group.placements)
        for group in estimate.groups
    )
    main = (Framed(placement, estimate.frame) for placement in estimate.placements)
    return [*main, *chain.from_iterable(groups)]


def _with_placements(estimate: Estimate, placements: list[Placement]) -> Estimate:
    """Return an estimate with other placements, those of its groups last."""
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
    Match placements with those they go on from.

    Two can be of one hypothesis where the distances of now are those of before, as far as the
    robots can have moved. Of these, positions that differ least go together, in the frame of the
    anchors. Any other frame moves with the fleet: there the shapes are compared, and a mirror
    image is another shape.
    """
    if not before or not now:
        return {}
    old_placements = [one.placement for one in before]
    new_placements = [one.placement for one in now]
    first, second = _positions(old_placements)[:, None], _positions(new_placements)[None]
    known = np.asarray(np.isfinite(first).all(axis=-1) & np.isfinite(second).all(axis=-1))
    at_rest = np.array(
        [[old.frame == new.frame and _is_at_rest(new.frame) for new in now] for old in before]
    )
    cost_m2 = np.where(at_rest, _moved_m2(first, second, known), _bent_m2(first, second, known))
    possible = _distances_agree(snapshot, before_s, old_placements, new_placements)
    cost_m2 = np.where(possible & _share_robots(first, second, known), cost_m2, np.inf)
    found: dict[int, int] = {}
    for flat in np.argsort(cost_m2, axis=None, kind='stable'):
        old, new = divmod(int(flat), len(now))
        if not np.isfinite(cost_m2[old, new]):
            break
        if new not in found and old not in found.values():
            found[new] = old
    return found


def _positions(placements: Sequence[Placement]) -> FloatArray:
    return np.stack([placement.positions_m for placement in placements])


def _distances_agree(
    snapshot: Snapshot, before_s: float, before: Sequence[Placement], now: Sequence[Placement]
) -> NDArray[np.bool_]:
    """Return which placements of before and of now, (k, m), may have the same distances."""
    moved = np.array(
        [
            snapshot.motion.displacement_m(robot, before_s, snapshot.stamp_s)
            for robot in snapshot.config.robots
        ]
    )
    slack = moved[:, None] + moved[None]
    lower = np.stack([placement.lower_m - slack for placement in before])
    upper = np.stack([placement.upper_m + slack for placement in before])
    new_lower = np.stack([placement.lower_m for placement in now])
    new_upper = np.stack([placement.upper_m for placement in now])
    meet = (lower[:, None] <= new_upper[None]) & (new_lower[None] <= upper[:, None])
    return np.asarray(meet.all(axis=(2, 3)))


def _share_robots(
    first: FloatArray, second: FloatArray, known: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which placements, (k, m), have more than one robot in common, or all of one."""
    fewest = np.minimum(_n_placed(first), _n_placed(second))
    return np.asarray(known.sum(axis=-1) >= np.clip(fewest, 1, 2))


def _n_placed(positions: FloatArray) -> NDArray[np.int_]:
    """Return how many robots have a position in each placement."""
    return np.asarray(np.isfinite(positions).all(axis=-1).sum(axis=-1))


def _is_at_rest(frame: FixedFrame | None) -> bool:
    return frame is not None and frame.kind is FrameKind.ANCHORS


def _moved_m2(first: FloatArray, second: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return how far the robots moved from placement to placement: mean squares, (k, m)."""
    squares = np.where(known[..., None], first - second, 0.0) ** 2
    return np.asarray(squares.sum(axis=(-1, -2)) / np.maximum(known.sum(axis=-1), 1))


def _bent_m2(first: FloatArray, second: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return the same after the motion of the fleet as a whole that fits best."""
    first, second = _centered(first, known), _centered(second, known)
    values = np.linalg.svd(np.einsum('kmni,kmnj->kmij', first, second), compute_uv=True)
    turns = np.sign(np.linalg.det(values.U) * np.linalg.det(values.Vh))
    gain = values.S[..., :-1].sum(axis=-1) + turns * values.S[..., -1]
    spread = (first**2).sum(axis=(-1, -2)) + (second**2).sum(axis=(-1, -2))
    mean = np.maximum(spread - 2.0 * gain, 0.0) / np.maximum(known.sum(axis=-1), 1)
    return np.asarray(mean)


def _centered(points: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return points around the middle of those that are known, zero for the others."""
    shape = (*known.shape, points.shape[-1])
    points = np.where(known[..., None], np.broadcast_to(points, shape), 0.0)
    count = np.maximum(known.sum(axis=-1), 1)[..., None, None]
    middle = points.sum(axis=-2, keepdims=True) / count
    return np.asarray(np.where(known[..., None], points - middle, 0.0))
