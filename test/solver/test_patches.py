# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Large pieces: solved in patches, nothing is lost and nothing more is claimed."""

import pickle
import threading

from joined_cases import PROBLEMS, missing, solve_as_one
import numpy as np
import pytest
from solver_cases import bounds, random_case, squared_distances

from benchmarks.pieces import neighbors, uwb_fleet
from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.solver.assemble import large_pieces, pieces
from dg_localization.solver.patches import neighborhoods, solver
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.place import hypotheses, unplaced_hypotheses
from dg_localization.solver.search.search import search

SEEDS = range(max(200, PROBLEMS // 20))
CHUNK = 100
CHUNKS = [SEEDS[first : first + CHUNK] for first in range(0, len(SEEDS), CHUNK)]
ROUNDING = 1e-9


def first_and_last(seeds):
    return f'{seeds[0]}-{seeds[-1]}'


@pytest.fixture(params=['contracted', 'chained'])
def small_patches(request, monkeypatch):
    """Have small problems solved in patches, with or without a contraction of the whole."""
    monkeypatch.setattr(pieces, 'MOST_WHOLE', 3)
    # They are not tried in one box first.
    monkeypatch.setattr(pieces, 'MOST_CONTRACTED', 0)
    monkeypatch.setattr(pieces, 'MOST_TOGETHER', 0)
    monkeypatch.setattr(solver, 'PATCH_POINTS', 4)
    monkeypatch.setattr(neighborhoods, 'SEAM_POINTS', 5)
    if request.param == 'chained':
        monkeypatch.setattr(large_pieces, 'MOST_TOGETHER', 0)
        monkeypatch.setattr(large_pieces, 'MOST_UNREVIEWED', 0)
    return request.param


def braced_grid(rows, columns, error, seed=0, holes=0.0):
    """Return a grid whose points measure the eight about them, and its placement."""
    rng = np.random.default_rng(seed)
    positions = np.stack(np.unravel_index(np.arange(rows * columns), (rows, columns)), axis=1)
    positions = 5.0 * positions + rng.uniform(-1.0, 1.0, positions.shape)
    squared = squared_distances(positions)
    ranges = {
        (i, j): (squared[i, j] * (1 - error) ** 2, squared[i, j] * (1 + error) ** 2)
        for i, j in np.argwhere(np.triu(squared < 8.5**2, 1)).tolist()
        if rng.random() >= holes
    }
    return Problem(*bounds(len(positions), ranges)), positions


@pytest.mark.parametrize('max_boxes', [1, 2, 5])
def test_patches_that_were_not_examined_take_no_boxes_of_other_pieces(max_boxes):
    grid = braced_grid(5, 5, 0.05)[0]
    lower, upper = bounds(27, {(25, 26): (1.0, 1.0)})
    lower[:25, :25], upper[:25, :25] = grid.lower, grid.upper
    done = solve(Problem(lower, upper), SolverOptions(max_boxes=max_boxes)).statistics
    assert done.processed == done.empty + done.split + done.kept
    assert done.empty >= 0 and done.kept >= 1


@pytest.mark.parametrize('seeds', CHUNKS, ids=first_and_last)
def test_no_truth_is_lost_in_patches(seeds, small_patches):
    for seed in seeds:
        case = random_case(seed)
        within = None
        if seed % 5 == 0:
            within = [(0.9 * case.squared, 1.1 * case.squared), (case.squared, 2.0 * case.squared)]
        for answer in (solve, solve_as_one):
            result = answer(case.problem, case.options, within=within)
            assert result.verdict is not Verdict.INFEASIBLE, seed
            done = result.statistics
            assert done.processed == done.empty + done.split + done.kept, seed
            assert (result.verdict is Verdict.OUT_OF_BUDGET) == (done.pending > 0), seed
            for piece in result.pieces:
                for part in (piece, *piece.patches):
                    squared = case.squared[np.ix_(part.points, part.points)]
                    held = ((h.lower <= squared) & (squared <= h.upper) for h in part.hypotheses)
                    assert any(inside.all() for inside in held), seed
            if answer is solve:
                assert not missing(result, case.positions, case.squared), seed


@pytest.mark.parametrize('seeds', CHUNKS[:4], ids=first_and_last)
def test_what_is_proved_without_patches_is_in_the_answer_with_them(seeds, small_patches):
    for seed in seeds:
        case = random_case(seed, max_points=7)
        rng = np.random.default_rng(seed)
        lower, upper = case.problem.lower.copy(), case.problem.upper.copy()
        i, j = rng.integers(len(lower), size=2)
        factor = rng.choice([0.5, 0.9, 1.0, 1.1, 2.0])
        lower[i, j] = lower[j, i] = factor * lower[i, j]
        upper[i, j] = upper[j, i] = factor * upper[i, j]
        problem = Problem(
            lower, upper, case.problem.dimension, case.problem.sides, case.problem.chiralities
        )
        options = SolverOptions(resolution=case.options.resolution, max_boxes=100)
        patched = solve_as_one(problem, options)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pieces, 'MOST_WHOLE', 1000)
            plain = solve_as_one(problem, options)
        for claims, other in ((patched, plain), (plain, patched)):
            for hypothesis in claims.hypotheses:
                if hypothesis.proved:
                    squared = squared_distances(hypothesis.positions)
                    slack = ROUNDING * squared.max()
                    assert any(
                        ((h.lower - slack <= squared) & (squared <= h.upper + slack)).all()
                        for h in other.hypotheses
                    ), seed


@pytest.mark.parametrize('size', [(5, 5), (5, 9), (9, 9)])
@pytest.mark.parametrize('error', [1e-9, 0.002])
def test_a_large_grid_is_one_hypothesis_that_holds_the_truth(size, error):
    problem, positions = braced_grid(*size, error)
    result = solve(problem, SolverOptions(max_boxes=10**6))
    assert result.verdict is Verdict.COVERED
    (piece,) = result.pieces
    (hypothesis,) = piece.hypotheses
    assert hypothesis.proved and not hypothesis.flexible
    squared = squared_distances(positions)
    assert (hypothesis.lower <= squared * (1 + 1e-12)).all()
    assert (squared * (1 - 1e-12) <= hypothesis.upper).all()
    assert np.isfinite(hypothesis.upper).all()


@pytest.mark.parametrize('error', [0.01, 0.03])
def test_a_placement_is_proved_where_many_choices_of_patches_are_left(error):
    """The first choice that agrees patch by patch is not one of the whole piece."""
    positions = np.random.default_rng(1).random((100, 2)) * 50.0
    squared = squared_distances(positions)
    rows, columns = np.triu_indices(100, 1)
    nearest = np.argsort(squared[rows, columns])[:400]
    known = squared[rows[nearest], columns[nearest]]
    lower, upper = known * (1.0 - error) ** 2, known * (1.0 + error) ** 2
    problem = Problem.from_pairs(100, rows[nearest], columns[nearest], lower, upper)
    result = solve(problem, SolverOptions(max_boxes=10**6, max_seconds=60.0))
    piece = max(result.pieces, key=lambda piece: len(piece.points))
    assert len(piece.points) > 60
    assert any(len(patch.hypotheses) > 1 for patch in piece.patches)
    assert any(hypothesis.proved for hypothesis in piece.hypotheses)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('error', [0.01, 0.03])
def test_a_grid_with_holes_keeps_the_truth(seed, error):
    problem, positions = braced_grid(8, 8, error, seed, holes=0.3)
    result = solve(problem, SolverOptions(max_boxes=300))
    assert not missing(result, positions, squared_distances(positions))
    for piece in result.pieces:
        for patch in piece.patches:
            squared = squared_distances(positions[list(patch.points)])
            held = ((h.lower <= squared) & (squared <= h.upper) for h in patch.hypotheses)
            assert any(inside.all() for inside in held)


def test_bounds_of_far_points_grow_with_the_chain():
    problem, positions = braced_grid(3, 20, 1e-3)
    (hypothesis,) = solve(problem).pieces[0].hypotheses
    true_m = np.sqrt(squared_distances(positions)[0])
    lower_m, upper_m = np.sqrt(hypothesis.lower[0]), np.sqrt(hypothesis.upper[0])
    assert upper_m[1] - lower_m[1] < 0.1 < upper_m[19] - lower_m[19]
    assert (upper_m[1:] < 1.3 * true_m[1:]).all()


def test_a_contradiction_between_patches_is_a_proof():
    problem, _ = braced_grid(8, 8, 0.001)
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[0, 1] = lower[1, 0] = 1.2 * lower[0, 1]
    upper[0, 1] = upper[1, 0] = 1.2 * upper[0, 1]
    result = solve(Problem(lower, upper))
    assert result.verdict is Verdict.INFEASIBLE
    assert {0, 1} <= set(result.pieces[0].points)


def test_patches_cover_every_measured_pair():
    problem, _ = braced_grid(10, 10, 1e-3)
    result = solve(problem, SolverOptions(max_boxes=10**6))
    covered = np.eye(100, dtype=bool)
    for piece in result.pieces:
        for part in piece.patches or (piece,):
            covered[np.ix_(part.points, part.points)] = True
    assert covered[np.isfinite(problem.upper)].all()


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


class CancelAfter:
    """Is set when it was asked so many times."""

    def __init__(self, most):
        self.left = most

    def is_set(self):
        self.left -= 1
        return self.left < 0


@pytest.mark.parametrize('most', [0, 1, 3, 10, 30, 100, 300])
@pytest.mark.parametrize('size', [(5, 6), (7, 9)])
def test_a_search_that_is_cancelled_still_holds_the_truth(most, size):
    problem, positions = braced_grid(*size, 0.03, holes=0.2)
    result = solve(problem, SolverOptions(max_boxes=300), cancel=CancelAfter(most))
    assert not missing(result, positions, squared_distances(positions))


@pytest.mark.parametrize(('degree', 'seed', 'n_hypotheses'), [(5, 110, 16), (6, 165, 48)])
def test_bodies_of_wide_distances_are_not_split_in_the_middle(degree, seed, n_hypotheses):
    """Both took 650 to 700 boxes, and had as many hypotheses."""
    positions, _ = neighbors(30, degree, 2, seed)
    result = solve(uwb_fleet(30, degree, seed), SolverOptions(max_boxes=10**4))
    assert result.verdict is Verdict.COVERED and result.statistics.processed < 300
    assert max(len(piece.hypotheses) for piece in result.pieces) == n_hypotheses
    assert not missing(result, positions, squared_distances(positions))


def test_a_placement_is_the_same_whenever_it_is_sought():
    for seed in range(100):
        case = random_case(seed)
        cover, _ = search(case.problem, case.options)
        boxes = cover.kept + cover.pending
        later = pickle.loads(
            pickle.dumps(unplaced_hypotheses.unplaced_hypotheses_of(case.problem, boxes))
        )
        now = hypotheses.hypotheses_of(case.problem, boxes)
        assert len(now) == len(later) > 0, seed
        for placed, unplaced in zip(now, later, strict=True):
            for name in ('lower', 'upper', 'boxes', 'positions', 'proved', 'flexible'):
                assert np.array_equal(getattr(placed, name), getattr(unplaced, name)), (seed, name)


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
                    squared_now = squared_distances(found.positions)
                    slack = 1e-9 * squared_now.max()
                    assert (found.lower <= squared_now + slack).all()
                    assert (squared_now - slack <= found.upper).all()
    assert n_proved


def test_pieces_of_a_call_that_could_be_stopped_can_be_sent_to_other_processes():
    pieces_found = solve(uwb_fleet(70, 9, 5), cancel=threading.Event()).pieces
    for sent, kept in zip(pickle.loads(pickle.dumps(pieces_found)), pieces_found, strict=True):
        for one, other in zip(sent.hypotheses, kept.hypotheses, strict=True):
            assert np.array_equal(one.lower, other.lower)
            assert np.array_equal(one.positions, other.positions)
            assert one.proved == other.proved
