# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The gradients of many exact distances: their normal equations, in steps that a limit may end.

Gradients have few entries each, and so do their products. LAPACK makes no use of that, and hands
matrices of this size to several threads: it takes ten times as long where other processes keep
one of them waiting. Nothing here is rounded outward: `existence` proves what comes of it.
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import FloatArray, IntArray


@kernel
def _products(pairs: IntArray, slopes: FloatArray) -> FloatArray:
    """Return the products of the gradients of pairs, the upper triangle."""
    count, dimension = slopes.shape
    products = np.zeros((count, count))
    for x in range(count):
        for y in range(x, count):
            # A gradient has its slope at the first point, and the opposite one at the second.
            common = int(pairs[x, 0] == pairs[y, 0]) + int(pairs[x, 1] == pairs[y, 1])
            common -= int(pairs[x, 0] == pairs[y, 1]) + int(pairs[x, 1] == pairs[y, 0])
            if common != 0:
                for axis in range(dimension):
                    products[x, y] += common * slopes[x, axis] * slopes[y, axis]
    return products


@kernel(borrows=True, watched=True)
def _factor_some(matrix: FloatArray, first: int, last: int) -> bool:
    """Factor some rows of a symmetric matrix as U^T U in place; False when it breaks down."""
    count = len(matrix)
    for k in range(first, last):
        if not matrix[k, k] > 0.0:
            return False
        root = math.sqrt(matrix[k, k])
        for j in range(k, count):
            matrix[k, j] /= root
        for i in range(k + 1, count):
            factor = matrix[k, i]
            if factor != 0.0:
                for j in range(i, count):
                    matrix[i, j] -= factor * matrix[k, j]
    return True


@kernel(borrows=True, watched=True)
def _invert_some(factored: FloatArray, inverse: FloatArray, first: int, last: int) -> None:
    """Write some rows of the inverse of U^T, a lower triangle; the others are zero."""
    for i in range(first, last):
        inverse[i, i] = 1.0
        for k in range(i):
            factor = factored[k, i]
            if factor != 0.0:
                for j in range(k + 1):
                    inverse[i, j] -= factor * inverse[k, j]
        for j in range(i + 1):
            inverse[i, j] /= factored[i, i]


@kernel(borrows=True, watched=True)
def _square_some(inverse: FloatArray, squared: FloatArray, first: int, last: int) -> None:
    """Add the products of some rows of a lower triangle with themselves."""
    for k in range(first, last):
        for i in range(k + 1):
            factor = inverse[k, i]
            if factor != 0.0:
                for j in range(k + 1):
                    squared[i, j] += factor * inverse[k, j]


@kernel
def _combined(pairs: IntArray, slopes: FloatArray, squared: FloatArray, size: int) -> FloatArray:
    """Return the transposed gradients of pairs, (size, m), times a matrix."""
    count, dimension = slopes.shape
    combined = np.zeros((size, count))
    for x in range(count):
        for axis in range(dimension):
            to, fro = pairs[x, 0] * dimension + axis, pairs[x, 1] * dimension + axis
            for y in range(count):
                value = slopes[x, axis] * squared[x, y]
                combined[to, y] += value
                combined[fro, y] -= value
    return combined


@kernel
def _solved(factored: FloatArray, vector: FloatArray) -> FloatArray:
    """Solve U^T U x = vector."""
    count = len(vector)
    solution = vector.copy()
    for i in range(count):
        solution[i] /= factored[i, i]
        for j in range(i + 1, count):
            solution[j] -= factored[i, j] * solution[i]
    for i in range(count - 1, -1, -1):
        for j in range(i + 1, count):
            solution[i] -= factored[i, j] * solution[j]
        solution[i] /= factored[i, i]
    return solution


@kernel
def _moved(pairs: IntArray, slopes: FloatArray, along: FloatArray, n_points: int) -> FloatArray:
    """Return the transposed gradients of pairs times a vector, by points."""
    moved = np.zeros((n_points, slopes.shape[1]))
    for x in range(len(pairs)):
        for axis in range(slopes.shape[1]):
            value = slopes[x, axis] * along[x]
            moved[pairs[x, 0], axis] += value
            moved[pairs[x, 1], axis] -= value
    return moved


def _in_steps(step: Callable[[int, int], bool | None], count: int) -> bool:
    """Take a step for some rows at a time, and look at the clock in between."""
    # A step for a row goes over half of a matrix, on average.
    work = 1 + count**2 // 4
    at_once = 1 + WORK_PER_LOOK // work
    for first in range(0, count, at_once):
        last = min(first + at_once, count)
        look_after((last - first) * work)
        if step(first, last) is False:
            return False
    return True


class Gradients:
    """
    The gradients of some pairs, the rows of a matrix A, with A A^T factored.

    The clock is looked at on the way (`look_after`).
    """

    def __init__(self, pairs: IntArray, slopes: FloatArray, n_points: int) -> None:
        self._pairs = pairs
        self._slopes = slopes
        self._n_points = n_points
        self._factored = _products(pairs, slopes)
        self.are_independent = _in_steps(
            lambda first, last: bool(_factor_some(self._factored, first, last)), len(pairs)
        )

    def least_displacements(self, values: FloatArray) -> FloatArray:
        """Return the shortest displacements e, shape (n, q), with A e = values."""
        along = _solved(self._factored, values)
        return np.asarray(_moved(self._pairs, self._slopes, along, self._n_points))

    def right_inverse(self) -> FloatArray:
        """Return A^T (A A^T)^-1, shape (n q, m)."""
        count = len(self._pairs)
        inverse, squared = np.zeros((2, count, count))
        _in_steps(lambda *some: _invert_some(self._factored, inverse, *some), count)
        _in_steps(lambda *some: _square_some(inverse, squared, *some), count)
        size = self._n_points * self._slopes.shape[1]
        return np.asarray(_combined(self._pairs, self._slopes, squared, size))
