# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Projection of a point and of a pair along an axis (Section 4.1).

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


@kernel
def _coordinate_up(difference: float, d: float, half: float) -> float:
    """
    Bound from above the coordinate (Eq. 7) for A - B = `difference` and axis length `d`.

    `half` is d / 2. With -d / 2 and the other sign of the difference it is minus the bound from
    below.
    """
    if d == 0.0:
        return math.inf if difference > 0.0 else 0.0
    return up(up(difference / (2.0 * d)) + half)


@kernel(inlined=True)
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
    that is an admissible length. Both bounds are then cut by the triangle relations
    |t| <= sqrt(A) and |t - d| <= sqrt(B), which give bounds even if d may vanish.
    """
    high_difference = up(a_upper - b_lower)
    high = _coordinate_up(high_difference, d_upper, 0.5 * d_upper)
    if high_difference > 0.0:
        high = max(high, _coordinate_up(high_difference, d_lower, 0.5 * d_lower))

    low_difference = down(a_lower - b_upper)
    if low_difference > 0.0 and sqrt_up(low_difference) >= d_lower:
        low = sqrt_down(low_difference)
        if low > d_upper:
            low = -_coordinate_up(-low_difference, d_upper, -0.5 * d_upper)
    else:
        low = -_coordinate_up(-low_difference, d_lower, -0.5 * d_lower)

    reach_a = sqrt_up(a_upper)
    reach_b = sqrt_up(b_upper)
    low = max(low, -reach_a, down(d_lower - reach_b))
    high = min(high, reach_a, up(d_upper + reach_b))
    return low, high


@kernel
def coordinate_difference_up(high: float, low: float, d_lower: float, d_upper: float) -> float:
    """
    Bound t_i - t_j = ((A_i - B_i) - (A_j - B_j)) / (2 d) from above, in which d / 2 cancels.

    Every squared distance occurs once and the quotient is monotone in d on either side of zero,
    so the corner named by the sign of the numerator, A_i - B_i from above less A_j - B_j from
    below, gives the tightest bound. Minus the bound of t_j - t_i is that from below.
    """
    high = up(high - low)
    if d_lower == 0.0:
        return math.inf if high > 0.0 else 0.0
    return up(high / (2.0 * (d_lower if high > 0.0 else d_upper)))


@kernel(inlined=True)
def _height_edge(a: float, b_lower: float, b_upper: float, c: float) -> tuple[float, float]:
    """
    Bound A - (A - B + C)^2 / (4 C) at the two corners of an edge of the box, for C > 0.

    The subtrahend, rounding included, grows with |A - B + C| alone. So the corner with the larger
    value gives the lower bound, the other one the upper bound.
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


@kernel(inlined=True)
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
    """
    ceiling = min(a_upper, b_upper)
    if c_lower <= 0.0:
        return 0.0, ceiling
    low_1, high_1 = _height_edge(a_lower, b_lower, b_upper, c_lower)
    low_2, high_2 = _height_edge(a_lower, b_lower, b_upper, c_upper)
    low_3, high_3 = _height_edge(a_upper, b_lower, b_upper, c_lower)
    low_4, high_4 = _height_edge(a_upper, b_lower, b_upper, c_upper)
    low = min(low_1, low_2, low_3, low_4)
    high = max(high_1, high_2, high_3, high_4)
    right_at_b = (a_upper >= down(b_upper + c_lower)) & (a_lower <= up(b_upper + c_upper))
    right_at_a = (b_upper >= down(a_upper + c_lower)) & (b_lower <= up(a_upper + c_upper))
    if right_at_a | right_at_b:
        high = ceiling
    return max(low, 0.0), min(high, ceiling)
