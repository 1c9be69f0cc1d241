# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pieces that a point which hangs on them holds together, as far as the graph can tell."""

import numpy as np
from solver_cases import squared_distances

from dg_localization import Problem, Verdict, solve
from dg_localization.solver.problem import Chirality

ROUNDING = 1e-12


def strip_with_a_pendant(length=4, error=0.01):
    """Return a strip of rigid fours, and a point that is held at both of its ends only."""
    grid = np.array([[x // 2, x % 2] for x in range(2 * length + 2)]) * 5.0
    positions = grid + np.random.default_rng(0).uniform(-0.5, 0.5, grid.shape)
    positions = np.vstack([positions, [10.0, 12.0]])
    squared = squared_distances(positions)
    measured = np.zeros(squared.shape, dtype=bool)
    for first in range(0, 2 * length, 2):
        measured[first : first + 4, first : first + 4] = True
    for end in (0, 2 * length + 1):
        measured[-1, end] = measured[end, -1] = True
    np.fill_diagonal(measured, True)
    upper = np.where(measured, (1 + error) * squared, np.inf)
    return np.where(measured, (1 - error) * squared, 0.0), upper, positions


def holds(piece, positions):
    squared = squared_distances(positions[list(piece.points)])
    low, high = (1 - ROUNDING) * squared, (1 + ROUNDING) * squared
    return any(((h.lower <= high) & (low <= h.upper)).all() for h in piece.hypotheses)


def test_a_chirality_across_parts_rules_out_mirrored_ones():
    lower, upper, positions = strip_with_a_pendant()
    corners = positions[[0, 1, 9]]
    sign = int(np.sign(np.linalg.det(corners[1:] - corners[0])))
    chirality = Chirality((0, 1, 9), sign)
    result = solve(Problem(lower, upper, chiralities=[chirality]))
    assert result.verdict is Verdict.COVERED
    assert all(holds(piece, positions) for piece in result.pieces)
