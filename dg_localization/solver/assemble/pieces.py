# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The pieces of a fleet, solved one by one.

A piece takes distances of shared points from another piece that knows them far better than the
measurements do. Without them it may not be rigid, or one box may hold several placements. It is
solved once for each of the possible ranges of these distances.

Some pieces decompose after a part that hangs on them is removed: such a part connects the points
on both sides of a separating set and so hides it. The parts of such a piece are solved like the
pieces of a fleet, and combined.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import chain, product
import math

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, until
from dg_localization.solver.assemble.growing import is_grown, solve_grown
from dg_localization.solver.assemble.product import Product
from dg_localization.solver.assemble.solved_pieces import (
    Search,
    SolvedPiece,
    SolvedPieces,
    common_ranges,
    hull_of_ranges,
    unexamined,
)
from dg_localization.solver.box import LOWER, UPPER
from dg_localization.solver.contract.linear import EXPLAINED_FACTOR
from dg_localization.solver.decompose.decomposition import Decomposition
from dg_localization.solver.decompose.graph import Pair, pairs_of
from dg_localization.solver.patches.answers import PatchAnswers
from dg_localization.solver.patches.neighborhoods import PATCH_POINTS
from dg_localization.solver.patches.solver import MOST_WHOLE, PatchSolver
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Joint, JointKind
from dg_localization.solver.search.budget import GRACE_S, Budget
from dg_localization.solver.search.search import accept_pending, search_in_one_box, search_share
from dg_localization.solver.subproblem import (
    MOST_CONTRACTED,
    MOST_TOGETHER,
    MOST_WORK,
    MOST_WORK_TOGETHER,
    Bounds,
    Ranges,
    pieces_of_problem,
    restricted,
    restricted_boxes,
)

PATCHES_SHARE = 0.5
"""Share of the time of a piece for its patches if it is contracted afterwards,"""

PATCHES_SHARE_ALONE = 0.7
"""and their share if only a placement follows."""

LARGEST_ERROR = 0.1
"""One box is tried first if half of the distances with an upper bound, measured or known from
anchors and earlier pieces, are known to this fraction of that bound. Otherwise one box rarely
covers all placements."""


def is_known_well(problem: Problem) -> bool:
    """Return whether distances are known so well that one box may cover all placements."""
    known = np.isfinite(problem.upper) & (problem.upper > 0.0)
    errors = 1.0 - np.sqrt(problem.lower[known] / problem.upper[known])
    return len(errors) > 0 and bool(np.median(errors) <= LARGEST_ERROR)


def solve_large(
    problem: Problem, budget: Budget, share: float, within: Sequence[Bounds] | None
) -> Search | None:
    """Solve a large piece in patches; return None if its neighborhoods are not rigid."""
    is_whole = problem.n_points <= MOST_TOGETHER
    share_of_patches = (PATCHES_SHARE if is_whole else PATCHES_SHARE_ALONE) * share
    # If distances are wide, contraction of a small piece rules out as much as reviews, and sooner.
    is_reviewed = problem.n_points > MOST_CONTRACTED or is_known_well(problem)
    solved = PatchSolver(problem, budget, share_of_patches, within, is_reviewed).run()
    if solved is None:
        return None
    if solved.is_empty():
        return Search(problem, [], [])
    answers = PatchAnswers(problem, solved, within, budget)
    most = budget.options.max_hypotheses
    boxes = answers.boxes(most) if is_whole else []
    is_done = solved.is_one_body and solved.is_complete()
    if not is_whole or (is_done and len(boxes) * problem.n_points**3 > MOST_WORK):
        return Search(problem, [], [], answers.hypotheses(most), solved)
    budget.go_on_from(solved.n_boxes() - solved.n_pending())
    if not is_done:
        # Halves of wide distances would only split the hypotheses that the patches found.
        at_gaps = solved.is_complete() and not is_known_well(problem)
        cover = search_share(problem, budget, share, boxes, at_gaps=at_gaps)
        return Search(problem, cover.kept, cover.pending)
    is_split = len(boxes) * problem.n_points**3 <= MOST_WORK_TOGETHER
    most_boxes = 2 * len(boxes) if is_split else len(boxes)
    cover = search_share(problem, budget, PATCHES_SHARE * share, boxes, most_boxes)
    # The patches were examined completely, and so are these boxes.
    accept_pending(cover, budget)
    return Search(problem, cover.kept, cover.pending)


