# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Placements: coordinates inside a box.

A first placement comes from the Cholesky factorization of the Gram matrix of the box's middle
(Section 3, Eqs. 1-3). Least squares then moves it into the intervals. Nothing here is rounded
outward: whether a placement agrees with the measurements is decided in `proofs`.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import LARGEST
from dg_localization.solver.box import LOWER, UPPER, FloatArray

MARGIN = 0.1
"""Least squares aims this fraction of an interval's width inside its ends."""

MOST_STEPS = 40
"""Least squares takes at most so many steps."""

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


@kernel(watched=True)
def refine(positions: FloatArray, box: FloatArray, most_steps: int) -> FloatArray:
    """
    Move a placement into the intervals of a box by damped least squares.

    The damping follows how well each step was predicted (H. B. Nielsen, Damping parameter in
    Marquardt's method, 1999).
    """
    n_points, dimension = positions.shape
    size = positions.size
    best, vector, trial_vector = positions.copy(), np.empty(size), np.empty(size)
    matrix, factor, trial_matrix = np.empty((3, size, size))
    misfit = _assemble(best, box, matrix, vector)
    damping, growth = FIRST_DAMPING, 2.0
    for _ in range(most_steps):
        if misfit == 0.0 or damping > MOST_DAMPING:
            break
        scale = 0.0
        for i in range(size):
            scale = max(scale, matrix[i, i])
        factor[:] = matrix
        step = vector.copy()
        if not solve_damped(factor, step, damping * scale + 1e-300):
            break
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
            break
        matrix[:], vector[:] = trial_matrix, trial_vector
        surprise = 1.0 - 2.0 * gain / max(predicted, 1e-300)
        damping *= max(LEAST_DECREASE, 1.0 + surprise * surprise * surprise)
        damping, growth = max(damping, LEAST_DAMPING), 2.0
    return best


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
    scaled = finite * math.ldexp(1.0, -2 * half)
    positions = _factor(0.5 * (scaled[LOWER] + scaled[UPPER]), dimension)
    return refine(positions, scaled, most_steps) * math.ldexp(1.0, half)
