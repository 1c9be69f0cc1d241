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
import time

from dg_localization.interval.environment import default_environment
from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.place.unplaced_hypotheses import unplaced_hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis, Statistics
from dg_localization.solver.search.branch_and_prune import Cover
from dg_localization.solver.search.search import search

PARTS_PER_TASK = 16
"""Parts of a task: enough that handing them over takes less time than they do."""

LOOK_S = 0.02
"""How long to wait for a task before looking whether the call was cancelled."""

LEAST_S = 1e-9
"""A search with less time than this left does not look at a single box."""


@dataclass(frozen=True)
class Subproblem:
    """A part of a problem."""

    problem: Problem | None  # None where its bounds contradict each other
    within: Sequence[Bounds] | None
    all_or_nothing: bool = False  # a cover with boxes that were not examined is of no use
    is_placed: bool = True  # placements are sought at once, not when somebody asks for them


@dataclass(frozen=True)
class SolvedSubproblem:
    """The cover of a part, the effort, and the hypotheses that the cover makes."""

    cover: Cover
    statistics: Statistics
    hypotheses: Sequence[Hypothesis]


class _BoxLimit:
    """Stops a search that has more boxes to examine than it may."""

    def __init__(
        self,
        most_boxes: int,
        cancel: Cancel | None,
        progress: Callable[[Statistics], None] | None,
    ) -> None:
        self._most_boxes = most_boxes
        self._cancel = cancel
        self._progress = progress
        self._is_lost = False

    def __call__(self, statistics: Statistics) -> None:
        """Note the statistics after a box: each that is pending takes one box at least."""
        self._is_lost = statistics.processed + statistics.pending > self._most_boxes
        if self._progress:
            self._progress(statistics)

    def is_set(self) -> bool:
        """Return whether to stop."""
        return self._is_lost or bool(self._cancel and self._cancel.is_set())


def solve_subproblem(
    part: Subproblem,
    options: SolverOptions,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
) -> SolvedSubproblem:
    """Solve one part."""
    if part.problem is None:
        return SolvedSubproblem(Cover(), Statistics(), ())
    if part.all_or_nothing:
        cancel = progress = _BoxLimit(options.max_boxes, cancel, progress)
    # One box at a time, so that no answer depends on the processors of a worker.
    args = part.problem, options, cancel, progress, part.within
    cover, statistics = search(*args)
    if part.all_or_nothing and cover.pending:
        return SolvedSubproblem(cover, statistics, ())
    of_cover = hypotheses_of if part.is_placed else unplaced_hypotheses_of
    return SolvedSubproblem(cover, statistics, of_cover(part.problem, cover.kept + cover.pending))


@default_environment()
def _solve_batch(
    parts: Sequence[Subproblem], options: SolverOptions, prepare: Callable[[], object]
) -> list[SolvedSubproblem]:
    """Solve parts one after another, in a worker; those that there is time for."""
    prepare()
    start = time.perf_counter()
    solved: list[SolvedSubproblem] = []
    for part in parts:
        passed_s = time.perf_counter() - start
        if passed_s >= options.max_seconds:
            break
        solved.append(solve_subproblem(part, _left_of(options, passed_s)))
    return solved


def _left_of(options: SolverOptions, passed_s: float) -> SolverOptions:
    """Return the options with what is left of the time."""
    return options.limited(
        options.max_boxes,
        max(LEAST_S, options.max_seconds - passed_s),
        max(0.0, options.tighten_seconds - passed_s),
    )


class Workers:
    """Solves parts in the workers of an executor."""

    def __init__(self, executor: Executor, prepare: Callable[[], object]) -> None:
        self._executor = executor
        self._prepare = prepare

    def solved(
        self,
        parts: Iterable[Subproblem],
        options: SolverOptions,
        stopped: Callable[[], bool],
    ) -> Iterator[tuple[Subproblem, SolvedSubproblem]]:
        """Solve parts, each within the same limits."""
        start = time.perf_counter()
        waiting: list[tuple[list[Subproblem], Future[list[SolvedSubproblem]]]] = []
        left = iter(parts)
        try:
            while not stopped() and (batch := list(islice(left, PARTS_PER_TASK))):
                limits = _left_of(options, time.perf_counter() - start)
                args = batch, limits, self._prepare
                waiting.append((batch, self._executor.submit(_solve_batch, *args)))
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
