# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Faces that pieces share: how wide they are, and which points are off their hyperplane."""

import numpy as np
from solver_cases import squared_distances

from dg_localization.solver.assemble.faces import apex_of
from dg_localization.solver.result import Hypothesis

POINTS = (2, 5, 7, 9)


def hypothesis_of(positions, error=0.0):
    positions = np.array(positions, dtype=float)
    squared = squared_distances(positions)
    lower, upper = squared * (1.0 - error), squared * (1.0 + error)
    return Hypothesis(lower, upper, np.array([[lower, upper]]), positions, True, False)


def test_the_apex_is_off_the_face_in_every_placement():
    corners = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.1], [2.0, 3.0]]
    assert apex_of(POINTS, hypothesis_of(corners, 1e-3), (2, 5)) == 9
    flat = [[0.0, 0.0], [4.0, 0.0], [2.0, 0.1], [1.0, 0.1]]
    assert apex_of(POINTS, hypothesis_of(flat, 0.05), (2, 5)) is None
