# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The pieces of a fleet, solved one by one.

A piece that its own measurements do not hold rigid takes the distances of the points it shares
from a piece solved before: it is solved once for each of the ranges that these may lie in.

Some pieces come apart once what hangs on them is taken off: a part that two points hold joins what
lies on either side of these, and so it hides the sets of points that separate the rest. Each such
set doubles the placements of the piece; its parts are solved one by one, and combined.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, product
import math

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, until
from dg_localization.solver.assemble.budget import GRACE_S, CallBudget
from dg_localization.solver.assemble.coincident import pieces_of_problem
from dg_localization.solver.assemble.contraction import MOST_CONTRACTED
from dg_localization.solver.assemble.faces import is_degenerate
from dg_localization.solver.assemble.growing import is_grown, solve_grown
from dg_localization.solver.assemble.large_pieces import (
    MOST_TOGETHER,
    LargePiece,
    hull_of,
    is_known_well,
    solve_large,
)
from dg_localization.solver.assemble.product import Product
from dg_localization.solver.assemble.solved_pieces import (
    SolvedPiece,
    SolvedPieces,
    common_ranges,
    hull_of_ranges,
    ranges_of,
    unexamined,
)
from dg_localization.solver.assemble.subproblem import (
    Bounds,
    Orientations,
    Ranges,
    restricted,
    restricted_boxes,
)
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.decompose.decomposition import Decomposition
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.patches.solver import MOST_WHOLE
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis, Joint, JointKind
from dg_localization.solver.search.branch_and_prune import Cover

LEAST_PARTED, MOST_PARTED = 9, 60
"""Fewer points are searched as a whole in less time; more are solved in patches."""


def hidden_parts(problem: Problem, stopped: Callable[[], bool]) -> Decomposition | None:
    """Return the parts of a piece, None where it has one part only or the time is over."""
    if not LEAST_PARTED <= problem.n_points <= MOST_PARTED:
        return None
    parts = None
    with until(stopped):
        parts = pieces_of_problem(problem)
    if parts is None or len(parts.pieces) == 1:
        return None
    if any(joint.kind is not JointKind.REFLECTION for joint in parts.joints):
        return None
    return parts


MOST_RANGES = 16
"""A piece is solved at most so often, for different ranges of what it is given."""

TRIPLES_PER_S = 800 * WORK_PER_LOOK
"""About how many triangles of a box are looked at in a second, twice each."""

FIRST_SHARE = 0.5
"""At first a piece may take this part of a fair share: easy ones do not wait for hard ones."""


@dataclass
class _Search:
    """One problem of a piece, for one choice of what it is given, and its cover so far."""

    problem: Problem
    kept: list[FloatArray]
    pending: list[FloatArray]
    large: LargePiece | None = None
    found: Sequence[Hypothesis] | None = None  # what the cover makes, once it was looked for

    def is_pending(self) -> bool:
        """Return whether some boxes were not examined."""
        if self.large is not None and self.large.cover is None:
            return not self.large.patches.is_complete()
        return bool(self.pending)

    def hypotheses(self, stopped: Callable[[], bool]) -> Sequence[Hypothesis]:
        """Return the hypotheses that the cover makes, or those that patches made."""
        if self.large is not None and self.large.cover is None:
            return self.large.hypotheses
        if self.found is not None:
            return self.found
        return hypotheses_of(self.problem, self.kept + self.pending, stopped)


def _not_examined(hypothesis: Hypothesis, pending: set[bytes]) -> Hypothesis:
    """Return a hypothesis as a flexible one where some of its boxes were not examined."""
    if any(box.tobytes() in pending for box in hypothesis.boxes):
        return replace(hypothesis, flexible=True)
    return hypothesis


@dataclass(eq=False)
class _Task:
    """A piece that is to be solved, and what became of it."""

    points: Points
    numbers: list[int]  # in the decomposition: several where pieces were merged
    searches: list[_Search] = field(default_factory=list)
    hypotheses: list[Hypothesis] | None = None

    def is_pending(self) -> bool:
        """Return whether some boxes were not examined, and may be about anything."""
        return any(search.is_pending() for search in self.searches)

    def gather(self, stopped: Callable[[], bool]) -> None:
        """Write the hypotheses that the covers of all searches make."""
        for search in self.searches:
            search.found = search.hypotheses(stopped)
            if search.pending:
                keys = {box[: UPPER + 1].tobytes() for box in search.pending}
                search.found = [_not_examined(h, keys) for h in search.found]
        self.hypotheses = [found for search in self.searches for found in search.found or ()]

    def solved(self) -> SolvedPiece:
        """Return the piece as it is now."""
        pending = (box for search in self.searches for box in search.pending)
        keys = {box[: UPPER + 1].tobytes() for box in pending}
        large = [s.large.patches for s in self.searches if s.large and s.large.cover is None]
        return SolvedPiece(self.points, self.hypotheses or [], keys, large)


