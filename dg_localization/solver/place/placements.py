# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Placements: coordinates that meet the bounds of pairs.

A first placement comes from the Cholesky factorization of the Gram matrix of a box's middle
(Section 3, Eqs. 1-3). If few pairs of many points are known, classical scaling uses the shortest
chains of known pairs: between all of them, or from some pivots to all (Brandes, Pich,
Graph Drawing 2006; de Silva, Tenenbaum 2004). Damped least squares over the pairs then moves all
points together; the normal equations are sparse and solved by conjugate gradients. Nothing here is
rounded outward: `proofs` and `existence` decide whether a placement agrees.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel
from dg_localization.interval.rounding import LARGEST
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray

MARGIN = 0.1
"""Least squares aims this fraction of an interval's width inside its ends."""

MOST_STEPS, REFERENCE_STEPS = 30, 3
"""Most steps of least squares, in general and towards a reference that need not meet bounds."""

FIRST_DAMPING, MOST_DAMPING = 1e-6, 1e3
"""Terms added to the diagonal of the normal equations of unit vectors."""


class FitEffort(NamedTuple):
    """
    The stopping criteria of least squares.

    Parameters
    ----------
    least_gain : float
        It ends if a step reduces the rest by less than this fraction.
    least_residual : float
        The normal equations of a step are solved to this fraction,
    most_gradients : int
        or with this number of conjugate gradients.

    """

    least_gain: float
    least_residual: float
    most_gradients: int


THOROUGH, QUICK, IN_BOX = (
    FitEffort(1e-6, 1e-3, 100),
    FitEffort(1e-2, 1e-2, 30),
    FitEffort(1e-2, 1e-6, 100),
)
"""To convergence; in a third of the time with nearly as many placements found; for all pairs of a
box, where each step must be exact so that mirror images give the same answer."""


MARGINS = (MARGIN, 0.02, 0.004)
"""Several margins are tried, since exact distances may not allow a large margin in wide ones."""


def scaled(lengths_m: FloatArray, pivots: IntArray, dimension: int) -> FloatArray:
    """
    Return the placement that agrees best with the lengths from some points to all.

    With the lengths from all points it is the placement of classical scaling.
    """
    longest_m = max(float(lengths_m.max()), np.finfo(float).tiny)
    squared = (lengths_m / longest_m) ** 2
    among = squared[:, pivots]
    centering = np.eye(len(pivots)) - 1.0 / len(pivots)
    values, vectors = np.linalg.eigh(-0.5 * centering @ among @ centering)
    # Pivots on a line give no information across it.
    roots = np.sqrt(np.maximum(values[-dimension:], np.finfo(float).eps))
    positions = -0.5 * (squared.T - among.mean(axis=1)) @ (vectors[:, -dimension:] / roots)
    return np.ascontiguousarray(longest_m * positions)


def sought(
    start: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    stopped: Callable[[], bool],
) -> FloatArray:
    """Move a placement into the bounds of many pairs, with one margin after another."""
    for margin in MARGINS:
        start = refined(start, pairs, lower, upper, margin, stopped)
    return start


def refined(
    positions: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
    stopped: Callable[[], bool],
    effort: FitEffort = THOROUGH,
) -> FloatArray:
    """Move a placement into the bounds of many pairs by least squares."""
    best, damping = positions, FIRST_DAMPING
    at_once = 1 + WORK_PER_LOOK // (1 + len(pairs) * effort.most_gradients)
    for first in range(0, MOST_STEPS, at_once):
        if not damping < MOST_DAMPING or stopped():
            break
        n_steps = min(at_once, MOST_STEPS - first)
        best, damping = refine(best, pairs, lower, upper, margin, damping, effort, n_steps)
    return best


@kernel
def refine(
    positions: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
    damping: float,
    effort: FitEffort,
    n_steps: int,
) -> tuple[FloatArray, float]:
    """Take some steps of least squares; also return the damping, which is infinite at the end."""
    best = positions.copy()
    misfits, slopes = misfits_of(best, pairs, lower, upper, margin)
    total = _dot(misfits, misfits)
    for _ in range(n_steps):
        if total == 0.0 or not damping < MOST_DAMPING:
            return best, np.inf
        step = _step(pairs, misfits, slopes, damping, effort, len(best))
        trial = best - step
        trial_misfits, trial_slopes = misfits_of(trial, pairs, lower, upper, margin)
        trial_total = _dot(trial_misfits, trial_misfits)
        if not trial_total < total:
            damping *= 10.0
        elif trial_total > (1.0 - effort.least_gain) * total:
            return best, np.inf
        else:
            best, misfits, slopes = trial, trial_misfits, trial_slopes
            total, damping = trial_total, 0.1 * damping
    return best, damping


@kernel(inlined=True)
def _dot(first: FloatArray, second: FloatArray) -> float:
    """Return the scalar product of two vectors, summed in the same order without numba."""
    total = 0.0
    for x in range(len(first)):
        total += first[x] * second[x]
    return total


