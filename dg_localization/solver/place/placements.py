# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Placements: coordinates inside a box.

A first placement comes from the Cholesky factorization of the Gram matrix of the box's middle
(Section 3, Eqs. 1-3). Least squares then moves it into the intervals. Nothing here is rounded
outward: whether a placement agrees with the measurements is decided in `proofs`.
"""

from __future__ import annotations

from collections.abc import Callable
import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel
from dg_localization.interval.rounding import LARGEST
from dg_localization.solver.box import LOWER, UPPER, FloatArray

MARGIN = 0.1
"""Least squares aims this fraction of an interval's width inside its ends."""

MOST_STEPS = 40
"""Least squares takes at most so many steps."""

AT_ONCE = 60
"""So many coordinates are placed whatever the time: that takes a millisecond or two."""

LEAST_GAIN = 0.01
"""A step that gains less than this fraction of the misfit is the last: others go where all agrees,
or nowhere."""

FIRST_DAMPING, LEAST_DAMPING, MOST_DAMPING = 0.1, 1e-12, 1e3
"""Damping, as a fraction of the largest diagonal entry of the normal equations."""

LEAST_DECREASE = 0.1
"""What a step that gains as much as predicted leaves of the damping, and no step less."""


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


@kernel(borrows=True)
def _assemble(
    positions: FloatArray, box: FloatArray, matrix: FloatArray, vector: FloatArray
) -> float:
    """
    Write the normal equations of the misfit of every distance; return its sum of squares.

    Of the symmetric matrix, only the lower triangle is written.
    """
    n_points, dimension = positions.shape
    matrix[:] = 0.0
    vector[:] = 0.0
    total = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            low = box[LOWER, i, j]
            high = box[UPPER, i, j]
            squared = 0.0
            for axis in range(dimension):
                squared += (positions[i, axis] - positions[j, axis]) ** 2
            if not math.isinf(high):
                margin = MARGIN * (high - low)
                low += margin
                high -= margin
            misfit = squared - min(max(squared, low), high)
            # Divided by the distance, so that meters are compared and not their squares.
            weight = 1.0 / max(squared, 0.5 * (low + min(high, squared + low)), 1e-300)
            if misfit == 0.0:
                weight *= 1e-3
            total += weight * misfit * misfit
            for axis in range(dimension):
                row = 2.0 * (positions[i, axis] - positions[j, axis])
                row_i, row_j = i * dimension + axis, j * dimension + axis
                vector[row_i] += weight * misfit * row
                vector[row_j] -= weight * misfit * row
                for other in range(dimension):
                    value = weight * row * 2.0 * (positions[i, other] - positions[j, other])
                    matrix[row_j, i * dimension + other] -= value
                    if other <= axis:
                        matrix[row_i, i * dimension + other] += value
                        matrix[row_j, j * dimension + other] += value
    return total


@kernel(borrows=True)
def solve_damped(matrix: FloatArray, vector: FloatArray, damping: float) -> bool:
    """
    Solve (matrix + damping) x = vector in place by Cholesky; False when it breaks down.

    Only the lower triangle of the matrix is used. It is factored column by column: the entries
    of a column do not wait for each other.
    """
    size = len(vector)
    for j in range(size):
        pivot = matrix[j, j] + damping
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if pivot <= 0.0:
            return False
        matrix[j, j] = math.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
    for i in range(size):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True


class Descent(NamedTuple):
    """
    Damped least squares on the way.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        The best coordinates so far, in m.
    matrix, vector : ndarray
        The normal equations there.
    trials : ndarray, shape (2, n q, n q)
        Scratch: the factor of a step, and the normal equations after it.
    trial_vector : ndarray, shape (n q,)
        Scratch.
    numbers : ndarray, shape (3,)
        The misfit in m^2, the damping, and what it grows by when a step fails.

    """

    positions: FloatArray
    matrix: FloatArray
    vector: FloatArray
    trials: FloatArray
    trial_vector: FloatArray
    numbers: FloatArray


@kernel
def _begin(positions: FloatArray, box: FloatArray) -> Descent:
    """Return least squares before the first step."""
    size = positions.size
    matrix, vector = np.empty((size, size)), np.empty(size)
    best = positions.copy()
    misfit = _assemble(best, box, matrix, vector)
    numbers = np.array([misfit, FIRST_DAMPING, 2.0])
    return Descent(best, matrix, vector, np.empty((2, size, size)), np.empty(size), numbers)


