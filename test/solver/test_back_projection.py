# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Back-projection (Section 4.3) against exact rationals and against brute force."""

from fractions import Fraction

from hypothesis import given, strategies as st
import numpy as np
from solver_cases import box_of, squared_distances
from test_projection import project_box

from dg_localization.solver.contract.back_projection import (
    back_project as rows_back_to,
    far_squared_distance,
)
from dg_localization.solver.contract.projection import T_LOWER, T_UPPER

AXIS = 0, 1


def project_along_axis(box):
    """Return (projected box, coordinates, rows) of a box along `AXIS`, by point."""
    projected, coordinates, _, rows = project_box(box, *AXIS)
    return projected, coordinates, rows


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
    exact = [
        a + d * d - 2 * d * t
        for a in map(Fraction, a_ends)
        for t in map(Fraction, t_ends)
        for d in map(Fraction, lengths)
    ]
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
    projected, coordinates, *rest = project_along_axis(box)
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
        projected, *rest = project_along_axis(box)
        projected[:, [2, 3], [3, 2]] = np.array([0.0, 4.0, *ends])[:, None]
        assert back_project(box, projected, *rest)
        gap_low, gap_high = map(Fraction, box[2:, 2, 3].tolist())
        assert gap_low >= Fraction(float(ends[0])) + along_m2 - known_to_m2
        assert gap_high <= Fraction(float(ends[1])) + along_m2 + known_to_m2


def test_a_height_that_no_triangle_has_is_a_proof():
    positions = np.array([[0, 0], [10, 0], [5, 3]])
    squared = squared_distances(positions)
    box = box_of(1.0 * squared, 1.0 * squared)
    projected, *rest = project_along_axis(box)
    projected[:2, 0, 2] = projected[:2, 2, 0] = 16.0
    assert not back_project(box, projected, *rest)
