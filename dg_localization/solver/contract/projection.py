# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Projection of a distance box along the axis of two of its points, in rows (Section 4.1)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import COMPILED, kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.interval.scalars import square
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    exclude,
)
from dg_localization.solver.contract.axis_bounds import (
    axis_coordinate,
    coordinate_difference_up,
    squared_height,
)

LANES = 8 if COMPILED else 1
"""The number of pairs of a row that are processed at a time."""

(
    A_LOWER,
    A_UPPER,
    B_LOWER,
    B_UPPER,
    DIFFERENCE_LOWER,
    DIFFERENCE_UPPER,
    T_LOWER,
    T_UPPER,
) = range(8)
"""The planes of `Rows.ends`."""


class Rows(NamedTuple):
    """
    Scratch arrays of one projection along an axis (a, b); w is n in whole lanes.

    The last row stands for the common image of a and b, the others for the projected points.
    """

    points: IntArray  # (n,): the point of each row in the projected box
    ends: FloatArray  # (8, w): bounds of A, B, A - B and t (Eq. 7)
    squared: FloatArray  # (2, n, w): s_ij before the projection, in m^2
    along: FloatArray  # (2, n, w): bounds of t_i - t_j, in m
    across: FloatArray  # (4, n, w): the projected box, in m^2


def whole_lanes(count: int) -> int:
    """Return the width of a row of a number of points, in whole lanes."""
    return (count + LANES - 1) // LANES * LANES


def make_rows(n_points: int) -> Rows:
    """Allocate the scratch arrays of a projection."""
    width = (n_points + LANES - 1) // LANES * LANES
    return Rows(
        np.zeros(n_points, dtype=np.int64),
        np.zeros((8, width)),
        np.zeros((2, n_points, width)),
        np.zeros((2, n_points, width)),
        np.zeros((4, n_points, width)),
    )


# Plain Python calls the original functions, which never wait for a compiler.
lanes_of = kernel(whole_lanes)
new_rows = kernel(make_rows)


LEAST_AXIS_RATIO = 0.3
"""Least ratio of the bounds of the squared distance of a pair that serves as an axis."""


@kernel(borrows=True)
def is_axis(box: FloatArray, a: int, b: int) -> bool:
    """
    Return whether a pair is known well enough to project along it.

    The bounds above widen quickly as the relative error of the axis grows; benchmarks/notes
    has the measurements behind the limit.
    """
    upper = box[UPPER, a, b]
    return not math.isinf(upper) and box[LOWER, a, b] > LEAST_AXIS_RATIO * upper


@kernel(borrows=True)
def project(box: FloatArray, rows: Rows, points: IntArray, a: int, b: int) -> int:
    """Project the points of a box along the axis from `a` to `b` (Section 4.1)."""
    count = 0
    for x in range(len(points)):
        i = points[x]
        # Other points are unbounded.
        if i != a and i != b and box[UPPER, a, i] < math.inf and box[UPPER, b, i] < math.inf:
            rows.points[count] = i
            count += 1
    if count == 0:
        rows.points[0] = a
        return 1
    d_lower, d_upper = sqrt_down(box[LOWER, a, b]), sqrt_up(box[UPPER, a, b])
    stop = lanes_of(count)
    for y in range(stop):
        # Spare lanes repeat a point.
        i = rows.points[min(y, count - 1)]
        rows.ends[A_LOWER, y], rows.ends[A_UPPER, y] = box[LOWER, a, i], box[UPPER, a, i]
        rows.ends[B_LOWER, y], rows.ends[B_UPPER, y] = box[LOWER, b, i], box[UPPER, b, i]
    _set_coordinates(rows.ends, stop, d_lower, d_upper)
    n_gaps = 0
    for x in range(count):
        n_gaps += _gather_row(box, rows, x, count)
        _set_along(rows, x, stop, d_lower, d_upper)
        if not _set_across(rows, x, stop):
            return -1
    if n_gaps > 0 and not _set_gaps(box, rows, count):
        return -1
    rows.points[count] = a
    if not _set_heights(rows, count, box[LOWER, a, b], box[UPPER, a, b]):
        return -1
    return count + 1


@kernel(inlined=True)
def _set_coordinates(ends: FloatArray, stop: int, d_lower: float, d_upper: float) -> None:
    """Write the bounds of A - B and of the coordinate of every point."""
    a_lower, a_upper, b_lower, b_upper = ends[A_LOWER], ends[A_UPPER], ends[B_LOWER], ends[B_UPPER]
    difference_lower, difference_upper = ends[DIFFERENCE_LOWER], ends[DIFFERENCE_UPPER]
    t_lower, t_upper = ends[T_LOWER], ends[T_UPPER]
    for y in range(stop):
        difference_lower[y] = down(a_lower[y] - b_upper[y])
    for y in range(stop):
        difference_upper[y] = up(a_upper[y] - b_lower[y])
    for y in range(stop):
        t_lower[y] = axis_coordinate(
            a_lower[y], a_upper[y], b_lower[y], b_upper[y], d_lower, d_upper
        )[0]
    for y in range(stop):
        t_upper[y] = axis_coordinate(
            a_lower[y], a_upper[y], b_lower[y], b_upper[y], d_lower, d_upper
        )[1]