@kernel(watched=True)
def _descend(descent: Descent, box: FloatArray, most_steps: int) -> bool:
    """Take steps of least squares; return whether there is no other one."""
    best, matrix, vector = descent.positions, descent.matrix, descent.vector
    trial_vector, numbers = descent.trial_vector, descent.numbers
    n_points, dimension = best.shape
    size = n_points * dimension
    factor, trial_matrix = descent.trials[0], descent.trials[1]
    misfit, damping, growth = numbers[0], numbers[1], numbers[2]
    for _ in range(most_steps):
        if misfit == 0.0 or damping > MOST_DAMPING:
            return True
        scale = 0.0
        for i in range(size):
            scale = max(scale, matrix[i, i])
        factor[:] = matrix
        step = vector.copy()
        if not solve_damped(factor, step, damping * scale + 1e-300):
            return True
        trial = best - step.reshape((n_points, dimension))
        trial_misfit = _assemble(trial, box, trial_matrix, trial_vector)
        if not trial_misfit < misfit:
            damping *= growth
            growth *= 2.0
            continue
        predicted = 0.0
        for i in range(size):
            predicted += step[i] * (damping * scale * step[i] + vector[i])
        gain = misfit - trial_misfit
        is_last = gain < LEAST_GAIN * misfit
        best[:], misfit = trial, trial_misfit
        if is_last:
            return True
        matrix[:], vector[:] = trial_matrix, trial_vector
        surprise = 1.0 - 2.0 * gain / max(predicted, 1e-300)
        damping *= max(LEAST_DECREASE, 1.0 + surprise * surprise * surprise)
        damping, growth = max(damping, LEAST_DAMPING), 2.0
    numbers[0], numbers[1], numbers[2] = misfit, damping, growth
    return False


@kernel
def refine(positions: FloatArray, box: FloatArray, most_steps: int) -> FloatArray:
    """
    Move a placement into the intervals of a box by damped least squares.

    The damping follows how well each step was predicted (H. B. Nielsen, Damping parameter in
    Marquardt's method, 1999).
    """
    descent = _begin(positions, box)
    _descend(descent, box, most_steps)
    return descent.positions


@kernel
def _first(box: FloatArray, dimension: int) -> tuple[FloatArray, FloatArray, float]:
    """Return a first placement, the box that it is for, and the unit of both in m."""
    # The squares of squared distances must not overflow; a power of two changes no digit.
    finite = np.minimum(box, LARGEST)
    _, exponent = math.frexp(finite[UPPER].max())
    half = max(0, exponent) // 2
    scaled = finite * math.ldexp(1.0, -2 * half)
    middle = 0.5 * (scaled[LOWER] + scaled[UPPER])
    return _factor(middle, dimension), scaled, math.ldexp(1.0, half)


@kernel
def place(box: FloatArray, dimension: int, most_steps: int) -> FloatArray:
    """
    Return the coordinates of a placement in or near a box.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; its upper bounds are finite, or overflowed.
    dimension : int
        The dimension q of the space.
    most_steps : int
        Most steps of least squares.

    Returns
    -------
    ndarray, shape (n, q)
        Coordinates in m, of either chirality.

    """
    positions, scaled, unit_m = _first(box, dimension)
    return refine(positions, scaled, most_steps) * unit_m


def place_step_by_step(
    box: FloatArray, dimension: int, stopped: Callable[[], bool] = lambda: False
) -> FloatArray:
    """Return what `place` does; once `stopped` returns true, what was found so far."""
    if box.shape[1] * dimension <= AT_ONCE:
        return np.asarray(place(box, dimension, MOST_STEPS))
    positions, scaled, unit_m = _first(box, dimension)
    descent = _begin(positions, scaled)
    # Most of a step is the factorization of the normal equations.
    at_once = 1 + WORK_PER_LOOK // (1 + positions.size**3 // 6)
    for done in range(0, MOST_STEPS, at_once):
        if _descend(descent, scaled, min(at_once, MOST_STEPS - done)) or stopped():
            break
    return np.asarray(descent.positions * unit_m)
