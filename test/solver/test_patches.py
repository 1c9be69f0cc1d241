# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Large pieces: solved in patches, nothing is lost and nothing more is claimed."""

from joined_cases import check_counts, missing, solve_as_one
import numpy as np
import pytest
from solver_cases import bounds, braced_grid, holding, squared_distances

from benchmarks.large import fleet
from benchmarks.pieces import neighbors, uwb_fleet
from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.solver.patches.chains import ChainGraph


def all_parts_hold(result, squared):
    """Return whether the truth is in a hypothesis of each piece and of each of its patches."""
    parts = [part for piece in result.pieces for part in (piece, *piece.patches)]
    return all(holding(one.hypotheses, squared[np.ix_(one.points, one.points)]) for one in parts)


@pytest.mark.parametrize('size', [(5, 5), (5, 9), (9, 9)])
@pytest.mark.parametrize('error', [1e-9, 0.002])
def test_a_large_grid_is_one_hypothesis_that_holds_the_truth(size, error):
    problem, positions = braced_grid(*size, error)
    result = solve(problem, SolverOptions(max_boxes=10**6))
    assert result.verdict is Verdict.COVERED
    (piece,) = result.pieces
    (hypothesis,) = piece.hypotheses
    assert hypothesis.proved and not hypothesis.flexible
    assert holding([hypothesis], squared_distances(positions), 1e-12)
    assert np.isfinite(hypothesis.upper).all()


@pytest.mark.parametrize('error', [0.01, 0.03])
def test_a_placement_is_proved_where_many_choices_of_patches_are_left(error):
    """The first choice that agrees patch by patch is not one of the whole piece."""
    problem, _ = fleet(100, 8, error, 1)
    result = solve(problem, SolverOptions(max_boxes=10**6, max_seconds=60.0))
    piece = max(result.pieces, key=lambda piece: len(piece.points))
    assert len(piece.points) > 60
    assert any(len(patch.hypotheses) > 1 for patch in piece.patches)
    assert any(hypothesis.proved for hypothesis in piece.hypotheses)


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('error', [0.01, 0.03])
@pytest.mark.parametrize('answer', [solve, solve_as_one])
def test_a_grid_with_holes_keeps_the_truth(seed, error, answer):
    problem, positions = braced_grid(5 + seed % 4, 8, error, seed, holes=0.3)
    squared = squared_distances(positions)
    within = [(0.9 * squared, 1.1 * squared), (squared, 2.0 * squared)] if seed % 2 else None
    most = 300 if seed % 2 and answer is solve else 20
    result = answer(problem, SolverOptions(max_boxes=most), within=within)
    assert result.verdict is not Verdict.INFEASIBLE
    assert (result.verdict is Verdict.OUT_OF_BUDGET) == (result.statistics.pending > 0)
    assert answer is solve_as_one or not missing(result, positions)
    assert all_parts_hold(result, squared)


def test_patches_that_were_not_examined_take_no_boxes_of_other_pieces():
    grid, _ = braced_grid(5, 5, 0.05)
    lower, upper = bounds(27, {(25, 26): (1.0, 1.0)})
    lower[:25, :25], upper[:25, :25] = grid.lower, grid.upper
    for max_boxes in (1, 2, 5):
        check_counts(solve(Problem(lower, upper), SolverOptions(max_boxes=max_boxes)))


def test_a_contradiction_between_patches_is_a_proof():
    problem, _ = braced_grid(8, 8, 0.001)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    for bound in (lower, upper):
        bound[[0, 1], [1, 0]] *= 1.2
    result = solve(Problem(lower, upper))
    assert result.verdict is Verdict.INFEASIBLE
    assert {0, 1} <= set(result.pieces[0].points)


def test_chains_bound_far_pairs_from_above_and_near_ones_from_below():
    pairs = np.array([[0, 1], [1, 2], [2, 3]])
    graph = ChainGraph(5, pairs, np.array([25.0, 1.0, 1.0]), np.array([36.0, 4.0, 9.0]))
    lower, upper = graph.bounds(np.arange(5))
    np.testing.assert_allclose(np.sqrt(upper[0, :4]), [0.0, 6.0, 8.0, 11.0])
    np.testing.assert_allclose(np.sqrt(lower[0, :4]), [0.0, 5.0, 3.0, 0.0], atol=1e-12)
    assert upper[0, 2] >= 64.0 and lower[0, 2] <= 9.0
    assert np.isinf(upper[4, :4]).all() and upper[4, 4] == 0.0
    repeated = np.array([3, 0, 3, 3, 1, 0])
    for bound, of_some in zip((lower, upper), graph.bounds(repeated), strict=True):
        assert (of_some == bound[np.ix_(repeated, repeated)]).all()


@pytest.mark.parametrize(('degree', 'seed', 'n_hypotheses'), [(5, 110, 16), (6, 165, 48)])
def test_bodies_of_wide_distances_are_not_split_in_the_middle(degree, seed, n_hypotheses):
    positions, _ = neighbors(30, degree, 2, seed)
    result = solve(uwb_fleet(30, degree, seed), SolverOptions(max_boxes=10**4))
    assert result.verdict is Verdict.COVERED and result.statistics.processed < 300
    assert max(len(piece.hypotheses) for piece in result.pieces) == n_hypotheses
    assert not missing(result, positions)


def test_what_is_proved_of_a_large_piece_lies_within_the_boxes():
    problem = uwb_fleet(70, 9, 5)
    squared = squared_distances(neighbors(70, 9, 2, 5)[0])
    whole = solve(problem)
    near = (np.maximum(whole.lower, 0.98 * squared), np.minimum(whole.upper, 1.02 * squared))
    n_proved = 0
    for within in (None, [near]):
        for piece in solve(problem, within=within).pieces:
            for found in piece.hypotheses:
                if found.proved:
                    n_proved += 1
                    assert holding([found], squared_distances(found.positions), 1e-9)
    assert n_proved
