# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Projection of a distance box along the axis of two of its points (Section 4.1).

For an axis from point a to point b and a further point i, write A = s_ai, B = s_bi, C = s_ab and
d = sqrt(C). The coordinate of i along the axis, measured from a, is

    t_i = (A - B) / (2 d) + d / 2                                  (Eq. 7)

its squared distance from the axis is p_i = A - t_i^2 (Eq. 8), and two points i, j are

    s'_ij = s_ij - (t_i - t_j)^2

apart in the space orthogonal to the axis, where a and b are one point. The bounds below are the
tightest ones over the box of the arguments, found by the monotonicity of Eqs. (9)-(17), and
rounded outward; plain interval evaluation would be wider because its terms share variables.
"""

from __future__ import annotations

import math

from dg_localization.interval.kernels import kernel
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

LEAST_AXIS_RATIO = 0.3
"""A pair serves as an axis when its squared distance is known to this ratio of its bounds."""


@kernel
def _coordinate_up(difference: float, d: float) -> float:
    """Bound from above the coordinate (Eq. 7) for A - B = `difference` and axis length `d`."""
    if d == 0.0:
        return math.inf if difference > 0.0 else 0.0
    return up(up(difference / (2.0 * d)) + 0.5 * d)


@kernel
def _coordinate_down(difference: float, d: float) -> float:
    """Bound from below the coordinate (Eq. 7) for A - B = `difference` and axis length `d`."""
    if d == 0.0:
        return -math.inf if difference < 0.0 else 0.0
    return down(down(difference / (2.0 * d)) + 0.5 * d)


@kernel
def axis_coordinate(
    a_lower: float,
    a_upper: float,
    b_lower: float,
    b_upper: float,
    d_lower: float,
    d_upper: float,
) -> tuple[float, float]:
    """
    Bound the coordinate of a point along an axis (Eqs. 7 and 9-12).

    Equation (7) increases with A and decreases with B. In d it is convex where A > B, with its
    minimum sqrt(A - B) at d = sqrt(A - B), and increasing otherwise. Hence the maximum lies at
    A+, B- and an end of d; the minimum at A-, B+ and an end of d, or at d = sqrt(A- - B+) when
    that is an admissible length. Both bounds are then cut by what any triangle obeys,
    |t| <= sqrt(A) and |t - d| <= sqrt(B), which gives bounds even where d may vanish.

    Parameters
    ----------
    a_lower, a_upper, b_lower, b_upper : float
        Squared distances to the two ends of the axis in m^2, finite.
    d_lower, d_upper : float
        Length of the axis in m, finite.

    Returns
    -------
    tuple of float
        Lower and upper bound of the signed coordinate in m; reversed when the box holds no
        triangle at all.

    """
    high_difference = up(a_upper - b_lower)
    high = _coordinate_up(high_difference, d_upper)
    if high_difference > 0.0:
        high = max(high, _coordinate_up(high_difference, d_lower))

    low_difference = down(a_lower - b_upper)
    if low_difference > 0.0:
        if sqrt_up(low_difference) < d_lower:
            low = _coordinate_down(low_difference, d_lower)
        elif sqrt_down(low_difference) > d_upper:
            low = _coordinate_down(low_difference, d_upper)
        else:
            low = sqrt_down(low_difference)
    else:
        low = _coordinate_down(low_difference, d_lower)

    reach_a = sqrt_up(a_upper)
    reach_b = sqrt_up(b_upper)
    low = max(low, -reach_a, down(d_lower - reach_b))
    high = min(high, reach_a, up(d_upper + reach_b))
    return low, high


@kernel
def coordinate_difference(
    box: FloatArray, a: int, b: int, i: int, j: int, d_lower: float, d_upper: float
) -> tuple[float, float]:
    """
    Bound t_i - t_j = (A_i - B_i - A_j + B_j) / (2 d), in which d / 2 cancels.

    Every squared distance occurs once and the quotient is monotone in d on either side of zero,
    so the corner named by the sign of the numerator gives the tightest bounds.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; the distances of both points to both ends of the axis are finite.
    a, b : int
        The axis.
    i, j : int
        The points.
    d_lower, d_upper : float
        Length of the axis in m, finite.

    Returns
    -------
    tuple of float
        Lower and upper bound in m; infinite where `d_lower` is zero and the sign is open.

    """
    high = up(up(box[UPPER, a, i] - box[LOWER, b, i]) + up(box[UPPER, b, j] - box[LOWER, a, j]))
    low = down(
        down(box[LOWER, a, i] - box[UPPER, b, i]) + down(box[LOWER, b, j] - box[UPPER, a, j])
    )
    if d_lower == 0.0:
        high = math.inf if high > 0.0 else 0.0
        low = -math.inf if low < 0.0 else 0.0
        return low, high
    high = up(high / (2.0 * (d_lower if high > 0.0 else d_upper)))
    low = down(low / (2.0 * (d_lower if low < 0.0 else d_upper)))
    return low, high


@kernel
def _height_edge(a: float, b_lower: float, b_upper: float, c: float) -> tuple[float, float]:
    """
    Bound A - (A - B + C)^2 / (4 C) at the two corners of an edge of the box, for C > 0.

    What is subtracted, rounding included, grows with |A - B + C| alone. So the corner
    where it is larger is enough for the lower bound, that where it is smaller for the upper bound.
    """
    low_at_lower = down(down(a - b_lower) + c)
    low_at_upper = down(down(a - b_upper) + c)
    high_at_lower = up(up(a - b_lower) + c)
    high_at_upper = up(up(a - b_upper) + c)
    # Halved before they are squared: 4 C may overflow.
    largest = 0.5 * max(-low_at_upper, high_at_lower)
    smallest = 0.5 * max(
        0.0, min(max(low_at_lower, -high_at_lower), max(low_at_upper, -high_at_upper))
    )
    height_low = down(a - up(square_up(largest) / c))
    height_high = up(a - down(square_down(smallest) / c))
    return height_low, height_high


@kernel
def squared_height(
    a_lower: float,
    a_upper: float,
    b_lower: float,
    b_upper: float,
    c_lower: float,
    c_upper: float,
) -> tuple[float, float]:
    """
    Bound p = A - t^2, the squared distance of a point from the axis (Eqs. 8 and 13-17).

    p = A - (A - B + C)^2 / (4 C) is concave in each argument alone, so its minimum is at one of
    the eight corners. Its maximum is B+ where a right angle at b is possible with B = B+
    (p <= B always, with equality there), A+ likewise at a, and else at a corner: with
    0 < t < d throughout, p grows with A and B; beyond either end it grows towards that end.

    Parameters
    ----------
    a_lower, a_upper, b_lower, b_upper, c_lower, c_upper : float
        Squared sides in m^2, finite; C is the squared length of the axis.

    Returns
    -------
    tuple of float
        Lower bound, clipped at zero because the box may hold impossible triangles, and upper
        bound in m^2. The upper bound is negative when all of them are impossible.

    """
    ceiling = min(a_upper, b_upper)
    if c_lower <= 0.0:
        return 0.0, ceiling
    low = math.inf
    high = -math.inf
    for a in (a_lower, a_upper):
        for c in (c_lower, c_upper):
            edge_low, edge_high = _height_edge(a, b_lower, b_upper, c)
            low = min(low, edge_low)
            high = max(high, edge_high)
    right_at_b = a_upper >= down(b_upper + c_lower) and a_lower <= up(b_upper + c_upper)
    right_at_a = b_upper >= down(a_upper + c_lower) and b_lower <= up(a_upper + c_upper)
    if right_at_a or right_at_b:
        high = ceiling
    return max(low, 0.0), min(high, ceiling)


@kernel(borrows=True)
def _store(projected: FloatArray, i: int, j: int, low: float, high: float) -> None:
    """Set pair (i, j) of a projected box to [low, high] without a gap."""
    projected[LOWER, i, j] = projected[LOWER, j, i] = low
    projected[UPPER, i, j] = projected[UPPER, j, i] = high
    projected[GAP_LOWER, i, j] = projected[GAP_LOWER, j, i] = 0.0
    projected[GAP_UPPER, i, j] = projected[GAP_UPPER, j, i] = 0.0


@kernel(borrows=True)
def is_axis(box: FloatArray, a: int, b: int) -> bool:
    """
    Return whether a pair is known well enough to project along it.

    The bounds above widen quickly as the relative error of the axis grows; docs/projections.md
    has the measurements behind the limit.
    """
    upper = box[UPPER, a, b]
    return not math.isinf(upper) and box[LOWER, a, b] > LEAST_AXIS_RATIO * upper


@kernel(borrows=True)
def project(
    box: FloatArray,
    projected: FloatArray,
    coordinates: FloatArray,
    points: IntArray,
    projected_points: IntArray,
    a: int,
    b: int,
) -> int:
    """
    Project the points of a box along the axis from `a` to `b` (Section 4.1).

    Parameters
    ----------
    box, projected : ndarray, shape (4, n, n)
        The box to project and where the projected one is written. There, `a` stands for the
        common image of both ends of the axis. The distance of the two ends must be finite.
    coordinates : ndarray, shape (2, n)
        Where the bounds of each point's coordinate along the axis are written, in m.
    points : ndarray of int
        The points of `box` to project.
    projected_points : ndarray of int
        Where `a` and the projected points are written. A point infinitely far from an end is left
        out.
    a, b : int
        The axis.

    Returns
    -------
    int
        The number of `projected_points`; -1 when no placement is left.

    """
    d_lower = sqrt_down(box[LOWER, a, b])
    d_upper = sqrt_up(box[UPPER, a, b])
    projected_points[0] = a
    n_projected = 1
    for x in range(len(points)):
        i = points[x]
        if i == a or i == b or math.isinf(box[UPPER, a, i]) or math.isinf(box[UPPER, b, i]):
            continue
        if not _project_point(box, projected, coordinates, (a, b, i), (d_lower, d_upper)):
            return -1
        projected_points[n_projected] = i
        n_projected += 1
    for x in range(1, n_projected):
        i = projected_points[x]
        for y in range(x + 1, n_projected):
            j = projected_points[y]
            low, high = coordinate_difference(box, a, b, i, j, d_lower, d_upper)
            low = max(low, down(coordinates[LOWER, i] - coordinates[UPPER, j]))
            high = min(high, up(coordinates[UPPER, i] - coordinates[LOWER, j]))
            if low > high or not _project_pair(box, projected, i, j, low, high):
                return -1
    return n_projected


@kernel(inlined=True)
def _project_point(
    box: FloatArray,
    projected: FloatArray,
    coordinates: FloatArray,
    triangle: tuple[int, int, int],
    d_bounds: tuple[float, float],
) -> bool:
    """Write the coordinate and the squared height of a point over an axis; False: none is left."""
    a, b, i = triangle
    low, high = axis_coordinate(
        box[LOWER, a, i],
        box[UPPER, a, i],
        box[LOWER, b, i],
        box[UPPER, b, i],
        d_bounds[0],
        d_bounds[1],
    )
    if low > high:
        return False
    coordinates[LOWER, i] = low
    coordinates[UPPER, i] = high
    low, high = squared_height(
        box[LOWER, a, i],
        box[UPPER, a, i],
        box[LOWER, b, i],
        box[UPPER, b, i],
        box[LOWER, a, b],
        box[UPPER, a, b],
    )
    _store(projected, a, i, low, high)
    return low <= high


@kernel(inlined=True)
def _project_pair(
    box: FloatArray, projected: FloatArray, i: int, j: int, low: float, high: float
) -> bool:
    """Write the projected squared distance of two points that are [low, high] apart along it."""
    square_low, square_high = square(low, high)
    low = max(0.0, down(box[LOWER, i, j] - square_high))
    high = up(box[UPPER, i, j] - square_low)
    if low > high:
        return False
    _store(projected, i, j, low, high)
    if box[GAP_LOWER, i, j] < box[GAP_UPPER, i, j]:
        gap_low = up(box[GAP_LOWER, i, j] - square_low)
        gap_high = down(box[GAP_UPPER, i, j] - square_high)
        return exclude(projected, i, j, gap_low, gap_high)
    return True
