# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Placements of large pieces, and reviews of patches that are given up."""

import numpy as np
from solver_cases import squared_distances

from benchmarks.large import fleet
from dg_localization import SolverOptions, Verdict, solve
from dg_localization.solver.assemble.tasks import Subproblem, solve_subproblem
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.budget import Budget


def test_a_thousand_points_have_a_proved_placement():
    problem, positions = fleet(1000, 10, 0.03, 0)
    result = solve(problem, SolverOptions(max_boxes=10**9, max_seconds=60.0))
    assert result.verdict is Verdict.COVERED
    largest = max(result.pieces, key=lambda piece: len(piece.points))
    (hypothesis,) = largest.hypotheses
    assert hypothesis.proved
    # Other coordinates than the truth, in all of its bounds.
    members = list(largest.points)
    known = problem.pairs.restricted(members)
    first, second = known.pairs.T
    squared = ((hypothesis.positions[first] - hypothesis.positions[second]) ** 2).sum(axis=1)
    assert ((known.lower <= squared) & (squared <= known.upper)).all()


def test_a_search_that_cannot_end_in_time_is_given_up():
    # A chain of triangles, each of which may be mirrored: 2^5 placements.
    grid = np.array([[0.5 * x, x % 2] for x in range(8)]) * 4.0
    squared = squared_distances(grid)
    near = np.abs(np.subtract.outer(np.arange(8), np.arange(8))) <= 2
    problem = Problem(np.where(near, squared, 0.0), np.where(near, 1.001 * squared, np.inf))
    options = SolverOptions(max_boxes=12, resolution=0.01)
    whole, hopeless = (
        solve_subproblem(Subproblem(problem, None, x), Budget(options)) for x in (False, True)
    )
    assert whole.statistics.processed == 12
    assert whole.cover.pending
    assert hopeless.cover.pending
    assert hopeless.statistics.processed < 12
    assert not hopeless.hypotheses
    assert hopeless.statistics.processed + hopeless.statistics.pending > 12
    enough = SolverOptions(max_boxes=1000, resolution=0.01)
    ended = [solve_subproblem(Subproblem(problem, None, x), Budget(enough)) for x in (False, True)]
    assert ended[0].statistics.processed == ended[1].statistics.processed
    assert len(ended[0].hypotheses) == len(ended[1].hypotheses) > 8