MOST_RANGES = 16
"""Most solves of one piece, for different ranges of its given distances."""

TRIPLES_PER_S = 800 * WORK_PER_LOOK
"""Approximate number of triangles of a box examined per second, twice each."""


class PieceSolver:
    """Solves the pieces of a decomposition in their order."""

    def __init__(
        self,
        problem: Problem,
        decomposition: Decomposition,
        budget: Budget,
        within: Sequence[Bounds] | None,
        share: float = 1.0,
    ) -> None:
        self._problem = problem
        self._share_of_all = share
        self._budget = budget
        self._within = within
        self._points = decomposition.pieces
        self._joints = decomposition.joints
        self._joints_of: list[list[Joint]] = [[] for _ in self._points]
        for joint in self._joints:
            for number in joint.pieces:
                self._joints_of[number].append(joint)
        self._solved: dict[int, SolvedPiece] = {}

    def run(self) -> SolvedPieces:
        """Solve all pieces, until one of them has no hypothesis."""
        for number in range(len(self._points)):
            if not self._is_too_late(number):
                self._solve(number)
                piece = self._solved[number]
                if not piece.hypotheses:
                    return SolvedPieces(contradiction=piece.points)
        for piece in chain(self._solved_again(), self._resumed()):
            if not piece.hypotheses:
                return SolvedPieces(contradiction=piece.points)
        answer = SolvedPieces(list(self._solved.values()))
        place = {number: x for x, number in enumerate(self._solved)}
        for joint in self._joints:
            numbers = {place[number] for number in joint.pieces if number in place}
            if len(numbers) > 1:
                answer.joints.append(Joint(tuple(sorted(numbers)), joint.points, joint.kind))
        not_begun = [x for n, points in enumerate(self._points) if n not in place for x in points]
        if not_begun:
            points = tuple(sorted(set(not_begun)))
            answer.pieces.append(unexamined(self._problem, points, self._within))
        return answer

    def _is_too_late(self, number: int) -> bool:
        """Return whether there is too little time to begin a piece."""
        if number and self._budget.is_overdue():
            return True
        # In space one box is as large as the piece, and its first contraction cannot be stopped.
        left_s = GRACE_S
        if not self._budget.is_over():
            left_s = max(left_s, self._budget.seconds_left())
        n_triples = len(self._points[number]) ** 3
        return self._problem.dimension == 3 and n_triples > left_s * TRIPLES_PER_S

    def _share(self, number: int) -> float:
        """Return the share of the remaining budget that a piece may take at first."""
        if len(self._points) == 1:
            return self._share_of_all
        n_points = len(self._points[number])
        if n_points > MOST_CONTRACTED or is_grown(n_points, self._problem.dimension):
            # Such a piece is not resumed later.
            return self._share_of_all * n_points / sum(map(len, self._points[number:]))
        return self._share_of_all / (len(self._points) - number)

    def _solve(self, number: int) -> None:
        """Solve a piece for all ranges that other pieces give for its shared pairs."""
        share = self._share(number)
        piece = SolvedPiece(self._points[number])
        given = self._given(number)
        within = restricted_boxes(self._within, piece.points)
        for x, bounds in enumerate(given):
            problem = restricted(self._problem, piece.points, bounds)
            if problem is not None:
                part = share / (len(given) - x)
                piece.searches.append(search_piece(problem, self._budget, part, within))
        piece.gather(self._budget)
        self._solved[number] = piece

    def _solved_again(self) -> Iterator[SolvedPiece]:
        """Solve small pieces again where other pieces know a shared distance far better."""
        for number, former in reversed(self._solved.items()):
            if len(former.points) > MOST_WHOLE or self._budget.is_over():
                continue
            joints = self._joints_of[number]
            found = (self._better_known(number, joint, former.widest) for joint in joints)
            if any(chain.from_iterable(found)):
                self._solve(number)
                if self._solved[number].is_finished:
                    yield self._solved[number]
                else:
                    self._solved[number] = former

    def _better_known(
        self, number: int, joint: Joint, width_m2: Callable[[Pair], float]
    ) -> Iterator[tuple[SolvedPiece, dict[Pair, float]]]:
        """Yield the other pieces at a joint, with pairs far narrower there and their widths."""
        for other in (self._solved[x] for x in joint.pieces if x in self._solved and x != number):
            known = {pair: other.widest(pair) for pair in pairs_of(joint.points)}
            better = {x: w for x, w in known.items() if EXPLAINED_FACTOR * w < width_m2(x)}
            if better:
                yield other, better

    def _resumed(self) -> Iterator[SolvedPiece]:
        """Resume the pieces that were not finished, small ones first."""
        pieces = sorted(self._solved.values(), key=lambda piece: len(piece.points))
        searches = [(piece, s) for piece in pieces for s in piece.searches if s.pending]
        for x, (piece, search) in enumerate(searches):
            if self._budget.is_over():
                break
            starts = [(box[LOWER], box[UPPER]) for box in search.pending]
            self._budget.take_back(len(starts))
            share = self._share_of_all / (len(searches) - x)
            cover = search_share(search.problem, self._budget, share, starts)
            search.kept += cover.kept
            search.pending, search.found = cover.pending, None
            piece.gather(self._budget)
            yield piece

    def _given(self, number: int) -> list[Ranges]:
        """Return the ranges of shared pairs that other pieces know far better than measured."""
        choices: list[list[Ranges]] = []
        for joint in self._joints_of[number]:
            if self._solved.keys().isdisjoint(joint.pieces):
                continue
            face = pairs_of(joint.points)
            ends = np.array(face, dtype=np.int64).reshape(-1, 2).T
            lower, upper = self._problem.pairs.of(*ends)
            widths = dict(zip(face, (upper - lower).tolist(), strict=True))
            for other, better in self._better_known(number, joint, widths.__getitem__):
                choices.append(other.ranges_of([*better]))
                widths.update(better)
        # The patches of a large piece hold all placements at once.
        most = 1 if len(self._points[number]) > MOST_CONTRACTED else MOST_RANGES
        while math.prod(len(ranges) for ranges in choices) > most:
            longest = max(range(len(choices)), key=lambda x: len(choices[x]))
            choices[longest] = [hull_of_ranges(choices[longest])]
        return [common_ranges(ranges) for ranges in product(*choices)]


