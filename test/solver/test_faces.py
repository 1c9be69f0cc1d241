# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Faces that pieces share: how wide they are, and which points are off their hyperplane."""

import math

import numpy as np
import pytest
from solver_cases import squared_distances

from dg_localization.solver.assemble.faces import apex_of, is_degenerate
from dg_localization.solver.result import Hypothesis

POINTS = (2, 5, 7, 9)


def hypothesis_of(positions, error=0.0):
    positions = np.array(positions, dtype=float)
    squared = squared_distances(positions)
    lower, upper = squared * (1.0 - error), squared * (1.0 + error)
    return Hypothesis(lower, upper, np.array([[lower, upper]]), positions, True, False)


@pytest.mark.parametrize('height', [0.0, 1e-9, 0.049, 0.051, 3.0])
def test_a_triangle_is_as_wide_as_its_least_height(height):
    # The longest side is 4 m, so the least height is the one on it.
    corners = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [1.0, height, 0.0], [0.0, 0.0, 1.0]]
    assert is_degenerate(POINTS, hypothesis_of(corners), (2, 5, 7), 0.05) == (height < 0.05)


@pytest.mark.parametrize(('length', 'degenerate'), [(0.0, True), (0.04, True), (0.06, False)])
def test_a_segment_is_as_wide_as_it_is_long(length, degenerate):
    corners = [[0.0, 0.0], [length, 0.0], [1.0, 1.0], [2.0, 1.0]]
    assert is_degenerate(POINTS, hypothesis_of(corners), (2, 5), 0.05) == degenerate


@pytest.mark.parametrize('wrong', [math.nan, math.inf])
def test_a_face_that_is_not_placed_counts_as_wide(wrong):
    known = hypothesis_of(np.eye(4, 3))
    positions = known.positions.copy()
    positions[1, 0] = wrong
    unknown = Hypothesis(known.lower, known.upper, known.boxes, positions, False, False)
    assert not is_degenerate(POINTS, unknown, (2, 5, 7), 0.05)


def test_the_apex_is_off_the_face_in_every_placement():
    corners = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.1], [2.0, 3.0]]
    assert apex_of(POINTS, hypothesis_of(corners, 1e-3), (2, 5), None) == 9
    flat = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.1], [1.0, 0.1]]
    assert apex_of(POINTS, hypothesis_of(flat, 0.05), (2, 5), None) is None
