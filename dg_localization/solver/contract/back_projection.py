# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Back-projection: what is known in the space orthogonal to an axis narrows the box (Section 4.3).

With the coordinate t along the axis, u = d - t, and the squared distance p from the axis,

    A = t^2 + p,   B = u^2 + p,   C = d^2 = (t + u)^2,   s_ij = (t_i - t_j)^2 + s'_ij

(Eqs. 18, 19, 21), and B = A + C - 2 d t (Eq. 22). Each relation is used forwards to narrow the
squared distances and backwards to narrow t, u and t_i - t_j, whose signs are open: the two
branches of a root are intersected apart and joined last (Eq. 20).
"""

from __future__ import annotations

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.interval.scalars import reverse_square, square
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    exclude,
    narrow,
)
from dg_localization.solver.contract.projection import coordinate_difference


@kernel
def far_squared_distance(
    a_lower: float,
    a_upper: float,
    t_lower: float,
    t_upper: float,
    d_lower: float,
    d_upper: float,
) -> tuple[float, float]:
    """
    Bound B = A + d^2 - 2 d t (Eq. 22) from bounds of A, t and d.

    B increases with A and decreases with t; in d it is convex with its minimum at d = t
    (Eqs. 23-26).
    """
    high = up(
        a_upper
        + max(
            up(d_lower * up(d_lower - 2.0 * t_lower)) if d_lower > 0.0 else 0.0,
            up(d_upper * up(d_upper - 2.0 * t_lower)),
        )
    )
    d = min(max(t_upper, d_lower), d_upper)
    low = down(a_lower + down(d * down(d - 2.0 * t_upper)))
    return low, high


@kernel(inlined=True)
def _narrow_axis(
    box: FloatArray,
    a: int,
    b: int,
    t_lower: float,
    t_upper: float,
    u_least: float,
    u_most: float,
) -> bool:
    """Narrow C by d = t + u, where u lies in [-u_most, -u_least] or [u_least, u_most]."""
    minus_high = up(t_upper - u_least)
    plus_low = down(t_lower + u_least)
    plus_high = up(t_upper + u_most)
    if minus_high < 0.0:
        if plus_high < 0.0:
            return False
        return narrow(box, a, b, square_down(max(plus_low, 0.0)), square_up(plus_high))
    low = square_down(max(down(t_lower - u_most), 0.0))
    if not narrow(box, a, b, low, square_up(plus_high)):
        return False
    return exclude(box, a, b, square_up(minus_high), square_down(max(plus_low, 0.0)))


@kernel(inlined=True)
def _narrow_end(
    box: FloatArray,
    end: int,
    i: int,
    bounds: tuple[float, float],
    square: tuple[float, float],
    height_gap: tuple[float, float],
) -> bool:
    """
    Narrow the squared distance of `i` to an axis end, and carry a gap of p over.

    The squared distance is p plus the square of the distance along the axis.
    """
    if not narrow(box, end, i, bounds[0], bounds[1]):
        return False
    if height_gap[0] < height_gap[1]:
        return exclude(box, end, i, up(height_gap[0] + square[1]), down(height_gap[1] + square[0]))
    return True


@kernel(inlined=True)
def _narrow_point(
    box: FloatArray, projected: FloatArray, coordinates: FloatArray, a: int, b: int, i: int
) -> bool:
    """Narrow A, B, C and the coordinate of point `i` from its reduced height."""
    p_lower = projected[LOWER, a, i]
    p_upper = projected[UPPER, a, i]
    d_lower = sqrt_down(box[LOWER, a, b])
    d_upper = sqrt_up(box[UPPER, a, b])

    t_lower, t_upper = reverse_square(
        coordinates[LOWER, i],
        coordinates[UPPER, i],
        down(box[LOWER, a, i] - p_upper),
        up(box[UPPER, a, i] - p_lower),
    )
    if t_lower > t_upper:
        return False
    u_square_low = down(box[LOWER, b, i] - p_upper)
    u_square_high = up(box[UPPER, b, i] - p_lower)
    u_lower, u_upper = reverse_square(
        down(d_lower - t_upper), up(d_upper - t_lower), u_square_low, u_square_high
    )
    if u_lower > u_upper:
        return False
    t_lower = max(t_lower, down(d_lower - u_upper))
    t_upper = min(t_upper, up(d_upper - u_lower))
    if t_lower > t_upper:
        return False
    coordinates[LOWER, i] = t_lower
    coordinates[UPPER, i] = t_upper

    if not _narrow_axis(
        box, a, b, t_lower, t_upper, sqrt_down(u_square_low), sqrt_up(u_square_high)
    ):
        return False

    gap = projected[GAP_LOWER, a, i], projected[GAP_UPPER, a, i]
    t_square_low, t_square_high = square(t_lower, t_upper)
    u_square_low, u_square_high = square(u_lower, u_upper)
    low, high = far_squared_distance(
        box[LOWER, b, i], box[UPPER, b, i], u_lower, u_upper, d_lower, d_upper
    )
    low = max(low, down(t_square_low + p_lower))
    high = min(high, up(t_square_high + p_upper))
    if not _narrow_end(box, a, i, (low, high), (t_square_low, t_square_high), gap):
        return False
    low, high = far_squared_distance(
        box[LOWER, a, i], box[UPPER, a, i], t_lower, t_upper, d_lower, d_upper
    )
    low = max(low, down(u_square_low + p_lower))
    high = min(high, up(u_square_high + p_upper))
    return _narrow_end(box, b, i, (low, high), (u_square_low, u_square_high), gap)


@kernel(inlined=True)
def _narrow_pair(
    box: FloatArray,
    projected: FloatArray,
    coordinates: FloatArray,
    a: int,
    b: int,
    i: int,
    j: int,
    d_bounds: tuple[float, float],
) -> bool:
    """Narrow s_ij and both coordinates from the reduced distance in the orthogonal space."""
    low, high = coordinate_difference(box, a, b, i, j, d_bounds[0], d_bounds[1])
    low = max(low, down(coordinates[LOWER, i] - coordinates[UPPER, j]))
    high = min(high, up(coordinates[UPPER, i] - coordinates[LOWER, j]))
    low, high = reverse_square(
        low,
        high,
        down(box[LOWER, i, j] - projected[UPPER, i, j]),
        up(box[UPPER, i, j] - projected[LOWER, i, j]),
    )
    if low > high:
        return False
    coordinates[LOWER, i] = max(coordinates[LOWER, i], down(coordinates[LOWER, j] + low))
    coordinates[UPPER, i] = min(coordinates[UPPER, i], up(coordinates[UPPER, j] + high))
    coordinates[LOWER, j] = max(coordinates[LOWER, j], down(coordinates[LOWER, i] - high))
    coordinates[UPPER, j] = min(coordinates[UPPER, j], up(coordinates[UPPER, i] - low))
    if coordinates[LOWER, i] > coordinates[UPPER, i]:
        return False
    if coordinates[LOWER, j] > coordinates[UPPER, j]:
        return False

    square_low, square_high = square(low, high)
    low = down(square_low + projected[LOWER, i, j])
    high = up(square_high + projected[UPPER, i, j])
    if not narrow(box, i, j, low, high):
        return False
    if projected[GAP_LOWER, i, j] < projected[GAP_UPPER, i, j]:
        gap_low = up(projected[GAP_LOWER, i, j] + square_high)
        gap_high = down(projected[GAP_UPPER, i, j] + square_low)
        return exclude(box, i, j, gap_low, gap_high)
    return True


@kernel(borrows=True)
def back_project(
    box: FloatArray,
    projected: FloatArray,
    coordinates: FloatArray,
    projected_points: IntArray,
    a: int,
    b: int,
) -> bool:
    """
    Narrow `box` in place by its projection, after that was reduced (Section 4.3).

    Parameters
    ----------
    box, projected : ndarray, shape (4, n, n)
        The box, and its projection after reduction, as written by `project`.
    coordinates : ndarray, shape (2, n)
        Bounds of the coordinates along the axis in m; narrowed as well.
    projected_points : ndarray of int
        `a` and the projected points.
    a, b : int
        The axis.

    Returns
    -------
    bool
        False when no placement is left.

    """
    n_projected = len(projected_points)
    # The axis itself is narrowed by the points only, after the pairs.
    d_bounds = sqrt_down(box[LOWER, a, b]), sqrt_up(box[UPPER, a, b])
    for x in range(1, n_projected):
        i = projected_points[x]
        for y in range(x + 1, n_projected):
            j = projected_points[y]
            if not _narrow_pair(box, projected, coordinates, a, b, i, j, d_bounds):
                return False
    for x in range(1, n_projected):
        if not _narrow_point(box, projected, coordinates, a, b, projected_points[x]):
            return False
    return True
