# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A curve of placements next to isolated ones (the paper's Figure 7)."""

from flex import linkage
import numpy as np
import pytest
from solver_cases import bounds, covers, holding, pairs_where, problem_of, squared_distances

from dg_localization import Problem, SolverOptions, Verdict, solve


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


def test_what_is_apart_and_at_one_place_contradicts():
    known = {(0, 1): (0.0, 0.0), (1, 2): (0.0, 0.0), (0, 2): (1.0, np.inf)}
    assert solve(Problem(*bounds(3, known))).verdict is Verdict.INFEASIBLE


@pytest.mark.parametrize('error', [1e-9, 1e-4])
def test_pieces_turn_about_shared_points_in_line(error):
    positions = np.array([(0, 0, 0), (1, 0, 0), (3, 0, 0), (1, 2, 0.5), (0, 1, 2)])
    known = [(0, 1), (0, 2), (1, 2), *((i, j) for i in (0, 1, 2) for j in (3, 4))]
    result = solve(problem_of(positions, known, error=error))
    assert result.verdict is Verdict.COVERED
    assert covers(result, squared_distances(positions))
    assert all(h.proved and h.flexible for h in result.hypotheses)
