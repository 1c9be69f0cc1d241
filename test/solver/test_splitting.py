# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where a box is split."""

import numpy as np
import pytest
from solver_cases import bounds, squared_distances

from dg_localization import Problem, SolverOptions, Verdict, solve


def test_exact_pairs_beside_wide_ones_do_not_make_a_patch_flexible():
    rng = np.random.default_rng(0)
    n_points = 12
    squared = squared_distances(rng.uniform(0.0, 0.5, (n_points, 3)))
    lower, upper = np.zeros_like(squared), np.full_like(squared, np.inf)
    np.fill_diagonal(upper, 0.0)
    pairs = np.argwhere(np.triu(np.ones_like(squared), 1))
    for number, (i, j) in enumerate(rng.permutation(pairs)[:53]):
        error_m = 0.05 if number >= 15 else 1e-12
        distance_m = np.sqrt(squared[i, j])
        lower[i, j] = lower[j, i] = max(0.0, distance_m - error_m) ** 2
        upper[i, j] = upper[j, i] = (distance_m + error_m) ** 2
    result = solve(Problem(lower, upper, 3), SolverOptions(resolution=0.01, max_boxes=20))
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == result.statistics.kept == 1


@pytest.mark.parametrize('dimension', [1, 2, 3])
def test_a_bar_of_any_length_takes_one_box(dimension):
    result = solve(Problem(*bounds(2, {(0, 1): (1.0, 9.0)}), dimension))
    assert result.verdict is Verdict.COVERED
    assert (result.statistics.processed, result.n_hypotheses) == (1, 1)
    assert (result.lower[0, 1], result.upper[0, 1]) == pytest.approx((1.0, 9.0), rel=1e-12)


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_wide_triangle_takes_one_box_whose_ends_are_all_placements(dimension):
    ranges_m = {(0, 1): (3.0, 9.0), (0, 2): (1.0, 4.0), (1, 2): (1.0, 3.0)}
    ranges = {pair: (low**2, high**2) for pair, (low, high) in ranges_m.items()}
    result = solve(Problem(*bounds(3, ranges), dimension))
    assert result.verdict is Verdict.COVERED
    assert (result.statistics.processed, result.n_hypotheses) == (1, 1)
    # The far end of the first pair needs both others at their longest.
    ends = [(np.sqrt(result.lower[i, j]), np.sqrt(result.upper[i, j])) for i, j in ranges_m]
    assert ends == [pytest.approx(end) for end in ((3.0, 7.0), (1.0, 4.0), (1.0, 3.0))]


def test_three_points_on_a_line_are_told_apart():
    """What the triangle inequalities allow is not all of it there: one of them is an equation."""
    lower, upper = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 1.0], [0.0, 1.0, 0.0]]), np.ones((3, 3))
    np.fill_diagonal(upper, 0.0)
    upper[0, 2] = upper[2, 0] = 9.0
    result = solve(Problem(lower, upper, dimension=1))
    assert result.verdict is Verdict.COVERED
    widths_m2 = [(h.upper - h.lower).max() for h in result.hypotheses]
    assert len(widths_m2) == 2 and max(widths_m2) < 1e-3
