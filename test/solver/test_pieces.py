# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pieces: what is rigid, joined or moves, how many fleets that makes, and what rules them out."""

from itertools import combinations

from flex import linkage
from joined_cases import missing
import numpy as np
import pytest
from solver_cases import covers, holding, pairs_where, problem_of, squared_distances

from benchmarks.pieces import neighbors
from dg_localization import Chirality, JointKind, Problem, SolverOptions, Verdict, solve
from dg_localization.solver.decompose.decomposition import pieces_of
from dg_localization.solver.decompose.graph import pairs_of
from dg_localization.solver.decompose.rigid_components import is_rigid, rigid_rank

TWO_FOURS_M = np.array([[0, 0], [5, 1], [1, 4], [6, 6], [10, 2], [9, 9], [4, 11]], dtype=float)


def known(positions, bodies, relative_error=0.02, apart=(), **constraints):
    """Return the problem that knows all distances within bodies, and that some are not shorter."""
    measured = {pair for body in bodies for pair in combinations(body, 2)}
    far = {pair: (least, np.inf) for pair, least in dict(apart).items()}
    return problem_of(positions, measured, far, relative_error, **constraints)


def strip_m(length):
    """Return the corners of a strip of fours, two by two."""
    grid = np.array([[4.0 * (k // 2), 3.0 * (k % 2)] for k in range(2 * length + 2)])
    return grid + np.random.default_rng(1).uniform(-0.5, 0.5, grid.shape)


def strip(length, **constraints):
    fours = [range(2 * k, 2 * k + 4) for k in range(length)]
    return known(strip_m(length), fours, **constraints)


def test_a_least_distance_that_no_fold_reaches_is_a_contradiction():
    result = solve(strip(2, apart={(0, 4): 400.0}))
    assert result.verdict is Verdict.INFEASIBLE
    assert (result.n_hypotheses, result.hypotheses, result.joints) == (0, (), ())


def test_a_contradiction_names_the_piece_that_it_is_in():
    problem = known(TWO_FOURS_M, [(0, 1, 2, 3), (3, 4, 5, 6)])
    lower, upper = problem.lower.copy(), problem.upper.copy()
    lower[4, 6] = lower[6, 4] = upper[4, 6] = upper[6, 4] = 400.0
    result = solve(Problem(lower, upper))
    assert result.verdict is Verdict.INFEASIBLE
    (piece,) = result.pieces
    assert (piece.points, piece.hypotheses) == ((3, 4, 5, 6), ())
    assert (result.lower > result.upper).all()


@pytest.mark.parametrize('max_boxes', [1, 2, 3, 5])
def test_a_hard_piece_leaves_the_others_their_answers(max_boxes):
    """Dixon's linkage, which moves although K33 is rigid generically, and an easy four."""
    hard = np.array([[1, 0], [2, 0], [-3, 0], [0, 1], [0, 2], [0, -3]], dtype=float)
    positions = np.concatenate([hard, TWO_FOURS_M[:4] + 20.0])
    bars = [(i, j) for i in (0, 1, 2) for j in (3, 4, 5)]
    problem = known(positions, [*bars, (6, 7, 8, 9)], 1e-12)
    result = solve(problem, SolverOptions(resolution=1e-3, max_boxes=max_boxes))
    assert result.verdict is Verdict.OUT_OF_BUDGET
    assert result.statistics.processed <= max_boxes
    assert result.statistics.pending > 0
    assert not missing(result, positions)
    easy = next(piece for piece in result.pieces if piece.points == (6, 7, 8, 9))
    if max_boxes > 1:
        (hypothesis,) = easy.hypotheses
        assert hypothesis.proved
        (alone,) = solve(known(TWO_FOURS_M[:4] + 20.0, [(0, 1, 2, 3)], 1e-12)).hypotheses
        assert np.array_equal(hypothesis.upper, alone.upper)


def test_progress_adds_up_over_pieces():
    seen = []
    result = solve(strip(5), progress=seen.append)
    assert [statistics.processed for statistics in seen] == [1, 2, 3, 4, 5]
    assert seen[-1].kept == result.statistics.kept == 5


def test_a_box_that_connects_a_point_places_it():
    """Only the box that is asked for bounds the distance between a triangle and a lone point."""
    problem = known(TWO_FOURS_M[:4], [(0, 1, 2)], chiralities=[Chirality((0, 1, 2), 1)])
    near = problem.upper.copy()
    near[[0, 3], [3, 0]] = 25.0
    (hypothesis,) = solve(problem, within=[(problem.lower, near)]).hypotheses
    assert np.isfinite(hypothesis.upper).all() and hypothesis.proved
    assert squared_distances(hypothesis.positions)[0, 3] <= 25.0 + 1e-9


def test_within_keeps_to_what_was_proved_before():
    problem = strip(3, relative_error=0.001)
    result = solve(problem)
    for hypothesis in result.hypotheses:
        box = hypothesis.lower, hypothesis.upper
        again = solve(problem, within=[box])
        assert again.verdict is Verdict.COVERED
        assert len(again.hypotheses) == 1
        assert again.hypotheses[0].proved
        assert (again.lower >= hypothesis.lower).all()
        assert (again.upper <= hypothesis.upper).all()
    both = solve(problem, within=[(h.lower, h.upper) for h in result.hypotheses[:2]])
    assert len(both.hypotheses) == 2
    assert solve(problem, within=[]).verdict is Verdict.INFEASIBLE


def test_what_is_within_several_boxes_is_a_hypothesis_in_each():
    """A hinge whose ends are near each other or far apart; laid out anyhow they are neither."""
    problem = Problem.from_pairs(3, [0, 1], [1, 2], [0.98, 0.98], [1.02, 1.02])
    lower, upper = problem.lower.copy(), problem.upper.copy()
    boxes, ends = [], ((0.01, 0.04), (3.24, 3.61))
    for low, high in ends:
        bounds = lower.copy(), upper.copy()
        for bound, value in zip(bounds, (low, high), strict=True):
            bound[0, 2] = bound[2, 0] = value
        boxes.append(bounds)
    result = solve(problem, within=boxes)
    assert result.n_hypotheses >= len(result.hypotheses) == 2
    for hypothesis, (low, high) in zip(result.hypotheses, ends, strict=True):
        assert len(hypothesis.boxes) == 1
        assert low <= hypothesis.lower[0, 2] <= hypothesis.upper[0, 2] <= high
        apart_m2 = squared_distances(hypothesis.positions)[0, 2]
        assert low <= apart_m2 <= high or not hypothesis.proved


def test_two_isolated_hypotheses_and_a_flex():
    result = solve(linkage(), SolverOptions(resolution=0.2))
    assert result.verdict is Verdict.COVERED
    assert sorted(hypothesis.flexible for hypothesis in result.hypotheses) == [False, False, True]
    assert sorted(len(hypothesis.boxes) for hypothesis in result.hypotheses)[:2] == [1, 1]
    assert all(hypothesis.proved for hypothesis in result.hypotheses)


def two_grids(width, dimension):
    """Return two lattices that parallel bars of one length join, and their placements by angle."""
    grid = np.array(list(np.ndindex(*[width] * dimension)), dtype=float)
    corners = grid[:, 0] == width - 1 if dimension == 2 else np.ones(len(grid), dtype=bool)
    held = np.flatnonzero(corners)[[0, corners.sum() // 2, -1]]
    if dimension == 3:
        held = np.flatnonzero(grid.sum(axis=1) < 3)

    def placed(angle_rad):
        shift = np.zeros(dimension)
        shift[:2] = np.cos(angle_rad), np.sin(angle_rad)
        return np.vstack([grid, grid + (width + 3.0) * shift])

    squared = squared_distances(placed(0.0))
    measured = squared < 2.5
    measured[: len(grid), len(grid) :] = measured[len(grid) :, : len(grid)] = False
    for x in held:
        measured[x, x + len(grid)] = measured[x + len(grid), x] = True
    return problem_of(placed(0.0), pairs_where(measured)), placed


@pytest.mark.parametrize(('width', 'dimension'), [(2, 2), (3, 2), (9, 2), (10, 2), (2, 3)])
@pytest.mark.parametrize('max_boxes', [1, 30, 400])
def test_what_moves_is_flexible_at_any_size(width, dimension, max_boxes):
    problem, placed = two_grids(width, dimension)
    result = solve(problem, SolverOptions(max_boxes=max_boxes, max_seconds=20.0))
    for angle_rad in np.linspace(0.0, 6.0, 7):
        squared = squared_distances(placed(angle_rad))
        found = holding(result.hypotheses, squared)
        assert found and all(h.flexible for h in found)


def test_points_at_one_place_are_as_rigid_as_one_point():
    triangle = [(0, 0), (4, 0), (1, 3)]
    for extra, bars in (
        ([(0, 0)], [(0, 3)]),
        ([(4, 0), (0, 0), (5, 5)], [(0, 4), (1, 3), (3, 5), (2, 5)]),
    ):
        positions = np.array(triangle + extra, dtype=float)
        result = solve(problem_of(positions, [(0, 1), (0, 2), (1, 2), *bars], error=1e-4))
        assert result.verdict is Verdict.COVERED
        assert covers(result, squared_distances(positions))
        assert all(h.proved and not h.flexible for h in result.hypotheses)
    # Two points that hinge about two others at one place.
    positions = np.array([(0, 0), (0, 0), (4, 0), (1, 3)], dtype=float)
    known = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3)]
    result = solve(problem_of(positions, known, error=0.0))
    assert result.verdict is Verdict.COVERED and result.statistics.processed < 10
    (hypothesis,) = result.hypotheses
    assert hypothesis.flexible and covers(result, squared_distances(positions))


@pytest.mark.parametrize('error', [1e-9, 1e-4])
def test_pieces_turn_about_shared_points_in_line(error):
    positions = np.array([(0, 0, 0), (1, 0, 0), (3, 0, 0), (1, 2, 0.5), (0, 1, 2)])
    known = [(0, 1), (0, 2), (1, 2), *((i, j) for i in (0, 1, 2) for j in (3, 4))]
    result = solve(problem_of(positions, known, error=error))
    assert result.verdict is Verdict.COVERED
    assert covers(result, squared_distances(positions))
    assert all(h.proved and h.flexible for h in result.hypotheses)


HINGE, REFLECTION, LOOSE = JointKind.HINGE, JointKind.REFLECTION, JointKind.LOOSE


def complete(*points, without=()):
    return {pair for pair in combinations(points, 2) if pair not in without}


def as_array(pairs):
    return np.array(sorted(tuple(sorted(pair)) for pair in pairs), dtype=np.int64).reshape(-1, 2)


def test_the_double_banana_turns_about_a_line():
    """As many pairs as eight rigid points need, and yet a flex: Maxwell's count fails in space."""
    first, second = (0, 1, 2, 3, 4), (0, 1, 5, 6, 7)
    pairs = complete(*first, without={(0, 1)}) | complete(*second, without={(0, 1)})
    assert len(pairs) == rigid_rank(8, 3)
    answer = check_pieces(8, as_array(pairs), 3)
    assert set(answer.pieces) == {first, second}
    (joint,) = answer.joints
    assert (joint.points, joint.kind) == ((0, 1), HINGE)


def check_pieces(n_points, pairs, dimension):
    """Assert what a decomposition promises."""
    answer = pieces_of(n_points, pairs, dimension)
    measured = {tuple(pair) for pair in pairs.tolist()}
    assert set().union(*answer.pieces) == set(range(n_points))
    assert measured <= set().union(*map(pairs_of, answer.pieces))
    known = set(measured)
    for number, part in enumerate(answer.pieces):
        own = [pair for pair in pairs_of(part) if pair in known]
        local = np.searchsorted(part, np.array(own).reshape(-1, 2))
        assert is_rigid(len(part), local, dimension)
        for joint in answer.joints:
            if number in joint.pieces:
                assert set(joint.points) <= set(part)
                known.update(pairs_of(joint.points))
    for joint in answer.joints:
        assert len(joint.pieces) > 1
        shared = {HINGE: [dimension - 1], REFLECTION: [dimension]}
        assert len(joint.points) in shared.get(joint.kind, range(1, dimension - 1))
    return answer


@pytest.mark.parametrize('dimension', [1, 2, 3])
def test_every_piece_is_rigid_by_what_comes_before_it(dimension):
    rng = np.random.default_rng(10 + dimension)
    for _ in range(100):
        n_points, degree = int(rng.integers(1, 15)), int(rng.integers(1, 9))
        _, pairs = neighbors(n_points, degree, dimension, int(rng.integers(2**32)))
        check_pieces(n_points, as_array(pairs.tolist()), dimension)


def test_a_part_hears_of_a_pair_from_a_piece_that_it_shares_no_joint_with():
    """Points 0 and 2 wait for the distance of 5 and 7, which 3, 6 and 8 imply."""
    pairs = complete(3, 5, 6, 7, 8, without={(5, 7)}) | {(1, 3), (1, 5), (1, 6)}
    pairs |= {(2, 5), (2, 6), (2, 7), (0, 2), (0, 5), (0, 7), (4, 5), (4, 7)}
    answer = check_pieces(9, as_array(pairs), 3)
    assert {(4, 5, 7), (0, 2, 5, 7)} <= set(answer.pieces)
    assert ((5, 7), HINGE) in {(joint.points, joint.kind) for joint in answer.joints}