def _searched_together(
    problem: Problem, budget: CallBudget, share: float, within: Sequence[Bounds] | None
) -> _Search:
    """Solve a piece as one."""
    grown = solve_grown(problem, budget, share, within)
    if grown is not None:
        return _Search(problem, grown.kept, grown.pending)
    if problem.n_points <= MOST_WHOLE:
        cover = budget.search(problem, share, within)
        return _Search(problem, cover.kept, cover.pending)
    if within is None and problem.n_points <= MOST_TOGETHER and is_known_well(problem):
        in_one_box = budget.search_in_one_box(problem)
        if not in_one_box.pending:
            return _Search(problem, in_one_box.kept, [])
        within = [hull_of(in_one_box.kept + in_one_box.pending)]
    large = solve_large(problem, budget, share, within)
    if large is None:
        cover = budget.search(problem, share, within)
    else:
        cover = large.cover or Cover()
    return _Search(problem, cover.kept, cover.pending, large)


class PieceSolver:
    """Solves the pieces of a decomposition in their order."""

    def __init__(
        self,
        problem: Problem,
        decomposition: Decomposition,
        budget: CallBudget,
        within: Sequence[Bounds] | None,
        share: float = 1.0,
        finished: dict[Hashable, _Search] | None = None,
    ) -> None:
        self._problem = problem
        self._share_of_all = share
        self._are_parts = finished is not None
        self._finished = {} if finished is None else finished
        self._orientations = Orientations(problem)
        self._budget = budget
        self._within = within
        self._joints = decomposition.joints
        self._tasks = [
            _Task(points, [number]) for number, points in enumerate(decomposition.pieces)
        ]
        self._joints_of: list[list[Joint]] = [[] for _ in self._tasks]
        for joint in self._joints:
            for number in joint.pieces:
                self._joints_of[number].append(joint)

    def run(self) -> SolvedPieces:
        """Solve all pieces, until one of them cannot exist."""
        for number in range(len(self._tasks)):
            if self._is_too_late(number):
                continue
            self._merge_degenerate(number)
            task = self._tasks[number]
            self._solve(task, self._share(number))
            if not task.hypotheses:
                return SolvedPieces(contradiction=task.points)
        for task in self._resumed():
            if not task.hypotheses:
                return SolvedPieces(contradiction=task.points)
        return self._solved()

    def _is_too_late(self, number: int) -> bool:
        """Return whether a piece is not begun any more."""
        if number and self._budget.is_overdue():
            return True
        # In space one box is as large as the piece, and nothing ends its first contraction.
        n_points = len(self._tasks[number].points)
        left_s = GRACE_S
        if not self._budget.is_over():
            left_s = max(left_s, self._budget.seconds_left())
        return self._problem.dimension == 3 and n_points**3 > left_s * TRIPLES_PER_S

    def _hidden_parts(self, problem: Problem) -> Decomposition | None:
        """Return the parts of a piece that its wide distances do not hold together, if any."""
        # Parts that were merged may be the piece that they were parts of.
        is_parted = self._are_parts and problem.n_points == self._problem.n_points
        return None if is_parted else hidden_parts(problem, self._budget.is_over)

    def _share(self, number: int) -> float:
        """Return which part of what is left a piece may take at first."""
        if len(self._tasks) == 1:
            return self._share_of_all
        n_points = len(self._tasks[number].points)
        if n_points > MOST_CONTRACTED or is_grown(n_points, self._problem.dimension):
            # There is no second time for it.
            left = sum(len(task.points) for task in self._tasks[number:])
            return self._share_of_all * n_points / left
        return self._share_of_all * FIRST_SHARE / (len(self._tasks) - number)

    def _resumed(self) -> Iterator[_Task]:
        """Go on with the pieces that were not finished, small ones first."""
        tasks = sorted(set(self._tasks), key=lambda task: (len(task.points), task.numbers))
        searches = [(task, s) for task in tasks for s in task.searches if s.pending]
        for x, (task, search) in enumerate(searches):
            if self._budget.is_over():
                break
            starts = [(box[LOWER], box[UPPER]) for box in search.pending]
            self._budget.take_back(len(starts))
            share = self._share_of_all / (len(searches) - x)
            cover = self._budget.search(search.problem, share, starts)
            search.kept += cover.kept
            search.pending, search.found = cover.pending, None
            task.gather(self._budget.is_overdue)
            yield task

    def _merge_degenerate(self, number: int) -> None:
        """
        Merge a piece with those it shares a face with that spans no hyperplane.

        Pieces turn about such a face: what the graph takes for a reflection is a flex.
        """
        width_m = self._budget.options.resolution
        for joint in self._joints_of[number]:
            if joint.kind is not JointKind.REFLECTION:
                continue
            for other in joint.pieces:
                task, earlier = self._tasks[number], self._tasks[other]
                if earlier is task or earlier.hypotheses is None or earlier.is_pending():
                    continue
                # What was solved in patches is placed once for all; each other place takes long.
                is_placed = len(earlier.points) <= MOST_CONTRACTED
                placed = earlier.hypotheses if is_placed else earlier.hypotheses[:1]
                flat = (
                    not self._budget.is_over()
                    and is_degenerate(earlier.points, hypothesis, joint.points, width_m)
                    for hypothesis in placed
                )
                if any(flat):
                    merged = _Task(
                        tuple(sorted({*task.points, *earlier.points})),
                        task.numbers + earlier.numbers,
                    )
                    for x in merged.numbers:
                        self._tasks[x] = merged

    def _solve(self, task: _Task, share: float) -> None:
        """Solve a piece for all that earlier pieces say of its points."""
        given = self._given(task)
        within = self._within and restricted_boxes(self._within, task.points)
        constraints = self._orientations.among(task.points)
        for x, bounds in enumerate(given):
            problem = restricted(self._problem, task.points, bounds, constraints)
            if problem is not None:
                part = share / (len(given) - x)
                task.searches.append(self._searched(problem, part, within))
        task.gather(self._budget.is_overdue)

    def _searched(
        self, problem: Problem, share: float, within: Sequence[Bounds] | None
    ) -> _Search:
        """Solve a piece for one choice of what it is given, with a share of what is left."""
        if problem.n_points > MOST_PARTED:
            return _searched_together(problem, self._budget, share, within)
        ends = np.array([(problem.lower, problem.upper), *(within or ())])
        key = ends.tobytes(), problem.sides, problem.chiralities
        known = self._finished.get(key)
        if known and known.kept and self._budget.keep(len(known.kept)):
            return known
        search = self._searched_here(problem, share, within)
        if not search.is_pending():
            self._finished[key] = search
        return search

    def _searched_here(
        self, problem: Problem, share: float, within: Sequence[Bounds] | None
    ) -> _Search:
        """Solve a small piece in its parts, where it has any and they are done, or as one."""
        parts = self._hidden_parts(problem)
        in_parts = parts and self._searched_in_parts(problem, parts, share, within)
        return in_parts or _searched_together(problem, self._budget, share, within)

    def _searched_in_parts(
        self,
        problem: Problem,
        parts: Decomposition,
        share: float,
        within: Sequence[Bounds] | None,
    ) -> _Search | None:
        """Solve a piece in parts; None where some take too long."""
        budget = self._budget
        solved = PieceSolver(problem, parts, budget, within, share, self._finished).run()
        if solved.contradiction is not None:
            return _Search(problem, [], [])
        counts = [piece.n_boxes(range(len(piece.hypotheses))) for piece in solved.pieces]
        budget.go_on_from(sum(n_boxes - n_pending for n_boxes, n_pending in counts))
        if not all(piece.is_finished for piece in solved.pieces):
            return None
        boxes, start_of = Product(problem, solved, budget, within).boxes(budget.is_over)
        if not budget.keep(len(boxes)):
            return None
        found = hypotheses_of(problem, boxes, budget.is_overdue, start_of)
        return _Search(problem, boxes, [], found=found)

    def _given(self, task: _Task) -> list[Ranges]:
        """Return the bounds that earlier pieces put on pairs of a piece which nobody measured."""
        choices: list[list[Ranges]] = []
        for joint in (joint for number in task.numbers for joint in self._joints_of[number]):
            pairs = self._unmeasured(joint.points)
            solved = (self._tasks[x] for x in joint.pieces)
            holder = next((t for t in solved if t is not task and t.hypotheses), None)
            if pairs and holder is not None:
                choices.append(ranges_of(holder.points, holder.hypotheses or (), pairs))
        # The patches of a large piece hold all placements at once.
        most = 1 if len(task.points) > MOST_CONTRACTED else MOST_RANGES
        while math.prod(len(ranges) for ranges in choices) > most:
            longest = max(range(len(choices)), key=lambda x: len(choices[x]))
            choices[longest] = [hull_of_ranges(choices[longest])]
        return [common_ranges(ranges) for ranges in product(*choices)]

    def _unmeasured(self, points: Points) -> list[Pair]:
        """Return the pairs of a few points that nobody measured."""
        _, upper = self._problem.bounds_among(points)
        ends = combinations(range(len(points)), 2)
        return [(points[x], points[y]) for x, y in ends if math.isinf(upper[x, y])]

    def _solved(self) -> SolvedPieces:
        """Return the pieces under their final numbers, those that were not begun as one."""
        tasks = list(dict.fromkeys(self._tasks))
        begun = [task for task in tasks if task.hypotheses is not None]
        number_of = {task: number for number, task in enumerate(begun)}
        answer = SolvedPieces([task.solved() for task in begun])
        for joint in self._joints:
            solved = {self._tasks[x] for x in joint.pieces} & number_of.keys()
            numbers = sorted(number_of[task] for task in solved)
            if len(numbers) > 1:
                answer.joints.append(Joint(tuple(numbers), joint.points, joint.kind))
        left = sorted({point for task in set(tasks) - set(begun) for point in task.points})
        if left:
            answer.pieces.append(unexamined(self._problem, tuple(left), self._within))
        return answer
