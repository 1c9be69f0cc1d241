# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The ranges of projection (Section 4.1): exact ends, sharpness, and what becomes of gaps."""

from fractions import Fraction
import itertools
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import box_of, squared_distances

from dg_localization.interval.scalars import sub
from dg_localization.solver.contract.axis_bounds import coordinate_difference_up
from dg_localization.solver.contract.projection import T_LOWER, T_UPPER, make_rows, project

# Room for the rounding of a bound: a few units of the largest term it is made of.
UNITS = 1e-14


def difference_of_coordinates(ends, d_low, d_high):
    """Bound t_2 - t_3 along the axis from 0 to 1, with the ends of A_2, B_2, A_3 and B_3."""
    a_i, b_i, a_j, b_j = ends
    i_low, i_high = sub(*a_i, *b_i)
    j_low, j_high = sub(*a_j, *b_j)
    low = -coordinate_difference_up(j_high, i_low, d_low, d_high)
    return low, coordinate_difference_up(i_high, j_low, d_low, d_high)


@given(st.integers(0, 2**32))
def test_coordinate_difference_is_the_exact_range(seed):
    """The corner enumeration is the exact range: every squared distance occurs once."""
    rng = np.random.default_rng(seed)
    ends = np.sort(rng.integers(0, 1000, size=(4, 2)) * rng.choice([1e-6, 1.0, 1e6]))
    d_low, d_high = np.sort(rng.integers(1, 100, size=2)) * float(rng.choice([1e-3, 1.0, 1e3]))
    low, high = difference_of_coordinates(ends, d_low, d_high)
    corners = [
        (ai - bi - aj + bj) / (2 * d)
        for ai, bi, aj, bj in itertools.product(*(map(Fraction, pair) for pair in ends.tolist()))
        for d in (Fraction(float(d_low)), Fraction(float(d_high)))
    ]
    assert low <= min(corners) and max(corners) <= high
    slack = UNITS * ends.max() / d_low
    assert low >= min(corners) - slack and high <= max(corners) + slack


def project_box(box, a, b):
    """Return (projected box, coordinates, projected points, rows); None for an empty box."""
    n_points = box.shape[1]
    rows = make_rows(n_points)
    count = project(box, rows, np.arange(n_points), a, b)
    if count < 0:
        return None
    points = rows.points[:count]
    projected = np.zeros_like(box)
    projected[np.ix_(range(4), points, points)] = rows.across[:, :count, :count]
    projected[:, points, points] = 0.0
    coordinates = np.zeros((2, n_points))
    coordinates[:, points[:-1]] = rows.ends[[T_LOWER, T_UPPER], : count - 1]
    return projected, coordinates, points.tolist(), rows._replace(points=points)


@pytest.mark.parametrize('dimension', [2, 3])
def test_exact_distances_are_projected_to_nearly_exact_ones(dimension):
    """That the true ones are not lost is shown by the hunts."""
    rng = np.random.default_rng(dimension)
    for _ in range(100):
        squared = squared_distances(rng.integers(-30, 31, size=(6, dimension)))
        if squared[0, 1] == 0:
            continue
        projected, _, points, _ = project_box(box_of(1.0 * squared, 1.0 * squared), 0, 1)
        assert points == [2, 3, 4, 5, 0]
        assert np.max(projected[1] - projected[0]) <= 1e-11 * squared.max() ** 2 / squared[0, 1]


def test_project_carries_gaps_and_leaves_out_what_is_infinitely_far():
    squared = squared_distances(np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 1.0], [3.0, 9.0]]))
    box = box_of(squared, squared)
    box[:, 2, 3] = box[:, 3, 2] = [0.0, 100.0, 20.0, 60.0]
    found = project_box(box, 0, 1)
    assert found is not None
    projected = found[0]
    assert projected[2, 2, 3] == pytest.approx(20.0) and projected[2, 2, 3] >= 20.0
    assert projected[3, 2, 3] == pytest.approx(60.0) and projected[3, 2, 3] <= 60.0
    box[1, 1, 3] = box[1, 3, 1] = math.inf
    found = project_box(box, 0, 1)
    assert found is not None
    assert found[2] == [2, 0]
