# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Large problems end soon after they are stopped, wherever that is, and hold the truth."""

from joined_cases import missing
import numpy as np
import pytest
from solver_cases import squared_distances
from test_patches import CancelAfter, braced_grid

from dg_localization import SolverOptions, Verdict, solve

MOST_LOOKS_AFTER = 40
"""A piece that was begun may look again at each of its steps before it ends."""


@pytest.mark.parametrize(('size', 'holes'), [((5, 6), 0.2), ((7, 9), 0.2), ((9, 9), 0.0)])
def test_a_call_that_is_cancelled_ends_soon_and_holds_the_truth(size, holes):
    problem, positions = braced_grid(*size, 0.01, holes=holes)
    squared = squared_distances(positions)
    whole = CancelAfter(10**9)
    solve(problem, SolverOptions(max_boxes=10**6), cancel=whole)
    n_looks = 10**9 - whole.left
    for most in np.unique(np.geomspace(1, 0.9 * n_looks, 12).astype(int)).tolist():
        cancel = CancelAfter(most)
        result = solve(problem, SolverOptions(max_boxes=10**6), cancel=cancel)
        assert -cancel.left < MOST_LOOKS_AFTER + 2 * len(result.pieces), most
        assert result.verdict is not Verdict.INFEASIBLE, most
        assert not missing(result, positions, squared), most
        for piece in result.pieces:
            for part in (piece, *piece.patches):
                true = squared[np.ix_(part.points, part.points)]
                held = ((h.lower <= true) & (true <= h.upper) for h in part.hypotheses)
                assert any(inside.all() for inside in held), most


@pytest.mark.parametrize('max_seconds', [1e-9, 1e-3, 1e-2])
def test_time_that_is_over_is_never_a_complete_answer(max_seconds):
    problem, positions = braced_grid(9, 9, 0.01)
    result = solve(problem, SolverOptions(max_boxes=10**6, max_seconds=max_seconds))
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert not missing(result, positions, squared_distances(positions))
