# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Back-projection: bounds in the space orthogonal to an axis narrow the box (Section 4.3).

With the coordinate t along the axis, u = d - t, and the squared distance p from the axis,

    A = t^2 + p,   B = u^2 + p,   C = d^2 = (t + u)^2,   s_ij = (t_i - t_j)^2 + s'_ij

(Eqs. 18, 19, 21), and B = A + C - 2 d t (Eq. 22). Each relation is used forwards to narrow the
squared distances and backwards to narrow t, u and t_i - t_j, whose signs are open: the two
branches of a root are intersected separately and joined last (Eq. 20).
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
    exclude,
    narrow,
)
from dg_localization.solver.contract.projection import (
    T_LOWER,
    T_UPPER,
    Rows,
)


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
def _along(
    t: tuple[float, float],
    a: tuple[float, float],
    b: tuple[float, float],
    p: tuple[float, float],
    d: tuple[float, float],
) -> tuple[float, float, float, float]:
    """Narrow t and u = d - t by t^2 = A - p and u^2 = B - p; empty ones are reversed."""
    t_lower, t_upper = reverse_square(t[0], t[1], down(a[0] - p[1]), up(a[1] - p[0]))
    u_lower, u_upper = reverse_square(
        down(d[0] - t_upper), up(d[1] - t_lower), down(b[0] - p[1]), up(b[1] - p[0])
    )
    t_lower = max(t_lower, down(d[0] - u_upper))
    t_upper = min(t_upper, up(d[1] - u_lower))
    return t_lower, t_upper, u_lower, u_upper


@kernel(inlined=True)
def _end(
    far: tuple[float, float],
    t: tuple[float, float],
    u: tuple[float, float],
    p: tuple[float, float],
    d: tuple[float, float],
) -> tuple[float, float]:
    """Bound A = t^2 + p by all known bounds, including B (or B, with t and u exchanged)."""
    low, high = far_squared_distance(far[0], far[1], u[0], u[1], d[0], d[1])
    square_low, square_high = square(t[0], t[1])
    return max(low, down(square_low + p[0])), min(high, up(square_high + p[1]))


@kernel(inlined=True)
def _narrow_point(box: FloatArray, rows: Rows, last: int, a: int, b: int, x: int) -> bool:
    """Narrow A, B, C and the coordinate of the point in row `x` from its reduced height."""
    i = rows.points[x]
    ends, across = rows.ends, rows.across
    p = across[LOWER, last, x], across[UPPER, last, x]
    d = sqrt_down(box[LOWER, a, b]), sqrt_up(box[UPPER, a, b])
    b_bounds = box[LOWER, b, i], box[UPPER, b, i]
    t_lower, t_upper, u_lower, u_upper = _along(
        (ends[T_LOWER, x], ends[T_UPPER, x]), (box[LOWER, a, i], box[UPPER, a, i]), b_bounds, p, d
    )
    if u_lower > u_upper or t_lower > t_upper:
        return False
    ends[T_LOWER, x] = t_lower
    ends[T_UPPER, x] = t_upper
    u_least, u_most = sqrt_down(down(b_bounds[0] - p[1])), sqrt_up(up(b_bounds[1] - p[0]))
    if not _narrow_axis(box, a, b, t_lower, t_upper, u_least, u_most):
        return False
    gap = across[GAP_LOWER, last, x], across[GAP_UPPER, last, x]
    t, u = (t_lower, t_upper), (u_lower, u_upper)
    if not _narrow_end(box, a, i, _end(b_bounds, t, u, p, d), square(t_lower, t_upper), gap):
        return False
    a_bounds = box[LOWER, a, i], box[UPPER, a, i]
    return _narrow_end(box, b, i, _end(a_bounds, u, t, p, d), square(u_lower, u_upper), gap)


@kernel(inlined=True)
def _narrow_pair(box: FloatArray, rows: Rows, x: int, y: int) -> bool:
    """Narrow s_ij and both coordinates from the reduced distance in the orthogonal space."""
    ends, across = rows.ends, rows.across
    # t_i - t_j, whose square is s_ij - s'_ij.
    low = max(rows.along[LOWER, x, y], down(ends[T_LOWER, x] - ends[T_UPPER, y]))
    high = min(rows.along[UPPER, x, y], up(ends[T_UPPER, x] - ends[T_LOWER, y]))
    least_m2 = down(rows.squared[LOWER, x, y] - across[UPPER, x, y])
    most_m2 = up(rows.squared[UPPER, x, y] - across[LOWER, x, y])
    low, high = reverse_square(low, high, least_m2, most_m2)
    if low > high:
        return False
    ends[T_LOWER, x] = max(ends[T_LOWER, x], down(ends[T_LOWER, y] + low))
    ends[T_UPPER, x] = min(ends[T_UPPER, x], up(ends[T_UPPER, y] + high))
    ends[T_LOWER, y] = max(ends[T_LOWER, y], down(ends[T_LOWER, x] - high))
    ends[T_UPPER, y] = min(ends[T_UPPER, y], up(ends[T_UPPER, x] - low))
    if ends[T_LOWER, x] > ends[T_UPPER, x]:
        return False
    if ends[T_LOWER, y] > ends[T_UPPER, y]:
        return False

    i, j = rows.points[x], rows.points[y]
    square_low, square_high = square(low, high)
    low = down(square_low + across[LOWER, x, y])
    high = up(square_high + across[UPPER, x, y])
    if not narrow(box, i, j, low, high):
        return False
    if across[GAP_LOWER, x, y] < across[GAP_UPPER, x, y]:
        gap_low = up(across[GAP_LOWER, x, y] + square_high)
        gap_high = down(across[GAP_UPPER, x, y] + square_low)
        return exclude(box, i, j, gap_low, gap_high)
    return True


@kernel(borrows=True)
def back_project(box: FloatArray, rows: Rows, count: int, a: int, b: int) -> bool:
    """
    Narrow `box` in place by its reduced projection (Section 4.3).

    Return False if no placement is left.
    """
    # The axis itself is narrowed by the points only, after the pairs.
    last = count - 1
    for x in range(last):
        for y in range(x + 1, last):
            if not _narrow_pair(box, rows, x, y):
                return False
    for x in range(last):
        if not _narrow_point(box, rows, last, a, b, x):
            return False
    return True
