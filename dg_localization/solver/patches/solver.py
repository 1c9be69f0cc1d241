# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A large rigid piece, solved in patches.

Small rigid neighborhoods cover all measured pairs and overlap. Each is solved as a problem of its
own; shared pairs get the intersection of their bounds, and hypotheses that contradict their
neighbors are dropped. Further patches cross the seams between bodies of patches, and review
patches with several remaining hypotheses. Every placement of the piece is a placement of each
patch, so no placement is lost for any choice of patches.

Patches are independent tasks, for this process or the workers of an executor. They are submitted
in batches and collected in order, so that the answer is the same as without workers. Clocks differ
between machines, so a task carries its remaining time.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from itertools import islice
from typing import NamedTuple

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.interval.pave import Paving
from dg_localization.solver.box import UPPER, FloatArray
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.decompose.rigid_components import joined_bodies
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.patches.known_pairs import Ambiguities, KnownPairs, Patch
from dg_localization.solver.patches.neighborhoods import (
    PATCH_POINTS,
    Neighborhoods,
    covering_patches,
    seam_patches,
)
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.problem import Problem, points_of
from dg_localization.solver.result import Hypothesis, Statistics
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import effort, search
from dg_localization.solver.subproblem import Bounds, restricted, restricted_boxes

PARTS_PER_TASK = 16
"""Parts of a task: enough that their transfer takes less time than their solution."""

LOOK_S = 0.02
"""Time to wait for a task before checking whether the call was cancelled."""


class Subproblem(NamedTuple):
    """A part of a problem."""

    problem: Problem | None  # None if its bounds contradict each other
    within: Sequence[Bounds] | None
    all_or_nothing: bool = False  # whether an incomplete cover is of no use


class SolvedSubproblem(NamedTuple):
    """The cover of a part, its effort, and its hypotheses."""

    cover: Paving[FloatArray]
    statistics: Statistics
    hypotheses: Sequence[Hypothesis]


def solve_subproblem(part: Subproblem, budget: Budget) -> SolvedSubproblem:
    """Solve one part."""
    if part.problem is None:
        return SolvedSubproblem(Paving(), Statistics(), ())
    # One box at a time, so that the answer does not depend on the processors of a worker.
    cover = search(part.problem, budget, part.within, all_or_nothing=part.all_or_nothing)
    statistics = effort(cover, len(cover.pending), budget.seconds())
    if part.all_or_nothing and cover.pending:
        return SolvedSubproblem(cover, statistics, ())
    hypotheses = hypotheses_of(part.problem, cover.kept, cover.pending)
    return SolvedSubproblem(cover, statistics, hypotheses)


def solve_subproblems(
    parts: Iterable[Subproblem],
    budget: Budget,
    most_boxes: int,
    stopped: Callable[[], bool],
) -> Iterator[SolvedSubproblem]:
    """Solve independent parts in their order with all of the remaining budget."""

    def solved_here(part: Subproblem) -> SolvedSubproblem:
        solved = solve_subproblem(part, budget.part(1.0, most_boxes))
        budget.spend(solved.statistics)
        return solved

    if budget.submit is None:
        for part in parts:
            if stopped():
                return
            yield solved_here(part)
        return
    limits = budget.part(1.0, most_boxes)
    for part, solved in _solved_by_workers(budget.submit, parts, limits, stopped):
        if budget.boxes_left() < limits.options.max_boxes:
            # Without workers this part would have had fewer boxes.
            solved = solved_here(part)
        else:
            budget.spend(solved.statistics)
            budget.report(Statistics())
        yield solved


@default_environment()
def _solve_batch(parts: Sequence[Subproblem], options: SolverOptions) -> list[SolvedSubproblem]:
    """Solve parts one after another in a worker, as time allows."""
    budget = Budget(options)
    solved: list[SolvedSubproblem] = []
    for part in parts:
        if budget.is_over():
            break
        solved.append(solve_subproblem(part, Budget(budget.remaining())))
    return solved


def _solved_by_workers(
    submit: Callable[..., Future[list[SolvedSubproblem]]],
    parts: Iterable[Subproblem],
    limits: Budget,
    stopped: Callable[[], bool],
) -> Iterator[tuple[Subproblem, SolvedSubproblem]]:
    """Solve parts in workers, each within the same limits."""
    waiting: list[tuple[list[Subproblem], Future[list[SolvedSubproblem]]]] = []
    left = iter(parts)
    try:
        while not stopped() and (batch := list(islice(left, PARTS_PER_TASK))):
            waiting.append((batch, submit(_solve_batch, batch, limits.remaining())))
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
    """Return the result of a task, or nothing if the time is over."""
    while True:
        try:
            return future.result(timeout=LOOK_S)
        except TimeoutError:
            if future.done():
                # The task has finished, or raised this error itself.
                return future.result()
            if stopped():
                return []


MOST_WHOLE = 16
"""A piece of more points in the plane is solved in patches."""

MOST_PATCH_BOXES = 200
MOST_SEAM_BOXES = 40
MOST_REVIEW_BOXES = 12
"""Most boxes of one patch; seam and review patches that need more are discarded."""

REVIEW_POINTS = 14
"""Most points of a patch that reviews an ambiguous patch."""


