# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Minimal conflicts between observations, and minimal corrections that make the rest agree.

A conflict is a set of observations that no placement agrees with. It is minimal if every proper
subset agrees with some placement. A correction is a set of suspects; without their observations
the rest agree. Every correction shares an observation with every conflict, so the minimal
corrections are found by branching on the suspects in one conflict after the other (Reiter,
A theory of diagnosis from first principles, 1987). A conflict is made minimal by leaving out
halves (Junker, QuickXplain, 2004).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from enum import IntEnum
from itertools import combinations
import time
from types import MappingProxyType
from typing import NamedTuple

from dg_localization.fleet.contradictions.suspects import Suspect, Suspects
from dg_localization.solver.options import Cancel


class Effort(IntEnum):
    """How hard to look for a contradiction."""

    PAIRS = 0
    """Check pairs, triangles and angles only: takes 1 ms and shows most contradictions."""

    BRIEF = 1
    """Solve for the points concerned."""

    THOROUGH = 2
    """Solve for the whole fleet and its headings."""


Contradicts = Callable[[Suspects, Effort], bool]
"""Returns whether observations contradict each other; true is a proof."""


class Limits(NamedTuple):
    """
    Limits of a search.

    Parameters
    ----------
    max_outliers : int
        Greatest size of a correction.
    max_solves : int
        Most calls of the solver.
    max_seconds : float
        Longest time.
    cancel : Cancel, optional
        Ends the search when set.

    """

    max_outliers: int
    max_solves: int
    max_seconds: float
    cancel: Cancel | None = None


class Explanation(NamedTuple):
    """
    Why observations contradict each other.

    Parameters
    ----------
    conflicts : tuple of frozenset of Suspect
        Proved conflicts, minimal as far as brief solves show.
    corrections : tuple of frozenset of Suspect
        All minimal corrections of up to `searched` suspects.
    searched : int
        The greatest size of corrections for which the limits sufficed.
    among : frozenset of Suspect
        Observations that contradict each other, if the limits did not suffice to find a minimal
        conflict among them.
    culprits : tuple of Suspect
        If there are no corrections: suspects that each explain everything alone, as far as brief
        solves show. They are observations, else sensors, else robots.
    together : tuple of (Suspect, Suspect)
        If there are no culprits either: pairs of anchors that explain it; they may be swapped.
    stopped : bool
        Whether the limits ended the search for conflicts or culprits.

    """

    conflicts: tuple[Suspects, ...]
    corrections: tuple[Suspects, ...]
    searched: int
    among: Suspects = frozenset()
    culprits: tuple[Suspect, ...] = ()
    together: tuple[tuple[Suspect, Suspect], ...] = ()
    stopped: bool = False


class _LimitReachedError(Exception):
    """The search for an explanation has reached a limit."""


class _Oracle:
    """Decides whether observations contradict each other, within limits; caches its answers."""

    def __init__(self, contradicts: Contradicts, limits: Limits) -> None:
        self._contradicts = contradicts
        self._solves_left = limits.max_solves
        self._deadline_s = time.monotonic() + limits.max_seconds
        self._cancel = limits.cancel
        self._known: dict[tuple[Suspects, Effort], bool] = {}

    def __call__(self, observations: Suspects, effort: Effort) -> bool:
        """Return whether no placement agrees with observations; raise if a limit is reached."""
        if any(self._known.get((observations, less)) for less in Effort):
            return True
        question = (observations, effort)
        if question not in self._known:
            self._spend(effort)
            answer = self._contradicts(observations, effort)
            if self._cancelled():
                # The search may have been stopped before it found an answer.
                raise _LimitReachedError
            self._known[question] = answer
        return self._known[question]

    def _spend(self, effort: Effort) -> None:
        """Charge one call to the limits; raise if they are reached."""
        late = time.monotonic() > self._deadline_s
        if self._solves_left <= 0 or late or self._cancelled():
            raise _LimitReachedError
        self._solves_left -= effort is not Effort.PAIRS

    def _cancelled(self) -> bool:
        """Return whether the search is cancelled."""
        return self._cancel is not None and self._cancel.is_set()


def explain(
    observations: Suspects,
    regions: Sequence[Suspects],
    named: Sequence[Mapping[Suspect, Suspects]],
    contradicts: Contradicts,
    limits: Limits,
    refuted: Collection[Suspects] = (),
    anchors: Mapping[Suspect, Suspects] = MappingProxyType({}),
) -> Explanation:
    """
    Explain a contradiction.

    Parameters
    ----------
    observations : frozenset of Suspect
        Observations that contradict each other.
    regions : sequence of frozenset of Suspect
        Subsets that are small problems, in which a contradiction is found sooner.
    named : sequence of mapping of Suspect to frozenset of Suspect
        Suspects with the observations that each covers, small ones first. Corrections consist of
        suspects of the first mapping; all mappings serve to name a culprit.
    contradicts : callable
    limits : Limits
    refuted : collection of frozenset of Suspect, optional
        Sets that are known to be no corrections, although no effort of the oracle shows it.
    anchors : mapping of Suspect to frozenset of Suspect, optional
        Anchors of which two together may explain everything: they may be swapped.

    Returns
    -------
    Explanation

    """
    oracle = _Oracle(contradicts, limits)
    contradicting = [observations - _stand_for(dropped, named[0]) for dropped in refuted]
    search = _Search(observations, regions, oracle, contradicting)
    searched, stopped = 0, False
    culprits: tuple[Suspect, ...] = ()
    together: tuple[tuple[Suspect, Suspect], ...] = ()
    try:
        # In order of size: if the larger ones take too long, the smaller ones are known.
        for size in range(1, limits.max_outliers + 1):
            search.find_corrections(named[0], size)
            searched = size
        search.find_disjoint_conflicts()
        if not search.corrections:
            culprits = search.culprits(named)
            together = () if culprits else search.together(anchors)
    except _LimitReachedError:
        stopped = True
    return Explanation(
        tuple(sorted(search.conflicts, key=sorted)),
        tuple(sorted(search.corrections, key=lambda found: (len(found), sorted(found)))),
        searched,
        search.among,
        culprits,
        together,
        stopped,
    )


