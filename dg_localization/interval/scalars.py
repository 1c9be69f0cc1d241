# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Elementary operations on intervals, rounded outward.

An interval is given by its two ends, `low` and `high`, as in IEEE 1788-2015 (set-based flavour):
the closed set of the real numbers between them. An infinite end is a missing bound, never a number
of the set. The empty set is (inf, -inf), the result of any operation on an empty operand; an
operand with ``low > high`` counts as empty. Ends are never NaN; except in the empty set, a low end
is never +inf and a high end never -inf. Signed zeros are equal.

Each operation contains the standard's tightest interval and exceeds it by at most two units in the
last place at either end, zero by the least positive number, and an end near the least normal
number by three of those. `reverse_square` is sqrRev with its second argument. Decorations, NaI and
mid-rad forms do not exist here: arguments outside the domain of a function are ignored, and a
caller that needs to know inspects the operands. Nothing divides intervals.
"""

from __future__ import annotations

import math

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up


@kernel
def intersection(a_low: float, a_high: float, b_low: float, b_high: float) -> tuple[float, float]:
    """Return the intersection of two intervals."""
    low, high = max(a_low, b_low), min(a_high, b_high)
    if low > high:
        return math.inf, -math.inf
    return low, high


@kernel
def hull(a_low: float, a_high: float, b_low: float, b_high: float) -> tuple[float, float]:
    """Return the smallest interval that holds two intervals."""
    if a_low > a_high:
        return b_low, b_high
    if b_low > b_high:
        return a_low, a_high
    return min(a_low, b_low), max(a_high, b_high)


@kernel
def add(a_low: float, a_high: float, b_low: float, b_high: float) -> tuple[float, float]:
    """Bound x + y."""
    if a_low > a_high or b_low > b_high:
        return math.inf, -math.inf
    return down(a_low + b_low), up(a_high + b_high)


@kernel
def sub(a_low: float, a_high: float, b_low: float, b_high: float) -> tuple[float, float]:
    """Bound x - y."""
    return add(a_low, a_high, -b_high, -b_low)


@kernel
def _times(x: float, y: float) -> float:
    """Multiply two ends, where zero times an infinite end is zero."""
    return x * y if x != 0.0 and y != 0.0 else 0.0


@kernel
def mul(a_low: float, a_high: float, b_low: float, b_high: float) -> tuple[float, float]:
    """Bound x y."""
    if a_low > a_high or b_low > b_high:
        return math.inf, -math.inf
    corners = (
        _times(a_low, b_low),
        _times(a_low, b_high),
        _times(a_high, b_low),
        _times(a_high, b_high),
    )
    return down(min(corners)), up(max(corners))


@kernel
def square(low: float, high: float) -> tuple[float, float]:
    """Bound x^2."""
    if low > high:
        return math.inf, -math.inf
    smallest = max(0.0, low, -high)
    largest = max(-low, high)
    return square_down(smallest), square_up(largest)


@kernel
def reverse_square(
    low: float, high: float, square_low: float, square_high: float
) -> tuple[float, float]:
    """Bound the x of [low, high] whose square lies in [square_low, square_high]."""
    if square_low > square_high or square_high < 0.0:
        return math.inf, -math.inf
    least = sqrt_down(square_low)
    largest = sqrt_up(square_high)
    minus_low, minus_high = intersection(low, high, -largest, -least)
    plus_low, plus_high = intersection(low, high, least, largest)
    return hull(minus_low, minus_high, plus_low, plus_high)
