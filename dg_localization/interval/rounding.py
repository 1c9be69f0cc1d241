# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Outward rounding: the only place where a computed number becomes a bound.

IEEE 754 addition, multiplication, division and square root are correctly rounded, so the exact
result of one operation lies within half a unit in the last place of the computed one. `up` and
`down` move by at least one such unit and at most two, which makes the result a bound.

The step is ``|x| 2^-52 + 2^-1074``: for x in [2^e, 2^(e+1)) the unit is 2^(e-52) <= |x| 2^-52,
and where that product underflows the second term is the unit itself. Adding a multiple of the
unit and rounding to nearest cannot fall short of the next number, because rounding is monotone.
The step is branch-free and scales exactly with powers of two.

Where an operation overflows, its exact result is beyond the largest double, which is then the
bound on the near side. So `down` never returns +inf and `up` never -inf, and sums of bounds are
never inf - inf (docs/rigor.md).
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel

UNIT = 2.0**-52
TINIEST = 2.0**-1074
LARGEST = (2.0 - UNIT) * 2.0**1023


def step_up(x: float) -> float:
    """Return a number above the exact value whose nearest double is `x`."""
    x = max(x, -LARGEST)
    return x + (abs(x) * UNIT + TINIEST)


def step_down(x: float) -> float:
    """Return a number below the exact value whose nearest double is `x`."""
    x = min(x, LARGEST)
    return x - (abs(x) * UNIT + TINIEST)


# The kernels have separate names: plain Python calls the functions above, which never wait for a
# compiler.
up = kernel(step_up)
down = kernel(step_down)


@kernel
def square_up(x: float) -> float:
    """Return an upper bound of x^2."""
    return up(x * x)


@kernel
def square_down(x: float) -> float:
    """Return a lower bound of x^2, never below zero."""
    return max(0.0, down(x * x))


@kernel
def sqrt_up(x: float) -> float:
    """Return an upper bound of the root of `x`, or zero if `x` is not positive."""
    return up(math.sqrt(x)) if x > 0.0 else 0.0


@kernel
def rounding_error(magnitude: float, operations: float) -> float:
    """
    Bound the rounding error of a sum of products, for one test or one step at the end.

    Each of the additions, subtractions and multiplications errs by at most half a unit of its
    result. As long as no intermediate result exceeds `magnitude`, they err by no more than half a
    unit of it each; counted as a whole one, which leaves room for products of these errors.

    Parameters
    ----------
    magnitude : float
        Bound of the absolute values of all intermediate results, itself computed with rounding.
    operations : float
        Number of operations, below 2**20.

    Returns
    -------
    float
        At least the error of the computed result.

    """
    return operations * (magnitude * UNIT + TINIEST)


@kernel
def elapsed_up(first: float, second: float) -> float:
    """Return an upper bound of the time between two stamps, as `arrays.elapsed_up` does."""
    return up(up(abs(first - second)) + np.spacing(max(abs(first), abs(second))))


@kernel
def sqrt_down(x: float) -> float:
    """Return a lower bound of the root of `x`, or zero if `x` is not positive."""
    return max(0.0, down(math.sqrt(x))) if x > 0.0 else 0.0