class _Search:
    """The search for conflicts and corrections, with its results so far."""

    def __init__(
        self,
        observations: Suspects,
        regions: Sequence[Suspects],
        oracle: _Oracle,
        contradicting: Collection[Suspects],
    ) -> None:
        self._observations = observations
        self._regions = regions
        self._oracle = oracle
        self._contradicting = contradicting
        self.conflicts: list[Suspects] = []
        self.corrections: list[Suspects] = []
        self.among: Suspects = frozenset()

    def find_corrections(self, named: Mapping[Suspect, Suspects], max_outliers: int) -> None:
        """Find all minimal corrections of at most `max_outliers` suspects, or raise at a limit."""
        level: list[Suspects] = [frozenset()]
        corrections: list[Suspects] = []
        for size in range(max_outliers + 1):
            following: set[Suspects] = set()
            for dropped in level:
                if any(correction <= dropped for correction in corrections):
                    continue
                without = _stand_for(dropped, named)
                # No larger corrections are wanted, so the conflict need not be minimal.
                conflict = self._conflict_without(without, minimal=size < max_outliers)
                if conflict is None:
                    corrections.append(dropped)
                elif size < max_outliers:
                    following |= {
                        dropped | {suspect}
                        for suspect, covered in named.items()
                        if covered & conflict
                    }
            level = sorted(following, key=sorted)
        self.corrections = corrections

    def find_disjoint_conflicts(self) -> None:
        """Find conflicts that are disjoint from the known ones, until the rest agree."""
        rest = self._observations.difference(*self.conflicts)
        most = Effort.BRIEF if self.conflicts else Effort.THOROUGH
        while (conflict := self._conflict_in(rest, most)) is not None:
            self.conflicts.append(conflict)
            if not conflict:
                break
            rest -= conflict
            most = Effort.BRIEF

    def culprits(self, named: Sequence[Mapping[Suspect, Suspects]]) -> tuple[Suspect, ...]:
        """Return the smallest suspects that each make the rest seem to agree when dropped."""
        for suspects in named:
            found = tuple(
                suspect
                for suspect, covered in suspects.items()
                if all(covered & conflict for conflict in self.conflicts)
                and not self._contradict(self._observations - covered)
            )
            if found:
                return found
        return ()

    def together(self, anchors: Mapping[Suspect, Suspects]) -> tuple[tuple[Suspect, Suspect], ...]:
        """Return the pairs of anchors that make the rest seem to agree when dropped."""
        return tuple(
            (first, second)
            for first, second in combinations(anchors, 2)
            if all(conflict & (anchors[first] | anchors[second]) for conflict in self.conflicts)
            and not self._contradict(self._observations - anchors[first] - anchors[second])
        )

    def _conflict_without(self, dropped: Suspects, *, minimal: bool) -> Suspects | None:
        """Return a conflict without dropped observations; None if no effort shows one."""
        for conflict in self.conflicts:
            if not conflict & dropped:
                return conflict
        rest = self._observations - dropped
        if rest in self._contradicting:
            return rest
        if not minimal:
            return rest if self._contradict(rest) or self._oracle(rest, Effort.THOROUGH) else None
        found = self._conflict_in(rest, Effort.THOROUGH)
        if found is not None:
            self.conflicts.append(found)
        return found

    def _contradict(self, observations: Suspects) -> bool:
        """Return whether brief checks show that observations contradict each other."""
        return self._where(observations, Effort.BRIEF) is not None

    def _conflict_in(self, observations: Suspects, most: Effort) -> Suspects | None:
        """Return a minimal conflict among observations; None if no effort shows one."""
        found = self._where(observations, most)
        if found is None:
            return None
        part, effort = found
        conflict = self._minimize(part, effort)
        if effort is Effort.PAIRS:
            conflict = self._minimize(conflict, Effort.BRIEF)
        self.among = frozenset()
        return conflict

    def _where(self, observations: Suspects, most: Effort) -> tuple[Suspects, Effort] | None:
        """Return a subset of observations in conflict, and the effort that shows it."""
        if self._oracle(observations, Effort.PAIRS):
            return observations, Effort.PAIRS
        for region in self._regions:
            part = region & observations
            if part and part != observations and self._oracle(part, Effort.BRIEF):
                return part, Effort.BRIEF
        for effort in (Effort.BRIEF, Effort.THOROUGH)[: most.value]:
            if self._oracle(observations, effort):
                return observations, effort
        return None

    def _minimize(self, observations: Suspects, effort: Effort) -> Suspects:
        """Return a minimal subset of contradicting observations that is still in conflict."""
        needed = observations
        pending = [sorted(observations)]
        while pending:
            self.among = needed
            chunk = pending.pop()
            if self._oracle(needed.difference(chunk), effort):
                needed = needed.difference(chunk)
            elif len(chunk) > 1:
                half = len(chunk) // 2
                pending += [chunk[half:], chunk[:half]]
        return needed


def _stand_for(suspects: Suspects, named: Mapping[Suspect, Suspects]) -> Suspects:
    """Return all observations that suspects cover."""
    return frozenset().union(*(named[suspect] for suspect in suspects))
