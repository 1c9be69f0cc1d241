# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From one estimate to the next: hypotheses keep their numbers, what is forgotten stays so."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import copy
from dataclasses import dataclass, replace
from itertools import chain, count

from dg_localization.fleet.contradictions.offenders import Record
from dg_localization.fleet.estimate import Estimate, FixedFrame, Placement
from dg_localization.fleet.frames.standing_frame import StandingFrame
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import also_forgotten, left_out_until_s
from dg_localization.fleet.window.memory import Ends, Spans
from dg_localization.fleet.window.numbering import Framed, matches
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import chain_seconds


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
        self._forgotten: Spans = {}
        self._left_out: Mapping[Ends, float] = {}
        self._proved: tuple[Proved, ...] = ()
        self._standing_frame = StandingFrame()
        self._frame_changes = 0
        self._record = Record(memory_s)
        self.earlier = EarlierSets()

    @property
    def forgotten(self) -> Spans:
        """Observations that are not remembered."""
        return self._forgotten

    @property
    def left_out(self) -> Mapping[Ends, float]:
        """Up to when observations do not count as measurements of the moment."""
        return self._left_out

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
            self._forgotten, self._left_out = {}, {}
        self._forgotten = also_forgotten(self._forgotten, estimate.forgotten, oldest_s)
        self._left_out = left_out_until_s(self._left_out, estimate.forgotten)
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
