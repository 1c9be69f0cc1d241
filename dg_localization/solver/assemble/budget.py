# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The effort of one call, shared by the searches of its pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
import math
import time

from dg_localization.solver.assemble.tasks import (
    LEAST_S,
    SolvedSubproblem,
    Subproblem,
    Workers,
    solve_subproblem,
)
from dg_localization.solver.box import FloatArray
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Cover
from dg_localization.solver.search.search import search

GRACE_S = 0.005
"""What takes long is left out so much later than the end: what is short still makes an answer."""


class _Stopped:
    """Stops a search before its first box: what it covers is all pending."""

    def is_set(self) -> bool:
        return True


class _Remembered:
    """Stays set: a step that was stopped must not count as done, where an event is cleared."""

    def __init__(self, cancel: Cancel) -> None:
        self._cancel = cancel
        self._was_set = False

    def is_set(self) -> bool:
        self._was_set = self._was_set or bool(self._cancel.is_set())
        return self._was_set


class CallBudget:
    """What is left of the boxes and of the time that a call may take."""

    def __init__(
        self,
        options: SolverOptions,
        cancel: Cancel | None = None,
        progress: Callable[[Statistics], None] | None = None,
        workers: Workers | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.options = options
        self.spent = Statistics()
        self.workers = workers
        self._cancel = None if cancel is None else _Remembered(cancel)
        self._progress = progress
        self._clock = clock
        self._start = clock()
        self._cancelled_s = math.inf

    def seconds(self) -> float:
        """Return the time since the call began."""
        return self._clock() - self._start

    def seconds_left(self) -> float:
        """Return the time until the call has to come to an end."""
        return self.options.max_seconds - self.seconds()

    def is_cancelled(self) -> bool:
        """Return whether the call was cancelled."""
        is_cancelled = bool(self._cancel and self._cancel.is_set())
        if is_cancelled:
            self._cancelled_s = min(self._cancelled_s, self.seconds())
        return is_cancelled

    def is_over(self) -> bool:
        """Return whether the call is to come to an end."""
        if self.is_cancelled():
            return True
        return self.seconds() > self.options.max_seconds

    def is_overdue(self) -> bool:
        """Return whether the call should have come to an end some time ago."""
        if not self.is_over():
            return False
        return self.seconds() > min(self.options.max_seconds, self._cancelled_s) + GRACE_S

    def _report(self, statistics: Statistics) -> None:
        if self._progress:
            self._progress(self.spent + statistics)

    def _reporter(self) -> Callable[[Statistics], None] | None:
        """Return what a search calls after every box, nothing where nobody asked for it."""
        return self._report if self._progress else None

    def take_back(self, n_pending: int) -> None:
        """Note that boxes which a search left pending are examined after all."""
        self.spent = replace(self.spent, pending=self.spent.pending - n_pending)

    def go_on_from(self, n_kept: int) -> None:
        """Note that boxes which were kept are parts of boxes that are examined next."""
        n_split = min(n_kept, self.spent.kept)
        self.spent = replace(
            self.spent, kept=self.spent.kept - n_split, split=self.spent.split + n_split
        )

    def count_split(self) -> None:
        """Note that a box was split by other means than the search."""
        self.spent = replace(
            self.spent, processed=self.spent.processed + 1, split=self.spent.split + 1
        )

    def keep(self, n_boxes: int) -> bool:
        """Note that boxes found by other means than the search are kept, if so many may be."""
        if n_boxes > self.boxes_left():
            return False
        self.spent += Statistics(processed=n_boxes, kept=n_boxes)
        return True

    def accept_pending(self, cover: Cover) -> None:
        """Keep the boxes which a search left pending as they are, if so many may be."""
        n_pending = len(cover.pending)
        if n_pending > self.boxes_left():
            return
        cover.kept, cover.pending = cover.kept + cover.pending, []
        self.spent = replace(
            self.spent,
            processed=self.spent.processed + n_pending,
            kept=self.spent.kept + n_pending,
            pending=self.spent.pending - n_pending,
        )

    def search(
        self,
        problem: Problem,
        share: float,
        within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
        most_boxes: int | None = None,
        at_gaps: bool = False,
    ) -> Cover:
        """Cover the placements of a piece with a share of what is left, completely in any case."""
        options, report = self._share(share, most_boxes), self._reporter()
        has_boxes, cancel = self._before_search()
        cover, statistics = search(problem, options, cancel, report, within, at_gaps=at_gaps)
        self._spend(statistics, has_boxes)
        return cover

    def search_in_one_box(self, problem: Problem, share: float = 1.0) -> Cover:
        """Cover a problem by one box; else all is pending and counts nothing."""
        options = self._limited(1, share * self.seconds_left())
        has_boxes, cancel = self._before_search()
        cover, statistics = search(problem, options, cancel)
        if not cover.pending:
            self._spend(statistics, has_boxes)
            self._report(Statistics())
        return cover

    def solve_parts(
        self, parts: Iterable[Subproblem], most_boxes: int, stopped: Callable[[], bool]
    ) -> Iterator[SolvedSubproblem]:
        """Solve independent parts, in their order and with all that is left."""
        if self.workers is None:
            for part in parts:
                if stopped():
                    return
                yield self._solved(part, most_boxes)
            return
        options = self._share(1.0, most_boxes)
        for part, solved in self.workers.solved(parts, options, stopped):
            if self.boxes_left() < options.max_boxes:
                # This process would have given it fewer boxes.
                solved = self._solved(part, most_boxes)
            else:
                self._spend(solved.statistics, has_boxes=True)
                self._report(Statistics())
            yield solved

    def _solved(self, part: Subproblem, most_boxes: int) -> SolvedSubproblem:
        """Solve one part in this process."""
        has_boxes, cancel = self._before_search()
        solved = solve_subproblem(part, self._share(1.0, most_boxes), cancel, self._reporter())
        self._spend(solved.statistics, has_boxes)
        return solved

    def boxes_left(self) -> int:
        """Return how many boxes are left."""
        return self.options.max_boxes - self.spent.processed

    def _before_search(self) -> tuple[bool, Cancel | None]:
        """Return whether boxes are left, and what stops a search: at once where none are."""
        has_boxes = self.boxes_left() > 0
        return has_boxes, self._cancel if has_boxes else _Stopped()

    def _share(self, share: float, most_boxes: int | None) -> SolverOptions:
        """Return the options for a share of what is left."""
        boxes = self.boxes_left()
        seconds = self.options.max_seconds - (self.seconds() if self.spent.processed else 0.0)
        return self._limited(max(1, min(int(share * boxes), most_boxes or boxes)), share * seconds)

    def _limited(self, max_boxes: int, max_seconds: float) -> SolverOptions:
        """Return the options for some boxes and time."""
        return self.options.limited(
            max_boxes,
            max(LEAST_S, max_seconds),
            max(0.0, self.options.tighten_seconds - self.seconds()),
        )

    def _spend(self, statistics: Statistics, has_boxes: bool) -> None:
        """Note the effort of a search."""
        if not has_boxes:
            # What the triangle inequalities alone rule out takes no box.
            statistics = replace(statistics, processed=0, empty=0)
        self.spent += statistics
