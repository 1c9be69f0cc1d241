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

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray

RANK_TOLERANCE = 1e-6
"""A gradient of which less than this fraction is new does not count."""


@kernel
def _rank(columns: FloatArray, n_rows: int, most: int) -> int:
    """
    Return the numerical rank of unit rows, at most `most`; they are overwritten.

    They are given by columns, (q n, m): what is done to all rows is done to several at once.
    """
    n_columns = len(columns)
    left, along, squares = np.ones(n_rows), np.empty(n_rows), np.empty(n_rows)
    for rank in range(most):
        pivot = 0
        for row in range(n_rows):
            if left[row] > left[pivot]:
                pivot = row
        if n_rows == 0 or left[pivot] <= RANK_TOLERANCE * RANK_TOLERANCE:
            return rank
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


@kernel
def is_flexible(positions: FloatArray, measured: NDArray[np.bool_]) -> bool:
    """
    Return whether the measured distances leave a placement free to move.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        A placement in m.
    measured : ndarray of bool, shape (n, n)
        The pairs whose distance is bounded by a measurement.

    Returns
    -------
    bool
        True when some distance is unknown and the rank of the rigidity matrix is lower than in
        general position: a motion exists, or exists to first order.

    """
    n_points, dimension = positions.shape
    n_pairs = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if measured[i, j]:
                n_pairs += 1
    if n_pairs == n_points * (n_points - 1) // 2:
        return False
    span = min(n_points - 1, dimension)
    motions = dimension + span * (2 * dimension - span - 1) // 2
    rigid_rank = n_points * dimension - motions
    if n_pairs < rigid_rank:
        return True
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
    return _rank(columns, row, rigid_rank) < rigid_rank
