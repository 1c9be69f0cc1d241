# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The answer to a problem, in pieces: decompose, solve, link, combine."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from dg_localization.interval.kernels import until
from dg_localization.solver.assemble.pieces import PieceSolver
from dg_localization.solver.assemble.product import Nothing, Product
from dg_localization.solver.assemble.solved_pieces import SolvedPiece, SolvedPieces, unexamined
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.sides import known_apexes
from dg_localization.solver.decompose.decomposition import Decomposition
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.decompose.rigid_components import joined_bodies
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Piece, Result, Verdict
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import search_in_one_box
from dg_localization.solver.subproblem import (
    MOST_DENSE,
    Bounds,
    pieces_of_problem,
    with_shared_bounds,
)


def solve_in_pieces(
    problem: Problem,
    budget: Budget,
    within: Sequence[Bounds] | None = None,
    decomposition: Decomposition | None = None,
) -> Result:
    """Return every placement of a problem, in pieces."""
    every = tuple(range(problem.n_points))
    if problem.n_points > MOST_DENSE:
        problem = problem.sparse()
    shared = with_shared_bounds(problem)
    if shared is None or (within is not None and len(within) == 0):
        return _infeasible(every, problem, budget)
    problem = shared
    if decomposition is None:
        with until(budget.is_over):
            decomposition = pieces_of_problem(problem)
    solved = _solved(problem, decomposition, budget, within)
    if solved.contradiction is not None:
        return _infeasible(solved.contradiction, problem, budget)
    product = Product(problem, solved, budget, within)
    if not product.number:
        piece = product.combinations.contradiction
        points = every if piece is None else solved.pieces[piece].points
        return _infeasible(points, problem, budget)
    return _result(product, budget)


def _solved(
    problem: Problem,
    decomposition: Decomposition | None,
    budget: Budget,
    within: Sequence[Bounds] | None,
) -> SolvedPieces:
    """Return the solved pieces of a fleet; without a decomposition, one unexamined piece."""
    if decomposition is None:
        return SolvedPieces([unexamined(problem, tuple(range(problem.n_points)), within)])
    solved = None
    if within is None and _may_be_one_piece(problem, decomposition):
        solved = _solved_in_one_box(problem, budget)
    return solved or PieceSolver(problem, decomposition, budget, within).run()


def _may_be_one_piece(problem: Problem, decomposition: Decomposition) -> bool:
    """Return whether known sides or chiralities tell the sides of all pieces of a small fleet."""
    pieces, joints = decomposition.pieces, decomposition.joints
    n_linked = sum(len(joint.pieces) - 1 for joint in joints)
    if problem.n_points > SMALL_FLEET or not 0 < n_linked == len(pieces) - 1:
        return False
    known = known_apexes(problem)
    for joint in joints:
        # The pieces that have an apex in each group, whose sides of the face are known.
        told: dict[int, set[int]] = {}
        for face, group, apex, _ in known:
            if face == joint.points:
                on_sides = (x for x in joint.pieces if apex in pieces[x])
                told.setdefault(group, set()).update(on_sides)
        if set(joint.pieces) not in joined_bodies([*told.values()], 1):
            return False
    return True


def _solved_in_one_box(problem: Problem, budget: Budget) -> SolvedPieces | None:
    """Return a fleet as one piece if a single box covers it, else None."""
    cover = search_in_one_box(problem, budget)
    if cover.pending:
        return None
    points = tuple(range(problem.n_points))
    hypotheses = hypotheses_of(problem, cover.kept)
    if not hypotheses:
        return SolvedPieces(contradiction=points)
    return SolvedPieces([SolvedPiece(points, [], hypotheses)])


def _infeasible(points: Points, problem: Problem, budget: Budget) -> Result:
    """Return the answer that there is no placement, with the piece that has no hypothesis."""
    spent = budget.spent
    empty, seconds = spent.empty + spent.kept, budget.seconds()
    statistics = replace(spent, empty=empty, kept=0, pending=0, seconds=seconds)
    piece = Piece(points, ())
    return Result(Verdict.INFEASIBLE, statistics, (piece,), (), 0, Nothing(problem.n_points))


def _result(product: Product, budget: Budget) -> Result:
    """Return the answer made of the pieces and their combinations."""
    solved, combinations = product.solved, product.combinations
    pieces, kept, pending = [], 0, 0
    for piece, left in zip(solved.pieces, map(sorted, combinations.left), strict=True):
        hypotheses = tuple(piece.hypotheses[x] for x in left)
        pieces.append(Piece(piece.points, hypotheses, tuple(_patches_of(piece))))
        n_boxes, n_pending = piece.n_boxes(left)
        kept, pending = kept + n_boxes - n_pending, pending + n_pending
    spent, seconds = budget.spent, budget.seconds()
    # Boxes that the neighbors of a piece rule out count as empty.
    empty = spent.empty + spent.kept - kept
    statistics = replace(spent, empty=empty, kept=kept, pending=pending, seconds=seconds)
    verdict = Verdict.OUT_OF_BUDGET if pending else Verdict.COVERED
    joints = tuple(solved.joints)
    return Result(verdict, statistics, tuple(pieces), joints, product.number, product)


def _patches_of(piece: SolvedPiece) -> Iterator[Piece]:
    """Yield the patches of a large piece, with the remaining hypotheses of each."""
    for search in piece.searches:
        for patch in search.patches.patches if search.patches else ():
            points = tuple(piece.points[x] for x in patch.points)
            yield Piece(points, tuple(patch.remaining()))
