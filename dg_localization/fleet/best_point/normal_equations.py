# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The normal equations of the terms, summed up term by term.

A body has six columns: its position, and a small rotation about the axes of the fixed frame after
its own rotation. In the plane, and for known coordinates, some columns are left out.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.terms import (
    DIFFERENCE,
    PLACE,
    RANGE,
    RAY,
    READINGS,
    STEP,
    TURN,
)
from dg_localization.interval.kernels import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEFT_OUT = -1
"""The column of fixed coordinates."""

SHORTEST_M = 1e-9
"""The direction between nearer ends is undefined."""


@kernel
def normal_equations(
    kinds: IntArray,
    bodies: IntArray,
    arms_m: FloatArray,
    values: FloatArray,
    weights: FloatArray,
    robust: bool,
    positions_m: FloatArray,
    rotations: FloatArray,
    columns: IntArray,
    matrix: FloatArray,
    vector: FloatArray,
) -> float:
    """
    Write the normal equations of some terms; return their cost.

    Parameters
    ----------
    kinds, bodies, arms_m, values, weights
        The fields of `Terms`.
    robust : bool
        Whether a reading costs log(1 + e) instead of its squared residual e (Cauchy), so that
        readings far beyond their bounds have little weight. Their rows are weighted to match.
    positions_m : numpy.ndarray, shape (n, 3)
        Positions of the bodies.
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to fixed frame.
    columns : numpy.ndarray of int, shape (n, 6)
        The columns of the coordinates of each body in the equations, or `LEFT_OUT`.
    matrix : numpy.ndarray, shape (k, k)
        Receives the products of the derivatives.
    vector : numpy.ndarray, shape (k,)
        Receives half the gradient.

    Returns
    -------
    float
        The sum of the squared residuals, with the Cauchy cost for robust ones.

    """
    matrix[:] = 0.0
    vector[:] = 0.0
    total = 0.0
    arms = np.zeros((2, 3))
    sight = np.zeros(3)
    unit = np.zeros(3)
    line = np.zeros(3)
    residual = np.zeros(3)
    change = np.zeros((3, 3))
    slopes = np.zeros((3, 12))
    for term in range(len(kinds)):
        kind = kinds[term]
        weight = weights[term]
        first, second = bodies[term, 0], bodies[term, 1]
        for axis in range(3):
            for end in range(2):
                body = bodies[term, end]
                arms[end, axis] = 0.0
                for k in range(3):
                    arms[end, axis] += rotations[body, axis, k] * arms_m[term, end, k]
            sight[axis] = 0.0
            for k in range(3):
                sight[axis] += rotations[first, axis, k] * values[term, k]
        for axis in range(3):
            line[axis] = positions_m[second, axis] + arms[1, axis]
            line[axis] -= positions_m[first, axis] + arms[0, axis]
        length = math.sqrt(line[0] * line[0] + line[1] * line[1] + line[2] * line[2])
        length = max(length, SHORTEST_M)
        # The residual, and its derivative with respect to the line from end to end.
        n_rows = 3
        if kind == RANGE:
            n_rows = 1
            residual[0] = weight * (length - values[term, 0])
            for axis in range(3):
                change[0, axis] = weight * line[axis] / length
        elif kind == DIFFERENCE:
            n_rows = 1
            for axis in range(2):
                unit[axis] = values[term, axis] - positions_m[first, axis] - arms[0, axis]
            away = max(math.hypot(unit[0], unit[1]), SHORTEST_M)
            unit[2] = 0.0
            residual[0] = weight * (length - away - values[term, 2])
            for axis in range(3):
                change[0, axis] = weight * (line[axis] / length - unit[axis] / away)
        elif kind in (PLACE, STEP):
            for row in range(3):
                residual[row] = weight * line[row]
                if kind == PLACE:
                    residual[row] = weight * (values[term, row] - positions_m[first, row])
                for axis in range(3):
                    change[row, axis] = weight if row == axis else 0.0
        elif kind == TURN:
            for axis in range(3):
                residual[axis] = weight * (rotations[second, axis, 0] - sight[axis])
                for row in range(3):
                    change[row, axis] = 0.0
        else:
            for axis in range(3):
                unit[axis] = line[axis] / length
                residual[axis] = weight * (unit[axis] - sight[axis])
            for row in range(3):
                for axis in range(3):
                    across = (1.0 if row == axis else 0.0) - unit[row] * unit[axis]
                    change[row, axis] = weight * across / length
        for row in range(n_rows):
            for axis in range(3):
                a, b = (axis + 1) % 3, (axis + 2) % 3
                slopes[row, axis] = -change[row, axis]
                slopes[row, axis + 6] = 0.0 if kind == PLACE else change[row, axis]
                # A rotation about an axis moves an arm r by the cross product of axis and r.
                slopes[row, axis + 3] = arms[0, b] * change[row, a] - arms[0, a] * change[row, b]
                slopes[row, axis + 9] = arms[1, a] * change[row, b] - arms[1, b] * change[row, a]
                if kind in (RAY, TURN) and row == a:
                    slopes[row, axis + 3] += weight * sight[b]
                elif kind in (RAY, TURN) and row == b:
                    slopes[row, axis + 3] -= weight * sight[a]
                if kind == TURN and row == a:
                    slopes[row, axis + 9] -= weight * rotations[second, b, 0]
                elif kind == TURN and row == b:
                    slopes[row, axis + 9] += weight * rotations[second, a, 0]
        squared = 0.0
        for row in range(n_rows):
            squared += residual[row] * residual[row]
        if robust and kind in READINGS:
            total += math.log1p(squared)
            share = 1.0 / math.sqrt(1.0 + squared)
            for row in range(n_rows):
                residual[row] *= share
                for i in range(12):
                    slopes[row, i] *= share
        else:
            total += squared
        for i in range(12):
            column = columns[first, i] if i < 6 else columns[second, i - 6]
            if column == LEFT_OUT:
                continue
            for row in range(n_rows):
                vector[column] += slopes[row, i] * residual[row]
            for j in range(12):
                other = columns[first, j] if j < 6 else columns[second, j - 6]
                if other == LEFT_OUT:
                    continue
                for row in range(n_rows):
                    matrix[column, other] += slopes[row, i] * slopes[row, j]
    return total
