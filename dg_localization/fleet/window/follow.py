# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From one estimate to the next: hypotheses keep their numbers, what is forgotten stays so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

from dg_localization.fleet.estimate import Estimate, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.forgetting import also_forgotten
from dg_localization.fleet.window.memory import Ends
from dg_localization.fleet.window.numbering import matches
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import WINDOW_SHARE


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

    """

    def __init__(self, first_number: int = 1) -> None:
        self._next_number = first_number
        self._last = _Followed((), 0.0)
        self._forgotten: Mapping[Ends, float] = {}
        self._proved: Proved | None = None

    @property
    def forgotten(self) -> Mapping[Ends, float]:
        """Up to when observations between two points do not count."""
        return self._forgotten

    def started_anew(self) -> Follower:
        """Return one that knows no hypothesis; numbers are not used again."""
        return Follower(self._next_number)

    def proved_for(self, snapshot: Snapshot) -> Proved | None:
        """Return what the estimate before proved, unless that is out of memory or of later."""
        proved, config = self._proved, snapshot.config
        if proved is None or not proved.stamp_s <= snapshot.stamp_s:
            return None
        longest_s = (1.0 - WINDOW_SHARE) * config.memory_s
        return proved if snapshot.stamp_s - proved.since_s <= longest_s else None

    def follow(self, snapshot: Snapshot, estimate: Estimate) -> Estimate:
        """Return an estimate with the numbers of its hypotheses."""
        self._forgotten = also_forgotten(self._forgotten, estimate.forgotten)
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
        self._proved = _what_is_proved(snapshot, estimate, self.proved_for(snapshot))
        return _with_placements(estimate, numbered)


def _what_is_proved(
    snapshot: Snapshot, estimate: Estimate, before: Proved | None
) -> Proved | None:
    """Return what an estimate proves of later ones: nothing where measurements contradict."""
    listed = estimate.placements
    complete = len(listed) == estimate.n_hypotheses and not any(p.dropped for p in listed)
    in_plane = snapshot.config.dimension == 2
    if estimate.frame is None or not listed or not complete or estimate.forgotten or not in_plane:
        return None
    since_s = snapshot.stamp_s if before is None else before.since_s
    return Proved(listed, estimate.frame, snapshot.stamp_s, since_s)


def _with_placements(estimate: Estimate, placements: list[Placement]) -> Estimate:
    """Return an estimate with other placements, those of its groups last."""
    rest = iter(placements)
    main = tuple(next(rest) for _ in estimate.placements)
    groups = tuple(
        replace(group, placements=tuple(next(rest) for _ in group.placements))
        for group in estimate.groups
    )
    return replace(estimate, placements=main, groups=groups)
