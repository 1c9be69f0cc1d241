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
def _rank(rows: FloatArray, most: int) -> int:
    """Return the numerical rank of unit rows, at most `most`; the rows are overwritten."""
    n_rows, n_columns = rows.shape
    left = np.ones(n_rows)
    for rank in range(most):
        pivot = 0
        for row in range(n_rows):
            if left[row] > left[pivot]:
                pivot = row
        if n_rows == 0 or left[pivot] <= RANK_TOLERANCE * RANK_TOLERANCE:
            return rank
        length = math.sqrt(left[pivot])
        left[pivot] = 0.0
        for row in range(n_rows):
            if left[row] == 0.0:
                continue
            along = 0.0
            for column in range(n_columns):
                along += rows[row, column] * rows[pivot, column]
            along /= length * length
            total = 0.0
            for column in range(n_columns):
                rows[row, column] -= along * rows[pivot, column]
                total += rows[row, column] * rows[row, column]
            left[row] = total
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
    rows = np.zeros((n_pairs, n_points * dimension))
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
                    rows[row, i * dimension + axis] = slope
                    rows[row, j * dimension + axis] = -slope
                row += 1
    return _rank(rows[:row], rigid_rank) < rigid_rank
