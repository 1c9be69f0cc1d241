# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Parts of a problem as independent tasks, for this process or for those of an executor.

Parts are handed out in batches and taken back in their order, so that the answer is the one that
this process alone would give. Clocks differ between machines: a task takes along how much time is
left.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import islice

from dg_localization.interval.environment import default_environment
from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.place.hypotheses import lazy_hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis, Statistics
from dg_localization.solver.search.branch_and_prune import Paving
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import search

PARTS_PER_TASK = 16
"""Parts of a task: enough that handing them over takes less time than they do."""

LOOK_S = 0.02
"""How long to wait for a task before looking whether the call was cancelled."""


@dataclass(frozen=True)
class Subproblem:
    """A part of a problem."""

    problem: Problem | None  # None where its bounds contradict each other
    within: Sequence[Bounds] | None
    all_or_nothing: bool = False  # a cover with boxes that were not examined is of no use


@dataclass(frozen=True)
class SolvedSubproblem:
    """The cover of a part, the effort, and the hypotheses that the cover makes."""

    cover: Paving
    statistics: Statistics
    hypotheses: Sequence[Hypothesis]


def solve_subproblem(part: Subproblem, budget: Budget) -> SolvedSubproblem:
    """Solve one part."""
    if part.problem is None:
        return SolvedSubproblem(Paving(), Statistics(), ())
    # One box at a time, so that no answer depends on the processors of a worker.
    cover = search(part.problem, budget, part.within, all_or_nothing=part.all_or_nothing)
    statistics = cover.statistics(len(cover.pending), budget.seconds())
    if part.all_or_nothing and cover.pending:
        return SolvedSubproblem(cover, statistics, ())
    hypotheses = lazy_hypotheses_of(part.problem, cover.kept + cover.pending)
    return SolvedSubproblem(cover, statistics, hypotheses)


def solve_subproblems(
    parts: Iterable[Subproblem],
    budget: Budget,
    most_boxes: int,
    stopped: Callable[[], bool],
) -> Iterator[SolvedSubproblem]:
    """Solve independent parts, in their order and with all that is left of a budget."""

    def solved_here(part: Subproblem) -> SolvedSubproblem:
        solved = solve_subproblem(part, budget.part(1.0, most_boxes))
        budget.spend(solved.statistics)
        return solved

    if budget.executor is None:
        for part in parts:
            if stopped():
                return
            yield solved_here(part)
        return
    limits = budget.part(1.0, most_boxes)
    for part, solved in _solved_by_workers(budget.executor, parts, limits, stopped):
        if budget.boxes_left() < limits.options.max_boxes:
            # This process would have given it fewer boxes.
            solved = solved_here(part)
        else:
            budget.spend(solved.statistics)
            budget.report(Statistics())
        yield solved


@default_environment()
def _solve_batch(parts: Sequence[Subproblem], options: SolverOptions) -> list[SolvedSubproblem]:
    """Solve parts one after another, in a worker; those that there is time for."""
    budget = Budget(options)
    solved: list[SolvedSubproblem] = []
    for part in parts:
        if budget.is_over():
            break
        solved.append(solve_subproblem(part, Budget(budget.remaining())))
    return solved


def _solved_by_workers(
    executor: Executor,
    parts: Iterable[Subproblem],
    limits: Budget,
    stopped: Callable[[], bool],
) -> Iterator[tuple[Subproblem, SolvedSubproblem]]:
    """Solve parts in the workers of an executor, each within the same limits."""
    waiting: list[tuple[list[Subproblem], Future[list[SolvedSubproblem]]]] = []
    left = iter(parts)
    try:
        while not stopped() and (batch := list(islice(left, PARTS_PER_TASK))):
            waiting.append((batch, executor.submit(_solve_batch, batch, limits.remaining())))
        for batch, future in waiting:
            solved = _wait_for(future, stopped)
            yield from zip(batch, solved, strict=False)
            if len(solved) < len(batch):
                return
    finally:
        for _, future in waiting:
            future.cancel()


def _wait_for(
    future: Future[list[SolvedSubproblem]], stopped: Callable[[], bool]
) -> list[SolvedSubproblem]:
    """Return the result of a task, nothing when there is no time left to wait for it."""
    while True:
        try:
            return future.result(timeout=LOOK_S)
        except TimeoutError:
            if future.done():
                # The wait was over, or the task itself raised this.
                return future.result()
            if stopped():
                return []