@dataclass
class SolvedPatches:
    """The patches of a piece."""

    patches: list[Patch]
    known: KnownPairs
    is_one_body: bool = False  # whether they hold all points of the piece together
    n_unsolved: int = 0  # number of patches not begun for lack of time

    def is_empty(self) -> bool:
        """Return whether a patch has no hypothesis left, so that there is no placement."""
        return len(self.patches) == 1 and not self.patches[0].left.any()

    def is_complete(self) -> bool:
        """Return whether all patches were examined completely."""
        return self.n_pending() == 0

    def n_boxes(self) -> int:
        """Return the number of boxes of the patches; an unsolved patch counts as one."""
        return sum(patch.n_boxes() for patch in self.patches) + self.n_unsolved

    def n_pending(self) -> int:
        """Return the number of boxes that were not examined."""
        return sum(patch.n_pending() for patch in self.patches) + self.n_unsolved


class PatchSolver:
    """Solves a piece in patches."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        share: float,
        within: Sequence[Bounds] | None,
        is_reviewed: bool,
    ) -> None:
        self._problem = problem
        self._budget = budget
        self._within = within
        self._is_over = budget.has_passed(share)
        self._is_reviewed = is_reviewed
        self._pairs: list[Pair] = [(i, j) for i, j in problem.pairs.measured.tolist()]
        self._tried: set[Points] = set()
        self._measured = Neighborhoods(problem.n_points, self._pairs, problem.dimension)

    def run(self) -> SolvedPatches | None:
        """Return the solved patches; None if no neighborhood is rigid."""
        q = self._problem.dimension
        if q != 2:
            # In space few neighborhoods of so few points are rigid.
            return None
        seeds = [tuple(sorted(points_of(constraint))) for constraint in self._problem.constraints]
        chosen = covering_patches(self._measured, self._pairs, seeds, PATCH_POINTS, self._is_over)
        n_unsolved = int(self._is_over())
        if max(map(len, chosen), default=0) <= q + 1 and not n_unsolved:
            return None
        patches = list(self._solved(chosen, None, MOST_PATCH_BOXES))
        n_unsolved += len(chosen) - len(patches)
        while True:
            known, empty = self._narrowed(patches)
            if empty is not None:
                return SolvedPatches([empty], known)
            # Patches that share only q points may be mirrored in them, unless a third prevents it.
            bodies = joined_bodies([patch.points for patch in patches], q + 1)
            bodies.sort(key=lambda body: (-len(body), min(body)))
            new = [] if self._is_over() else list(self._further(known, patches, bodies))
            if not new:
                return SolvedPatches(patches, known, self._is_one(bodies), n_unsolved)
            patches += new

    def _solved(
        self,
        chosen: Sequence[Points],
        known: KnownPairs | None,
        most_boxes: int,
        all_or_nothing: bool = False,
    ) -> Iterator[Patch]:
        """Solve patches within the known bounds of their pairs, as time allows."""
        parts = (
            Subproblem(
                restricted(self._problem, points, known.among(points) if known else None),
                restricted_boxes(self._within, points),
                all_or_nothing,
            )
            for points in chosen
        )
        solved = solve_subproblems(parts, self._budget, most_boxes, self._is_over)
        for points, found in zip(chosen, solved, strict=False):
            pending = {box[: UPPER + 1].tobytes() for box in found.cover.pending}
            yield Patch(points, list(found.hypotheses), pending)

    def _narrowed(self, patches: Sequence[Patch]) -> tuple[KnownPairs, Patch | None]:
        """Return the pairs of all patches, and a patch without a hypothesis left, if any."""
        known = KnownPairs(self._problem, self._pairs, patches)
        while True:
            number = known.narrow()
            if number is not None:
                patches[number].left[:] = False
                return known, patches[number]
            ambiguities = Ambiguities(patches, known, self._is_over)
            if self._is_over() or not ambiguities.drop_unmatched():
                return known, None

    def _further(
        self, known: KnownPairs, patches: Sequence[Patch], bodies: Sequence[set[int]]
    ) -> Iterator[Patch]:
        """Yield patches across the seams between bodies, and reviews of ambiguous patches."""
        q = self._problem.dimension
        ends = zip(*known.pairs.T.tolist(), strict=True)
        graph = Neighborhoods(self._problem.n_points, ends, q)
        seams = [] if self._is_one(bodies) else seam_patches(graph, bodies, q, self._is_over)
        reviews = [
            self._review(patch, graph)
            for patch in patches
            if self._is_reviewed and patch.left.sum() > 1 and not self._is_over()
        ]
        for chosen, most in ((seams, MOST_SEAM_BOXES), (reviews, MOST_REVIEW_BOXES)):
            new = [points for points in dict.fromkeys(chosen) if points not in self._tried]
            self._tried.update(new)
            solved = self._solved([*filter(None, new)], known, most, all_or_nothing=True)
            # Incomplete patches are discarded: nothing depends on them.
            yield from (patch for patch in solved if not patch.pending)

    def _is_one(self, bodies: Sequence[set[int]]) -> bool:
        """Return whether one body has all points."""
        return bool(bodies) and len(bodies[0]) == self._problem.n_points

    def _review(self, patch: Patch, graph: Neighborhoods) -> Points:
        """Return a rigid part around a patch and its most ambiguous point, or nothing."""
        lengths = np.array([np.sqrt(h.lower) + np.sqrt(h.upper) for h in patch.remaining()])
        # Its distances differ most between the hypotheses of the patch.
        point = patch.points[int(np.argmax(np.ptp(lengths, axis=0).sum(axis=0)))]
        seed = self._measured.neighbors[point].union(patch.points)
        if not len(patch.points) < len(seed) <= REVIEW_POINTS:
            return ()
        return graph.rigid_part(graph.grown(seed, REVIEW_POINTS), patch.points)
