# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Projection along an axis, on the line, and back (Sections 4.1 to 4.3).

Ends are compared with exact rationals, and gaps are followed. That nothing is lost hunts show.
"""

from fractions import Fraction
import itertools
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import box_of, squared_distances

from dg_localization.interval.scalars import sub
from dg_localization.solver.contract.axis_bounds import coordinate_difference_up
from dg_localization.solver.contract.back_projection import (
    back_project as rows_back_to,
    far_squared_distance,
)
from dg_localization.solver.contract.line import _narrow_to_distances, _set_roots
from dg_localization.solver.contract.projection import (
    T_LOWER,
    T_UPPER,
    make_rows,
    project,
    whole_lanes,
)

AXIS = 0, 1
# Room for the rounding of a bound: a few units of the largest term it is made of.
UNITS = 1e-14


@given(st.integers(0, 2**32))
def test_coordinate_difference_is_the_exact_range(seed):
    """The corner enumeration is the exact range: every squared distance occurs once."""
    rng = np.random.default_rng(seed)
    ends = np.sort(rng.integers(0, 1000, size=(4, 2)) * rng.choice([1e-6, 1.0, 1e6]))
    d_low, d_high = np.sort(rng.integers(1, 100, size=2)) * float(rng.choice([1e-3, 1.0, 1e3]))
    # The bounds of t_2 - t_3 along the axis from 0 to 1, by the ends of A_2, B_2, A_3 and B_3.
    (i_low, i_high), (j_low, j_high) = sub(*ends[0], *ends[1]), sub(*ends[2], *ends[3])
    low = -coordinate_difference_up(j_high, i_low, d_low, d_high)
    high = coordinate_difference_up(i_high, j_low, d_low, d_high)
    lengths = [Fraction(float(d)) for d in (d_low, d_high)]
    sides = itertools.product(*(map(Fraction, pair) for pair in ends.tolist()))
    corners = [(ai - bi - aj + bj) / (2 * d) for ai, bi, aj, bj in sides for d in lengths]
    assert low <= min(corners) and max(corners) <= high
    slack = UNITS * ends.max() / d_low
    assert low >= min(corners) - slack and high <= max(corners) + slack


def project_box(box):
    """Return the projected box, the coordinates along `AXIS`, and the rows of the points."""
    n_points = box.shape[1]
    rows = make_rows(n_points)
    count = project(box, rows, np.arange(n_points), *AXIS)
    points = rows.points[:count]
    projected = np.zeros_like(box)
    projected[np.ix_(range(4), points, points)] = rows.across[:, :count, :count]
    projected[:, points, points] = 0.0
    coordinates = np.zeros((2, n_points))
    coordinates[:, points[:-1]] = rows.ends[[T_LOWER, T_UPPER], : count - 1]
    return projected, coordinates, rows._replace(points=points)


@pytest.mark.parametrize('dimension', [2, 3])
def test_exact_distances_are_projected_to_nearly_exact_ones(dimension):
    """That the true ones are not lost is shown by the hunts."""
    rng = np.random.default_rng(dimension)
    for _ in range(100):
        squared = squared_distances(rng.integers(-30, 31, size=(6, dimension)))
        if squared[0, 1] == 0:
            continue
        projected, _, rows = project_box(box_of(1.0 * squared, 1.0 * squared))
        assert rows.points.tolist() == [2, 3, 4, 5, 0]
        assert np.max(projected[1] - projected[0]) <= 1e-11 * squared.max() ** 2 / squared[0, 1]


def test_project_carries_gaps_and_leaves_out_what_is_infinitely_far():
    squared = squared_distances(np.array([[0.0, 0.0], [10.0, 0.0], [3.0, 1.0], [3.0, 9.0]]))
    box = box_of(squared, squared)
    box[:, 2, 3] = box[:, 3, 2] = [0.0, 100.0, 20.0, 60.0]
    projected, *_ = project_box(box)
    assert projected[2, 2, 3] == pytest.approx(20.0) and projected[2, 2, 3] >= 20.0
    assert projected[3, 2, 3] == pytest.approx(60.0) and projected[3, 2, 3] <= 60.0
    box[1, 1, 3] = box[1, 3, 1] = math.inf
    assert project_box(box)[2].points.tolist() == [2, 0]


def test_gaps_are_rounded_inward_on_the_way_to_the_line_and_on_the_way_back():
    """An end of a gap belongs to the box: its root, and its square, may not lie in the gap."""
    rng = np.random.default_rng(3)
    shape = (4, 2, whole_lanes(2))
    for ends in np.sort(rng.uniform(0.1, 9.9, (200, 2))):
        box, distance = np.zeros(shape), np.zeros(shape)
        box[:, [0, 1], [1, 0]] = np.array([0.0, 10.0, *ends])[:, None]
        _set_roots(box, distance, 2)
        low_m, high_m = map(Fraction, distance[2:, 0, 1].tolist())
        assert low_m**2 >= Fraction(float(ends[0])) and high_m**2 <= Fraction(float(ends[1]))
        box[2:] = 0.0
        assert _narrow_to_distances(box, distance, 2)
        low_m2, high_m2 = map(Fraction, box[2:, 0, 1].tolist())
        assert low_m2 >= low_m**2 and high_m2 <= high_m**2


def back_project(box, projected, coordinates, rows):
    """Narrow a box and the coordinates by the projected box."""
    points, count = rows.points, len(rows.points)
    rows.across[:, :count, :count] = projected[np.ix_(range(4), points, points)]
    rows.ends[[T_LOWER, T_UPPER], : count - 1] = coordinates[:, points[:-1]]
    left = rows_back_to(box, rows, count, *AXIS)
    coordinates[:, points[:-1]] = rows.ends[[T_LOWER, T_UPPER], : count - 1]
    return left


@given(st.integers(0, 2**32))
def test_the_far_side_is_bounded_by_its_exact_range(seed):
    """B = A + d^2 - 2 d t (Eq. 22) is linear in A and t; in d its minimum is at d = t."""
    rng = np.random.default_rng(seed)
    scale = float(rng.choice([1.0, 1e-12, 1e12]))
    widths = rng.choice([0.0, 1e-9, 1.0], 3)
    starts = rng.random(3) * [100.0, 20.0, 10.0] - [0.0, 10.0, 0.0]
    starts *= [scale**2, scale, scale]
    widths *= rng.random(3) * [10.0 * scale**2, 5.0 * scale, 5.0 * scale]
    (a_ends, t_ends, d_ends) = np.column_stack([starts, starts + widths]).tolist()
    lengths = [*d_ends, min(max(t_ends[1], d_ends[0]), d_ends[1])]
    ends = (map(Fraction, numbers) for numbers in (a_ends, t_ends, lengths))
    exact = [a + d * d - 2 * d * t for a, t, d in itertools.product(*ends)]
    low, high = far_squared_distance(*a_ends, *t_ends, *d_ends)
    slack = Fraction(1e-14 * 1000.0 * scale**2)
    assert low <= min(exact) <= low + slack
    assert high - slack <= max(exact) <= high


def test_a_gap_of_the_height_becomes_a_gap_of_the_sides():
    positions = np.array([[0, 0], [10, 0], [5, 3]])
    squared = squared_distances(positions)
    box = box_of(1.0 * squared, 1.0 * squared)
    for end in AXIS:
        box[:2, end, 2] = box[:2, 2, end] = [25.0, 75.0]
    projected, coordinates, *rest = project_box(box)
    coordinates[:, 2] = 5.0
    projected[:, 0, 2] = projected[:, 2, 0] = [0.0, 50.0, 10.0, 40.0]
    assert back_project(box, projected, coordinates, *rest)
    for end in AXIS:
        gap_low, gap_high = box[2:, end, 2]
        assert 35.0 <= gap_low < 35.0 + 1e-9
        assert 65.0 - 1e-9 < gap_high <= 65.0


def test_a_gap_of_a_pair_is_rounded_inward():
    """The difference along the axis is short and well known, so that the sum rounds for itself."""
    along_m = 2.0**-10 + 2.0**-27
    along_m2 = Fraction(along_m) ** 2
    known_to_m2 = Fraction(1, 2**60)
    squared = squared_distances(np.array([[0, 0], [8, 0], [3, 1], [3 + along_m, 2]]))
    rng = np.random.default_rng(4)
    for ends in np.sort(rng.uniform(1.0, 2.0, (50, 2))):
        box = box_of(1.0 * squared, 1.0 * squared)
        box[:2, 2, 3] = box[:2, 3, 2] = [0.0, 5.0]
        projected, *rest = project_box(box)
        projected[:, [2, 3], [3, 2]] = np.array([0.0, 4.0, *ends])[:, None]
        assert back_project(box, projected, *rest)
        gap_low, gap_high = map(Fraction, box[2:, 2, 3].tolist())
        assert gap_low >= Fraction(float(ends[0])) + along_m2 - known_to_m2
        assert gap_high <= Fraction(float(ends[1])) + along_m2 + known_to_m2


def test_a_height_that_no_triangle_has_is_a_proof():
    positions = np.array([[0, 0], [10, 0], [5, 3]])
    squared = squared_distances(positions)
    box = box_of(1.0 * squared, 1.0 * squared)
    projected, *rest = project_box(box)
    projected[:2, 0, 2] = projected[:2, 2, 0] = 16.0
    assert not back_project(box, projected, *rest)
