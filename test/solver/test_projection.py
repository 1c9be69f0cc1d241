# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The ranges of projection (Section 4.1) against exact rationals and against brute force."""

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


def is_in_range(numerator, c, low, high):
    """Tell exactly whether low <= numerator / (2 sqrt(c)) <= high."""

    def not_above(x, y_numerator):  # x <= y, by the squares of like signs
        x = Fraction(x)
        if (x < 0) != (y_numerator < 0):
            return x < 0
        smaller = 4 * c * x * x <= y_numerator**2
        larger = 4 * c * x * x >= y_numerator**2
        return larger if x < 0 else smaller

    return (math.isinf(low) or not_above(low, numerator)) and (
        math.isinf(high) or not_above(-high, -numerator)
    )


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


def exact_projection(squared):
    """Return squared distances across the axis from 0 to 1, as rationals, of integer ones."""
    a, b, c = squared[0].tolist(), squared[1].tolist(), int(squared[0, 1])
    numerators = [x - y + c for x, y in zip(a, b, strict=True)]
    n_points = len(a)
    projected = np.full((n_points, n_points), Fraction(0))
    for i in range(2, n_points):
        projected[0, i] = projected[i, 0] = a[i] - Fraction(numerators[i] ** 2, 4 * c)
        for j in range(2, n_points):
            along = Fraction((numerators[i] - numerators[j]) ** 2, 4 * c)
            projected[i, j] = int(squared[i, j]) - along
    return projected


@pytest.mark.parametrize('relative_width', [0.0, 1e-9, 0.05])
@pytest.mark.parametrize('dimension', [2, 3])
def test_project_holds_the_projected_fleet(dimension, relative_width):
    rng = np.random.default_rng(dimension)
    for _ in range(100):
        positions = rng.integers(-30, 31, size=(6, dimension))
        squared = squared_distances(positions)
        if squared[0, 1] == 0:
            continue
        box = box_of(squared * (1.0 - relative_width), squared * (1.0 + relative_width))
        found = project_box(box, 0, 1)
        assert found is not None
        projected, coordinates, points, _ = found
        assert points == [2, 3, 4, 5, 0]
        exact, c = exact_projection(squared), int(squared[0, 1])
        for i in (2, 3, 4, 5):
            numerator = int(squared[0, i]) - int(squared[1, i]) + c
            assert is_in_range(numerator, c, *coordinates[:, i].tolist())
            for j in points:
                assert i == j or projected[0, i, j] <= exact[i, j] <= projected[1, i, j]
        if relative_width == 0.0:
            assert np.max(projected[1] - projected[0]) <= 1e-11 * squared.max() ** 2 / c


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
