# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Levenberg-Marquardt steps, projected on a box.

Every step that is taken lowers the cost and stays in the box. Nothing is rounded
outward: the result is an estimate.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.normal_equations import LEFT_OUT, normal_equations
from dg_localization.interval.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MOST_STEPS = 30
FIRST_DAMPING = 1e-3
LEAST_DAMPING = 1e-9
MOST_DAMPING = 1e6
LEAST_GAIN = 1e-6
"""A step that lowers the cost by less than this fraction is the last."""

LEAST_TURN_RAD = 1e-12
"""A smaller turn does not count."""


@kernel(borrows=True)
def _turn(rotation: FloatArray, x: float, y: float, z: float) -> None:
    """Follow a rotation by a small one about the axes of the fixed frame, in place (Rodrigues)."""
    angle = math.sqrt(x * x + y * y + z * z)
    if not angle > LEAST_TURN_RAD:
        return
    x, y, z = x / angle, y / angle, z / angle
    s, c = math.sin(angle), math.cos(angle)
    for column in range(3):
        u, v, w = rotation[0, column], rotation[1, column], rotation[2, column]
        along = (1.0 - c) * (x * u + y * v + z * w)
        rotation[0, column] = c * u + s * (y * w - z * v) + along * x
        rotation[1, column] = c * v + s * (z * u - x * w) + along * y
        rotation[2, column] = c * w + s * (x * v - y * u) + along * z


@kernel(borrows=True)
def _solve_damped(matrix: FloatArray, vector: FloatArray, damping: float) -> bool:
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


@kernel(borrows=True)
def _find_step(
    matrix: FloatArray,
    vector: FloatArray,
    damping: float,
    held: NDArray[np.bool_],
    factor: FloatArray,
    step: FloatArray,
) -> bool:
    """Write the damped step, zero for what is held; False when there is none."""
    size = len(vector)
    greatest = 1e-300
    for i in range(size):
        greatest = max(greatest, matrix[i, i])
    for i in range(size):
        step[i] = 0.0 if held[i] else -vector[i]
        for j in range(i + 1):
            factor[i, j] = 0.0 if held[i] or held[j] else matrix[i, j]
        # What no term depends on gets a diagonal all the same, and does not move.
        factor[i, i] += damping * matrix[i, i] + 1e-12 * greatest
        if held[i]:
            factor[i, i] = greatest
    return _solve_damped(factor, step, 0.0)


@kernel
def descend(
    kinds: IntArray,
    bodies: IntArray,
    arms_m: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    robust: bool,
    positions_m: FloatArray,
    rotations: FloatArray,
    lower_m: FloatArray,
    upper_m: FloatArray,
    columns: IntArray,
    size: int,
) -> tuple[float, FloatArray, FloatArray, FloatArray]:
    """
    Lower the cost of some terms from a start, within bounds.

    Parameters
    ----------
    kinds, bodies, arms_m, values, weights
        The fields of `PackedTerms`.
    robust : bool
        See `normal_equations`.
    positions_m, rotations
        The start, which lies within the bounds.
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
    columns : numpy.ndarray of int, shape (n, 6)
        Numbers of what may change, `LEFT_OUT` elsewhere.
    size : int
        How many there are.

    Returns
    -------
    cost : float
    positions_m, rotations, matrix : numpy.ndarray
        The result, and its normal equations.

    """
    n_bodies = len(positions_m)
    matrix, trial_matrix = np.empty((size, size)), np.empty((size, size))
    vector, trial_vector = np.empty(size), np.empty(size)
    factor, step, held = np.empty((size, size)), np.empty(size), np.empty(size, dtype=np.bool_)
    best_m, turned = positions_m.copy(), rotations.copy()
    cost = normal_equations(
        kinds, bodies, arms_m, values, weights, robust, best_m, turned, columns, matrix, vector
    )
    damping = FIRST_DAMPING
    for _ in range(MOST_STEPS):
        held[:] = False
        for body in range(n_bodies):
            for axis in range(3):
                column = columns[body, axis]
                if column != LEFT_OUT:
                    at_lower = best_m[body, axis] <= lower_m[body, axis]
                    at_upper = best_m[body, axis] >= upper_m[body, axis]
                    # The descent is against the gradient.
                    pushes_out = (at_lower and vector[column] > 0.0) or (
                        at_upper and vector[column] < 0.0
                    )
                    held[column] = pushes_out
        if not _find_step(matrix, vector, damping, held, factor, step):
            break
        trial_m, trial_turned = best_m.copy(), turned.copy()
        for body in range(n_bodies):
            turn = np.zeros(3)
            for axis in range(3):
                column = columns[body, axis]
                if column != LEFT_OUT:
                    moved_m = best_m[body, axis] + step[column]
                    moved_m = min(max(moved_m, lower_m[body, axis]), upper_m[body, axis])
                    trial_m[body, axis] = moved_m
                if columns[body, axis + 3] != LEFT_OUT:
                    turn[axis] = step[columns[body, axis + 3]]
            _turn(trial_turned[body], turn[0], turn[1], turn[2])
        trial_cost = normal_equations(
            kinds,
            bodies,
            arms_m,
            values,
            weights,
            robust,
            trial_m,
            trial_turned,
            columns,
            trial_matrix,
            trial_vector,
        )
        if trial_cost < cost:
            gain = cost - trial_cost
            cost, best_m, turned = trial_cost, trial_m, trial_turned
            matrix, trial_matrix = trial_matrix, matrix
            vector, trial_vector = trial_vector, vector
            damping = max(0.1 * damping, LEAST_DAMPING)
            if gain <= LEAST_GAIN * cost:
                break
        else:
            damping *= 10.0
            if damping > MOST_DAMPING:
                break
    return cost, best_m, turned, matrix
