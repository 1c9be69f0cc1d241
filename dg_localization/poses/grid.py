# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The common parts of the boxes of a cover and the cells of a grid: kernels."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.poses.half_spaces import HIGH, LOW, YAW, X, Y, Z


@kernel(borrows=True)
def _first_and_last(
    box: np.ndarray, low: np.ndarray, high: np.ndarray, axis: int, count: int
) -> tuple[int, int]:
    """Return the first and the last cell along an axis that may have a point of the box."""
    width = high[axis] - low[axis]
    if not width > 0.0:
        return 0, count - 1
    first = math.floor(count * ((box[LOW, axis] - low[axis]) / width)) - 1
    last = math.floor(count * ((box[HIGH, axis] - low[axis]) / width)) + 1
    return max(0, first), min(count - 1, last)


@kernel(borrows=True)
def _add(
    cell: np.ndarray, box: np.ndarray, edges: np.ndarray, place: tuple[int, int, int, int]
) -> None:
    """Widen the hull of a cell by its intersection with a box."""
    for axis in range(4):
        at = place[axis]
        if box[LOW, axis] > edges[axis, at + 1] or box[HIGH, axis] < edges[axis, at]:
            return
    for axis in range(4):
        at = place[axis]
        cell[LOW, axis] = min(cell[LOW, axis], max(box[LOW, axis], edges[axis, at]))
        cell[HIGH, axis] = max(cell[HIGH, axis], min(box[HIGH, axis], edges[axis, at + 1]))


@kernel(borrows=True)
def _add_all(
    cells: np.ndarray,
    boxes: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    shape: np.ndarray,
    edges: np.ndarray,
) -> None:
    """Widen the hulls of all cells by their intersections with the boxes."""
    for number in range(boxes.shape[0]):
        box = boxes[number]
        x, last_x = _first_and_last(box, low, high, X, shape[X])
        first_y, last_y = _first_and_last(box, low, high, Y, shape[Y])
        first_z, last_z = _first_and_last(box, low, high, Z, shape[Z])
        first_yaw, last_yaw = _first_and_last(box, low, high, YAW, shape[YAW])
        for i in range(x, last_x + 1):
            for j in range(first_y, last_y + 1):
                for k in range(first_z, last_z + 1):
                    for m in range(first_yaw, last_yaw + 1):
                        cell = ((i * shape[Y] + j) * shape[Z] + k) * shape[YAW] + m
                        _add(cells[cell], box, edges, (i, j, k, m))


def fill_cells(
    boxes: np.ndarray, low: np.ndarray, high: np.ndarray, shape: np.ndarray
) -> np.ndarray:
    """
    Return the hull of the points of boxes in each cell that has any.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (n, 2, 4)
    low, high : numpy.ndarray, shape (4,)
        Bounds of all boxes.
    shape : numpy.ndarray of int, shape (4,)
        The number of cells along each axis.

    Returns
    -------
    numpy.ndarray, shape (k, 2, 4)

    """
    cells = np.empty((int(np.prod(shape)), 2, 4))
    cells[:, LOW], cells[:, HIGH] = math.inf, -math.inf
    edges = np.empty((4, int(shape.max()) + 1))
    for axis, count in enumerate(shape):
        edges[axis, : count + 1] = np.linspace(low[axis], high[axis], count + 1)
        edges[axis, count] = high[axis]
    _add_all(cells, boxes, low, high, shape, edges)
    return cells[cells[:, LOW, X] <= cells[:, HIGH, X]]