@kernel
def misfits_of(
    positions: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the violations of the bounds of pairs in m, and the unit vectors of the pairs."""
    dimension = positions.shape[1]
    misfits = np.zeros(len(pairs))
    slopes = np.zeros((len(pairs), dimension))
    for x in range(len(pairs)):
        i, j = pairs[x, 0], pairs[x, 1]
        squared = 0.0
        for axis in range(dimension):
            squared += (positions[i, axis] - positions[j, axis]) ** 2
        length = np.sqrt(squared)
        low, high = np.sqrt(lower[x]), np.sqrt(upper[x])
        if high < np.inf:
            inward = margin * (high - low)
            low += inward
            high -= inward
        misfits[x] = length - min(max(length, low), high)
        if misfits[x] != 0.0 and length > 0.0:
            for axis in range(dimension):
                slopes[x, axis] = (positions[i, axis] - positions[j, axis]) / length
    return misfits, slopes


@kernel
def _step(
    pairs: IntArray,
    misfits: FloatArray,
    slopes: FloatArray,
    damping: float,
    effort: FitEffort,
    n_points: int,
) -> FloatArray:
    """Solve the damped normal equations of the misfits by conjugate gradients."""
    # Most pairs lie within their bounds, and have no equation.
    missed = np.flatnonzero(misfits)
    ends, units = pairs[missed], slopes[missed]
    dimension = units.shape[1]
    step = np.zeros((n_points, dimension))
    rest = np.zeros((n_points, dimension))
    product = np.empty((n_points, dimension))
    for x in range(len(ends)):
        for axis in range(dimension):
            value = units[x, axis] * misfits[missed[x]]
            rest[ends[x, 0], axis] += value
            rest[ends[x, 1], axis] -= value
    direction = rest.copy()
    size = _dot(rest.ravel(), rest.ravel())
    enough = effort.least_residual**2 * size
    for _ in range(effort.most_gradients):
        if size <= enough or size == 0.0:
            break
        for i in range(n_points):
            for axis in range(dimension):
                product[i, axis] = damping * direction[i, axis]
        for x in range(len(ends)):
            i, j = ends[x, 0], ends[x, 1]
            along = 0.0
            for axis in range(dimension):
                along += units[x, axis] * (direction[i, axis] - direction[j, axis])
            for axis in range(dimension):
                product[i, axis] += units[x, axis] * along
                product[j, axis] -= units[x, axis] * along
        length = size / _dot(direction.ravel(), product.ravel())
        new_size = 0.0
        for i in range(n_points):
            for axis in range(dimension):
                step[i, axis] += length * direction[i, axis]
                rest[i, axis] -= length * product[i, axis]
                new_size += rest[i, axis] ** 2
        for i in range(n_points):
            for axis in range(dimension):
                direction[i, axis] = rest[i, axis] + new_size / size * direction[i, axis]
        size = new_size
    return step


@kernel
def _factor(middle: FloatArray, dimension: int) -> FloatArray:
    """
    Return the first coordinates of the Cholesky factorization of the Gram matrix.

    The pivot of each step is the point farthest from the space spanned so far, which keeps the
    factorization stable and makes points that coincide with the origin harmless.
    """
    n_points = len(middle)
    gram = np.empty((n_points, n_points))
    for i in range(n_points):
        for j in range(n_points):
            gram[i, j] = 0.5 * (middle[0, i] + middle[0, j] - middle[i, j])
    positions = np.zeros((n_points, dimension))
    for axis in range(dimension):
        pivot = 0
        for i in range(n_points):
            if gram[i, i] > gram[pivot, pivot]:
                pivot = i
        length = gram[pivot, pivot]
        if length <= 0.0:
            break
        root = math.sqrt(length)
        for i in range(n_points):
            positions[i, axis] = gram[i, pivot] / root
        for i in range(n_points):
            for j in range(n_points):
                gram[i, j] -= positions[i, axis] * positions[j, axis]
    return positions


@kernel
def place(box: FloatArray, dimension: int, most_steps: int) -> FloatArray:
    """
    Return the coordinates of a placement in or near a box, in m and of either chirality.

    The upper bounds of the box are finite, or overflowed.
    """
    # The squares of squared distances must not overflow; a power of two changes no digit.
    finite = np.minimum(box, LARGEST)
    _, exponent = math.frexp(finite[UPPER].max())
    half = max(0, exponent) // 2
    unit = finite * math.ldexp(1.0, -2 * half)
    positions = _factor(0.5 * (unit[LOWER] + unit[UPPER]), dimension)
    n_points = len(positions)
    n_pairs = n_points * (n_points - 1) // 2
    pairs = np.empty((n_pairs, 2), dtype=np.int64)
    lower, upper = np.empty(n_pairs), np.empty(n_pairs)
    x = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            pairs[x, 0], pairs[x, 1] = i, j
            lower[x], upper[x] = unit[LOWER, i, j], unit[UPPER, i, j]
            x += 1
    damping, effort = FIRST_DAMPING, IN_BOX
    fitted = refine(positions, pairs, lower, upper, MARGIN, damping, effort, most_steps)[0]
    return fitted * math.ldexp(1.0, half)
