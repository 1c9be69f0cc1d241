# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What a placement can still do: whether the measured distances leave it free to move.

The rows of the rigidity matrix are the gradients of the squared distances that were measured. Its
kernel holds the motions of the whole fleet and, where its rank is lower than
q n - q (q + 1) / 2, motions that no measurement resists: a flex.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import FloatArray

RANK_TOLERANCE = 1e-6
"""A gradient of which less than this fraction is new does not count."""


@kernel
def _gradients(positions: FloatArray, measured: NDArray[np.bool_]) -> tuple[FloatArray, int, int]:
    """
    Return unit gradients of measured pairs, their number, and how many make a placement rigid.

    They are given by columns, (q n, m): what is done to all is done to several at once. Of points
    that coincide there is none. Where all distances are measured, nothing is asked of them.
    """
    n_points, dimension = positions.shape
    n_pairs = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if measured[i, j]:
                n_pairs += 1
    if n_pairs == n_points * (n_points - 1) // 2:
        return np.zeros((n_points * dimension, 0)), 0, 0
    columns = np.zeros((n_points * dimension, n_pairs))
    row = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if not measured[i, j]:
                continue
            total = 0.0
            for axis in range(dimension):
                total += (positions[i, axis] - positions[j, axis]) ** 2
            # The gradient has the direction to and fro: its length is sqrt(2) times the distance.
            length = math.sqrt(2.0 * total)
            if length > 0.0:
                for axis in range(dimension):
                    slope = (positions[i, axis] - positions[j, axis]) / length
                    columns[i * dimension + axis, row] = slope
                    columns[j * dimension + axis, row] = -slope
                row += 1
    span = min(n_points - 1, dimension)
    motions = dimension + span * (2 * dimension - span - 1) // 2
    return columns, row, n_points * dimension - motions


@kernel(borrows=True, watched=True)
def _count_some(
    columns: FloatArray, left: FloatArray, along: FloatArray, squares: FloatArray, most: int
) -> int:
    """Return how many unit rows are new, at most `most`, their part in others taken away."""
    n_columns, n_rows = columns.shape
    for count in range(most):
        pivot = 0
        for row in range(n_rows):
            if left[row] > left[pivot]:
                pivot = row
        if n_rows == 0 or left[pivot] <= RANK_TOLERANCE * RANK_TOLERANCE:
            return count
        length = math.sqrt(left[pivot])
        left[pivot] = 0.0
        along[:] = 0.0
        for c in range(n_columns):
            column, of_pivot = columns[c], columns[c, pivot]
            for row in range(n_rows):
                along[row] += column[row] * of_pivot
        for row in range(n_rows):
            # Pivots stay as they are.
            along[row] = along[row] / (length * length) if left[row] > 0.0 else 0.0
        squares[:] = 0.0
        for c in range(n_columns):
            column, of_pivot = columns[c], columns[c, pivot]
            for row in range(n_rows):
                column[row] -= along[row] * of_pivot
                squares[row] += column[row] * column[row]
        for row in range(n_rows):
            left[row] = squares[row] if left[row] > 0.0 else 0.0
    return most


def is_flexible(positions: FloatArray, measured: NDArray[np.bool_]) -> bool:
    """
    Return whether the measured distances leave a placement free to move.

    The clock is looked at on the way (`look_after`).

    True when some distance is unknown and the rank of the rigidity matrix is lower than in general
    position: a motion exists, or exists to first order.
    """
    look_after(positions.size * int(np.count_nonzero(measured)))
    columns, n_rows, rigid_rank = _gradients(positions, measured)
    if n_rows < rigid_rank:
        return True
    columns = np.ascontiguousarray(columns[:, :n_rows])
    left, along, squares = np.ones(n_rows), np.empty(n_rows), np.empty(n_rows)
    rank, at_once = 0, 1 + WORK_PER_LOOK // max(1, columns.size)
    while rank < rigid_rank:
        some = min(at_once, rigid_rank - rank)
        look_after(some * columns.size)
        new = int(_count_some(columns, left, along, squares, some))
        rank += new
        if new < some:
            return True
    return False
