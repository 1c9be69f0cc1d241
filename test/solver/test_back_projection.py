# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Back-projection (Section 4.3) against exact rationals and against brute force."""

from fractions import Fraction
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import box_of, squared_distances
from test_projection import exact_projection, project_box

from dg_localization.solver.contract.back_projection import (
    back_project as rows_back_to,
    far_squared_distance,
)
from dg_localization.solver.contract.projection import T_LOWER, T_UPPER

AXIS = 0, 1


def holds(bounds, exact):
    return bool(np.all((bounds[0] <= exact) & (exact <= bounds[1])))


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


def outward(x, relative_width=0.0):
    """Return floats around a rational."""
    low, high = float(x) * (1.0 - relative_width), float(x) * (1.0 + relative_width)
    return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)


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


@pytest.mark.parametrize('seed', range(200))
def test_nothing_is_lost_on_the_way_back(seed):
    """With a reduced projected box around the exact one, the exact distances stay in the box."""
    rng = np.random.default_rng(seed)
    dimension = int(rng.integers(2, 4))
    n_points = int(rng.integers(3, 7))
    positions = rng.integers(-20, 21, size=(n_points, dimension))
    positions[1] = positions[0] + rng.integers(1, 10, dimension)
    if rng.random() < 0.3:
        positions[2:, -1] = positions[0, -1]
    if rng.random() < 0.2:
        positions[-1] = positions[int(rng.integers(0, n_points - 1))]
    squared = squared_distances(positions)
    width = float(rng.choice([0.0, 1e-9, 0.05, 0.5]))
    box = box_of(squared * (1.0 - width), squared * (1.0 + width))
    pair = rng.integers(2, n_points, 2)
    if pair[0] != pair[1]:
        box[1][tuple(pair)] = box[1][tuple(pair[::-1])] = math.inf
    before = box.copy()
    projected, *rest = project_along_axis(box)
    coordinates = rest[0]
    width_of_projected = float(rng.choice([0.0, 1e-6, 0.1]))
    exact = exact_projection(squared)
    for i in (0, *range(2, n_points)):
        for j in (0, *range(2, n_points)):
            if i != j:
                low, high = outward(exact[i, j], width_of_projected)
                projected[0, i, j] = max(projected[0, i, j], low)
                projected[1, i, j] = min(projected[1, i, j], high)
    assert back_project(box, projected, *rest)
    assert holds(box, squared)
    assert (box[0] >= before[0]).all() and (box[1] <= before[1]).all()
    root = math.sqrt(squared[AXIS])
    along = (squared[0] - squared[1] + squared[AXIS]) / (2.0 * root)
    assert (coordinates[0, 2:] <= along[2:] + 1e-12).all()
    assert (coordinates[1, 2:] >= along[2:] - 1e-12).all()


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
