# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which measurements contradict each other, and which to drop so that the rest agree.

A conflict is a set of links that no placement agrees with; it is minimal when some placement
agrees with every proper subset. A correction is a set of links without which the rest agree.
Every correction shares a link with every conflict, so the minimal corrections are found by
branching on the links of one conflict after the other (Reiter, A theory of diagnosis from first
principles, 1987).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
import time

from dg_localization.fleet.vocabulary import Conflict, LinkKey
from dg_localization.solver.options import Cancel

Links = frozenset[LinkKey]


@dataclass(frozen=True)
class Explanation:
    """
    Why measurements contradict each other.

    Parameters
    ----------
    conflicts : tuple of tuple of LinkKey
        Proved conflicts, minimal as far as the budget allowed.
    corrections : tuple of frozenset of LinkKey
        All minimal corrections of up to the number of links asked for.
    complete : bool
        Whether the budget sufficed; otherwise corrections may be missing.

    """

    conflicts: tuple[Conflict, ...]
    corrections: tuple[Links, ...]
    complete: bool


class _BudgetExceededError(Exception):
    """The search for an explanation has used up its budget."""


class _Oracle:
    """Answers whether links contradict each other, within a budget; remembers its answers."""

    def __init__(
        self,
        is_contradiction: Callable[[Links, bool], bool],
        max_solves: int,
        max_seconds: float,
        cancel: Cancel | None,
    ) -> None:
        self._is_contradiction = is_contradiction
        self._left = max_solves
        self._deadline_s = time.monotonic() + max_seconds
        self._cancel = cancel
        self._known: dict[tuple[Links, bool], bool] = {}

    def __call__(self, links: Links, thorough: bool = False) -> bool:
        """Return whether no placement agrees with `links`; raise when the budget is used up."""
        if self._known.get((links, False)):
            return True
        if (links, thorough) not in self._known:
            self._spend()
            answer = self._is_contradiction(links, thorough)
            if self._cancelled():
                # The answer may be that of a search that was stopped.
                raise _BudgetExceededError
            self._known[links, thorough] = answer
        return self._known[links, thorough]

    def _spend(self) -> None:
        """Charge one question to the budget; raise when it is used up."""
        late = time.monotonic() > self._deadline_s
        if self._left <= 0 or late or self._cancelled():
            raise _BudgetExceededError
        self._left -= 1

    def _cancelled(self) -> bool:
        """Return whether to stop."""
        return self._cancel is not None and self._cancel.is_set()


def explain(
    links: Sequence[LinkKey],
    is_contradiction: Callable[[Links, bool], bool],
    max_outliers: int,
    max_solves: int,
    max_seconds: float,
    cancel: Cancel | None = None,
) -> Explanation:
    """
    Explain a contradiction.

    Parameters
    ----------
    links : sequence of LinkKey
        Links that contradict each other.
    is_contradiction : callable
        Whether some of the links alone contradict each other. True must be a proof; False may
        also mean that it could not be decided. The second argument asks for a thorough search,
        as corrections need it: a set that is wrongly called one hides the larger ones.
    max_outliers : int
        Greatest size of a correction.
    max_solves : int
        How often to ask.
    max_seconds : float
        How long to go on.
    cancel : Cancel, optional
        Ends the budget when set.

    Returns
    -------
    Explanation

    """
    oracle = _Oracle(is_contradiction, max_solves, max_seconds, cancel)
    conflicts: list[Links] = []
    corrections: list[Links] = []
    complete = True
    try:
        if max_outliers > 0:
            _find_corrections(frozenset(links), oracle, max_outliers, conflicts, corrections)
        _find_disjoint_conflicts(frozenset(links), oracle, conflicts)
    except _BudgetExceededError:
        complete = False
    return Explanation(
        tuple(sorted(tuple(sorted(conflict)) for conflict in conflicts)),
        tuple(sorted(corrections, key=lambda links: (len(links), sorted(links)))),
        complete,
    )


def _find_corrections(
    links: Links,
    oracle: _Oracle,
    max_outliers: int,
    conflicts: list[Links],
    corrections: list[Links],
) -> None:
    """Append all minimal corrections of up to `max_outliers` links, and the conflicts found."""
    level: list[Links] = [frozenset()]
    for _ in range(max_outliers):
        following: set[Links] = set()
        for dropped in _not_covered(level, corrections):
            conflict = _conflict_without(links, dropped, oracle, conflicts)
            if conflict is None:
                corrections.append(dropped)
            else:
                following |= {dropped | {link} for link in conflict}
        level = sorted(following, key=sorted)
    # No larger corrections are wanted, so the conflicts that rule these out do not matter.
    for dropped in _not_covered(level, corrections):
        if all(conflict & dropped for conflict in conflicts) and not oracle(links - dropped, True):
            corrections.append(dropped)


def _not_covered(level: list[Links], corrections: list[Links]) -> Iterator[Links]:
    """Yield the sets that contain none of the corrections known by the time they are reached."""
    for dropped in level:
        if not any(correction <= dropped for correction in corrections):
            yield dropped


def _conflict_without(
    links: Links, dropped: Links, oracle: _Oracle, conflicts: list[Links]
) -> Links | None:
    """Return a conflict that none of the dropped links is part of, or None."""
    for conflict in conflicts:
        if not conflict & dropped:
            return conflict
    rest = links - dropped
    if not oracle(rest, thorough=True):
        return None
    conflict = _minimize(rest, oracle)
    conflicts.append(conflict)
    return conflict


def _find_disjoint_conflicts(links: Links, oracle: _Oracle, conflicts: list[Links]) -> None:
    """Append conflicts that share no link with the known ones, until the rest agree."""
    rest = links.difference(*conflicts)
    while oracle(rest):
        conflict = _minimize(rest, oracle)
        conflicts.append(conflict)
        if not conflict:
            break
        rest -= conflict


def _minimize(links: Links, oracle: _Oracle) -> Links:
    """Return a minimal part of contradicting links that still contradict each other."""
    needed = links
    pending = [sorted(links)]
    while pending:
        chunk = pending.pop()
        if oracle(needed.difference(chunk)):
            needed = needed.difference(chunk)
        elif len(chunk) > 1:
            half = len(chunk) // 2
            pending += [chunk[half:], chunk[:half]]
    return needed
