# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Angles and their sines and cosines in kernels, rounded outward.

Intervals are those of `scalars`. The functions of the C library err by much less than
`ANGLE_ROUNDING` (`angles`).
"""

from __future__ import annotations

import math

from dg_localization.interval import angles
from dg_localization.interval.angles import ANGLE_ROUNDING
from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, square_up

SMALLEST_PRODUCT = 1e-280
"""Products of coordinates below this may have lost bits."""

# Plain Python calls the function, which never waits for a compiler.
angle_up = kernel(angles.angle_up)


@kernel
def cosine(low: float, high: float) -> tuple[float, float]:
    """Bound cos x for angles in [-pi, pi] in rad; beyond that nothing is bounded."""
    largest = max(-low, high)
    if low > high or largest > math.pi:
        return -1.0, 1.0
    smallest = max(0.0, low, -high)
    below, above = math.cos(largest) - ANGLE_ROUNDING, math.cos(smallest) + ANGLE_ROUNDING
    # Where the angle is very small, 1 - x^2 / 2 is a better bound than the function.
    below = max(below, down(1.0 - 0.5 * square_up(largest)), -1.0)
    return below, min(above, 1.0)


@kernel
def sine(low: float, high: float) -> tuple[float, float]:
    """Bound sin x for angles in [-pi, pi] in rad; beyond that nothing is bounded."""
    if low > high or max(-low, high) > math.pi:
        return -1.0, 1.0
    below, above = math.sin(low), math.sin(high)
    below, above = min(below, above) - ANGLE_ROUNDING, max(below, above) + ANGLE_ROUNDING
    quarter = 0.5 * math.pi
    if low - ANGLE_ROUNDING < -quarter < high + ANGLE_ROUNDING:
        below = -1.0
    if low - ANGLE_ROUNDING < quarter < high + ANGLE_ROUNDING:
        above = 1.0
    return max(below, -1.0), min(above, 1.0)


@kernel
def arccosine(low: float, high: float) -> tuple[float, float]:
    """Bound the angles in [0, pi] in rad whose cosines lie between two numbers."""
    least = math.acos(min(max(high, -1.0), 1.0)) - ANGLE_ROUNDING
    return max(0.0, least), math.acos(min(max(low, -1.0), 1.0)) + ANGLE_ROUNDING


@kernel
def arcsine(low: float, high: float) -> tuple[float, float]:
    """Bound the angles in [-pi/2, pi/2] in rad whose sines lie between two numbers."""
    least = math.asin(min(max(low, -1.0), 1.0)) - ANGLE_ROUNDING
    return least, math.asin(min(max(high, -1.0), 1.0)) + ANGLE_ROUNDING


@kernel
def angle_between(ax: float, ay: float, bx: float, by: float) -> tuple[float, float]:
    """
    Bound the angle from one vector of the plane to another, counterclockwise in [-pi, pi].

    The products err by three units of |a| |b| altogether, which turns the result by about as much.
    Where they may underflow or overflow nothing is bounded.
    """
    dot, cross = ax * bx + ay * by, ax * by - ay * bx
    size = abs(dot) + abs(cross)
    if not SMALLEST_PRODUCT < size < math.inf:
        return -math.inf, math.inf
    angle = math.atan2(cross, dot)
    return angle - ANGLE_ROUNDING, angle + ANGLE_ROUNDING