def search_piece(
    problem: Problem, budget: Budget, share: float, within: Sequence[Bounds] | None
) -> Search:
    """Solve a piece in parts if it has several and they finish in time, else as one."""
    parts = _hidden_parts(problem, budget)
    if parts and (found := _search_in_parts(problem, parts, budget, share, within)):
        return found
    cover = solve_grown(problem, budget, share, within)
    if cover is None and problem.n_points > MOST_WHOLE:
        if within is None and problem.n_points <= MOST_TOGETHER and is_known_well(problem):
            cover = search_in_one_box(problem, budget)
            if cover.pending:
                boxes = np.array(cover.kept + cover.pending)
                within = [(boxes[:, LOWER].min(axis=0), boxes[:, UPPER].max(axis=0))]
                cover = None
        if cover is None:
            large = solve_large(problem, budget, share, within)
            if large is not None:
                return large
    if cover is None:
        cover = search_share(problem, budget, share, within)
    return Search(problem, cover.kept, cover.pending)


def _hidden_parts(problem: Problem, budget: Budget) -> Decomposition | None:
    """Return the parts of a piece; None if it has only one part or the time is over."""
    parts = None
    # One that is no larger than a patch is searched as a whole in less time.
    if PATCH_POINTS < problem.n_points <= MOST_TOGETHER:
        with until(budget.is_over):
            parts = pieces_of_problem(problem)
    if parts is None or len(parts.pieces) == 1:
        return None
    if any(joint.kind is not JointKind.REFLECTION for joint in parts.joints):
        return None
    return parts


def _search_in_parts(
    problem: Problem,
    parts: Decomposition,
    budget: Budget,
    share: float,
    within: Sequence[Bounds] | None,
) -> Search | None:
    """Solve a piece in parts; return None if some take too long."""
    solved = PieceSolver(problem, parts, budget, within, share).run()
    if solved.contradiction is not None:
        return Search(problem, [], [])
    counts = [piece.n_boxes(range(len(piece.hypotheses))) for piece in solved.pieces]
    budget.go_on_from(sum(n_boxes - n_pending for n_boxes, n_pending in counts))
    if not all(piece.is_finished for piece in solved.pieces):
        return None
    boxes, start_of = Product(problem, solved, budget, within).boxes()
    if not budget.keep(len(boxes)):
        return None
    found = hypotheses_of(problem, boxes, (), budget.new_clock, start_of)
    return Search(problem, boxes, [], found)
