# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of single numbers, rounded outward, for code that is not a kernel.

These are plain Python functions: a callback that calls one never waits for a compiler. Arguments
are exact numbers, or bounds on the side that the result bounds: `sum_up` of upper bounds is an
upper bound. A name that ends in `_up` returns an upper bound, one in `_down` a lower bound.
"""

from __future__ import annotations

import math

from dg_localization.interval.rounding import TINIEST, step_down, step_up


def sum_up(*terms: float) -> float:
    """Return an upper bound of a sum; infinite if a term is."""
    if math.inf in terms:
        return math.inf
    total = terms[0]
    for term in terms[1:]:
        total = step_up(total + term)
    return total


def sum_down(*terms: float) -> float:
    """Return a lower bound of a sum; minus infinity if a term is."""
    if -math.inf in terms:
        return -math.inf
    total = terms[0]
    for term in terms[1:]:
        total = step_down(total + term)
    return total


def product_up(x: float, y: float) -> float:
    """Return an upper bound of x y, where zero times infinity is zero (IEEE 1788-2015, 10.5.3)."""
    return step_up(x * y) if x != 0.0 and y != 0.0 else 0.0


def product_down(x: float, y: float) -> float:
    """Return a lower bound of x y, where zero times infinity is zero (IEEE 1788-2015, 10.5.3)."""
    return step_down(x * y) if x != 0.0 and y != 0.0 else 0.0


def quotient_up(x: float, y: float) -> float:
    """Return an upper bound of x / y for y > 0, and infinity for y = 0."""
    return step_up(x / y) if y > 0.0 else math.inf


def quotient_down(x: float, y: float) -> float:
    """Return a lower bound of x / y for x >= 0 and y > 0, and zero for y = 0."""
    return max(0.0, step_down(x / y)) if y > 0.0 else 0.0


def square_up(x: float) -> float:
    """Return an upper bound of x^2."""
    return step_up(x * x)


def square_down(x: float) -> float:
    """Return a lower bound of x^2, never below zero."""
    return max(0.0, step_down(x * x))


def sqrt_up(x: float) -> float:
    """Return an upper bound of the root of `x`, or zero where `x` is not positive."""
    return step_up(math.sqrt(x)) if x > 0.0 else 0.0


def sqrt_down(x: float) -> float:
    """Return a lower bound of the root of `x`, or zero where `x` is not positive."""
    return max(0.0, step_down(math.sqrt(x))) if x > 0.0 else 0.0


def squared_distance(lower_m: float, upper_m: float) -> tuple[float, float]:
    """
    Bound the square of a distance.

    Parameters
    ----------
    lower_m, upper_m : float
        Bounds of the distance in m. A negative lower bound counts as zero.

    Returns
    -------
    tuple of float
        Bounds of its square in m^2; reversed (empty) if `upper_m` is negative.

    """
    lower_m2 = square_down(max(lower_m, 0.0))
    if upper_m < 0.0:
        return max(lower_m2, TINIEST), 0.0
    return lower_m2, square_up(upper_m)


def elapsed_up(first_s: float, second_s: float) -> float:
    """
    Return an upper bound of the time between two stamps, in s.

    A stamp of nanoseconds since 1970 does not fit a double: each may be off by half a unit. So the
    time between two equal numbers may be above zero.

    Parameters
    ----------
    first_s, second_s : float
        Times in s, each the double next to the true one.

    Returns
    -------
    float
        At least the time between the true ones.

    """
    unit_s = math.ulp(max(abs(first_s), abs(second_s)))
    return step_up(step_up(abs(first_s - second_s)) + unit_s) if first_s != second_s else unit_s
