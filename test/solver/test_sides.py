# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which placements sides and chiralities leave; that none is lost is shown by the hunts."""

import numpy as np
import pytest
from solver_cases import bounds, squared_distances

from dg_localization import Chirality, Problem, Side, SideConstraint, Verdict, solve

# A unit square 0 1 2 3, counter-clockwise, with one diagonal known: two triangles on 0-2.
SQUARE = {(0, 1): (1, 1), (1, 2): (1, 1), (2, 3): (1, 1), (0, 3): (1, 1), (0, 2): (2, 2)}


@pytest.mark.parametrize(
    ('constraints', 'squared_m2'),
    [
        ({'sides': [SideConstraint((0, 2), 1, 3, Side.OPPOSITE)]}, 2.0),
        ({'sides': [SideConstraint((2, 0), 3, 1, Side.OPPOSITE)]}, 2.0),
        ({'sides': [SideConstraint((0, 2), 1, 3, Side.SAME)]}, 0.0),
        ({'chiralities': [Chirality((0, 1, 2), 1), Chirality((0, 2, 3), 1)]}, 2.0),
        ({'chiralities': [Chirality((0, 1, 2), -1), Chirality((3, 0, 2), -1)]}, 2.0),
        ({'chiralities': [Chirality((0, 1, 2), 1), Chirality((0, 2, 3), -1)]}, 0.0),
        ({'chiralities': [Chirality((1, 0, 2), 1), Chirality((0, 2, 3), 1)]}, 0.0),
    ],
)
def test_which_side_is_which(constraints, squared_m2):
    result = solve(Problem(*bounds(4, SQUARE), **constraints))
    (hypothesis,) = result.hypotheses
    assert hypothesis.lower[1, 3] <= squared_m2 <= hypothesis.upper[1, 3]
    assert hypothesis.upper[1, 3] - hypothesis.lower[1, 3] < 1e-6


def test_two_chiralities_of_disjoint_triangles():
    """They share no face: only the product of their volumes tells them apart."""
    positions = np.array([[0, 0], [4, 0], [0, 3], [9, 9], [13, 9], [9, 12]])
    squared = squared_distances(positions)
    for sign, verdict in ((1, Verdict.COVERED), (-1, Verdict.INFEASIBLE)):
        chiralities = [Chirality((0, 1, 2), 1), Chirality((3, 4, 5), sign)]
        assert solve(Problem(squared, squared, chiralities=chiralities)).verdict is verdict