@kernel(inlined=True)
def _set_heights(rows: Rows, count: int, c_lower: float, c_upper: float) -> bool:
    """Write the last row, the squared heights over the axis; False when no triangle is left."""
    ends, across = rows.ends, rows.across
    a_lower, a_upper, b_lower, b_upper = ends[A_LOWER], ends[A_UPPER], ends[B_LOWER], ends[B_UPPER]
    t_lower, t_upper = ends[T_LOWER], ends[T_UPPER]
    p_lower, p_upper = across[LOWER, count], across[UPPER, count]
    stop = lanes_of(count)
    for y in range(stop):
        p_lower[y] = squared_height(
            a_lower[y], a_upper[y], b_lower[y], b_upper[y], c_lower, c_upper
        )[0]
    for y in range(stop):
        p_upper[y] = squared_height(
            a_lower[y], a_upper[y], b_lower[y], b_upper[y], c_lower, c_upper
        )[1]
    n_empty = 0
    for y in range(stop):
        n_empty += 1 if (t_lower[y] > t_upper[y]) | (p_lower[y] > p_upper[y]) else 0
    for y in range(count):
        across[LOWER, y, count], across[UPPER, y, count] = p_lower[y], p_upper[y]
        across[GAP_LOWER, count, y] = across[GAP_LOWER, y, count] = 0.0
        across[GAP_UPPER, count, y] = across[GAP_UPPER, y, count] = 0.0
    return n_empty == 0


@kernel(inlined=True)
def _gather_row(box: FloatArray, rows: Rows, x: int, count: int) -> int:
    """Write the squared distances of a row before the projection; return how many have a gap."""
    i = rows.points[x]
    lower, upper = box[LOWER, i], box[UPPER, i]
    gap_lower, gap_upper = box[GAP_LOWER, i], box[GAP_UPPER, i]
    row_lower, row_upper = rows.squared[LOWER, x], rows.squared[UPPER, x]
    n_gaps = 0
    for y in range(count):
        j = rows.points[y]
        row_lower[y], row_upper[y] = lower[j], upper[j]
        n_gaps += gap_lower[j] < gap_upper[j]
    # The spare lanes are unbounded.
    row_lower[x], row_upper[x] = 0.0, math.inf
    for y in range(count, lanes_of(count)):
        row_lower[y], row_upper[y] = 0.0, math.inf
    return n_gaps


@kernel(inlined=True)
def _set_along(rows: Rows, x: int, stop: int, d_lower: float, d_upper: float) -> None:
    """Write the bounds of t_i - t_j of a row."""
    ends = rows.ends
    low, high = ends[DIFFERENCE_LOWER], ends[DIFFERENCE_UPPER]
    t_lower, t_upper = ends[T_LOWER], ends[T_UPPER]
    along_lower, along_upper = rows.along[LOWER, x], rows.along[UPPER, x]
    x_low, x_high, x_t_lower, x_t_upper = low[x], high[x], t_lower[x], t_upper[x]
    for y in range(stop):
        direct = -coordinate_difference_up(high[y], x_low, d_lower, d_upper)
        along_lower[y] = max(direct, down(x_t_lower - t_upper[y]))
    for y in range(stop):
        direct = coordinate_difference_up(x_high, low[y], d_lower, d_upper)
        along_upper[y] = min(direct, up(x_t_upper - t_lower[y]))


@kernel(inlined=True)
def _set_across(rows: Rows, x: int, stop: int) -> bool:
    """Write the projected squared distances of a row; False when a pair is impossible."""
    lower, upper = rows.squared[LOWER, x], rows.squared[UPPER, x]
    along_lower, along_upper = rows.along[LOWER, x], rows.along[UPPER, x]
    across_lower, across_upper = rows.across[LOWER, x], rows.across[UPPER, x]
    gap_lower, gap_upper = rows.across[GAP_LOWER, x], rows.across[GAP_UPPER, x]
    for y in range(stop):
        square_high = square_up(max(-along_lower[y], along_upper[y]))
        across_lower[y] = max(0.0, down(lower[y] - square_high))
    for y in range(stop):
        square_low = square_down(max(0.0, along_lower[y], -along_upper[y]))
        across_upper[y] = up(upper[y] - square_low)
    for y in range(stop):
        gap_lower[y] = gap_upper[y] = 0.0
    n_empty = 0
    for y in range(stop):
        is_empty = (along_lower[y] > along_upper[y]) | (across_lower[y] > across_upper[y])
        n_empty += 1 if is_empty else 0
    return n_empty == 0


@kernel(inlined=True)
def _set_gaps(box: FloatArray, rows: Rows, count: int) -> bool:
    """Carry the gaps of all pairs over; False when one is left without bounds."""
    for x in range(count):
        i = rows.points[x]
        for y in range(x + 1, count):
            j = rows.points[y]
            if box[GAP_LOWER, i, j] < box[GAP_UPPER, i, j]:
                square_low, square_high = square(rows.along[LOWER, x, y], rows.along[UPPER, x, y])
                gap_low = up(box[GAP_LOWER, i, j] - square_low)
                gap_high = down(box[GAP_UPPER, i, j] - square_high)
                if not exclude(rows.across, x, y, gap_low, gap_high):
                    return False
    return True
