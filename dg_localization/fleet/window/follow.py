# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From one estimate to the next: hypotheses keep their numbers, what is forgotten stays so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from dg_localization.fleet.estimate import Estimate, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.forgetting import also_forgotten, left_out_until_s
from dg_localization.fleet.window.memory import Ends, Spans
from dg_localization.fleet.window.numbering import matches
from dg_localization.fleet.window.pair_filters import PairFilters
from dg_localization.fleet.window.pose_filters import PoseFilters
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import chain_seconds


@dataclass(frozen=True)
class _Followed:
    """The placements of an estimate, numbered, and what they were found from."""

    placements: tuple[Placement, ...]
    stamp_s: float


class Follower:
    """
    Follows hypotheses, in the thread of the estimates.

    Parameters
    ----------
    first_number : int
        Of the next hypothesis that is new.

    Attributes
    ----------
    filters : PoseFilters
        They follow robots among anchors from estimate to estimate.
    pair_filters : PairFilters
        They follow two robots without anchors.

    """

    def __init__(self, first_number: int = 1) -> None:
        self._next_number = first_number
        self._last = _Followed((), 0.0)
        self._forgotten: Spans = {}
        self._left_out: Mapping[Ends, float] = {}
        self._proved: tuple[Proved, ...] = ()
        self.filters = PoseFilters()
        self.pair_filters = PairFilters()

    @property
    def forgotten(self) -> Spans:
        """Observations that are not remembered."""
        return self._forgotten

    @property
    def left_out(self) -> Mapping[Ends, float]:
        """Up to when observations do not count as measurements of the moment."""
        return self._left_out

    def started_anew(self) -> Follower:
        """Return one that knows no hypothesis; numbers are not used again."""
        return Follower(self._next_number)

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

        That counts where an estimate was cancelled, too: its filters have gone on.
        """
        oldest_s = snapshot.stamp_s - snapshot.config.memory_s
        if self._last.stamp_s > snapshot.stamp_s:
            # The clock was set back: what is left out is of another time.
            self._forgotten, self._left_out = {}, {}
        self._forgotten = also_forgotten(self._forgotten, estimate.forgotten, oldest_s)
        self._left_out = left_out_until_s(self._left_out, estimate.forgotten)
        self.filters.forget(snapshot.config, estimate.forgotten)
        self.pair_filters.forget(snapshot.config, estimate.forgotten)

    def follow(
        self, snapshot: Snapshot, estimate: Estimate, proved: tuple[Proved, ...]
    ) -> Estimate:
        """Return an estimate with the numbers of its hypotheses; keep what it proved."""
        listed = [
            *estimate.placements,
            *(placement for group in estimate.groups for placement in group.placements),
        ]
        before = self._last
        pairs = matches(snapshot, before.stamp_s, before.placements, listed)
        numbered = []
        for row, placement in enumerate(listed):
            number = self._next_number
            if row in pairs:
                number = before.placements[pairs[row]].number
            else:
                self._next_number += 1
            numbered.append(replace(placement, number=number))
        self._last = _Followed(tuple(numbered), snapshot.stamp_s)
        self._proved = proved
        return _with_placements(estimate, numbered)


def _with_placements(estimate: Estimate, placements: list[Placement]) -> Estimate:
    """Return an estimate with other placements, those of its groups last."""
    rest = iter(placements)
    main = tuple(next(rest) for _ in estimate.placements)
    groups = tuple(
        replace(group, placements=tuple(next(rest) for _ in group.placements))
        for group in estimate.groups
    )
    return replace(estimate, placements=main, groups=groups)
