# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `mutual`: cells of directions, carried on, and halved where they are too large."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import rounding_error
from dg_localization.pairs.mutual_kernels import (
    ABOVE,
    BELOW,
    CELL,
    FAR,
    HIGH_A,
    HIGH_B,
    LARGEST_RAD,
    LEFT,
    LOOK,
    LOW_A,
    LOW_B,
    NEAR,
    OPERATIONS,
    REF_A,
    TOO_LARGE,
    WAY_A,
    WAY_B,
    distances_after,
    move_cell,
    read_cell,
    size_of,
)

NO_ROOM = -1
"""There are more cells than fit."""

DEPTH = 24
"""So often a cell is halved at most."""

MOST_LOOKS = 6
"""So many times as many looks as there are cells, and some."""


@kernel(borrows=True)
def _shift(cell: np.ndarray, axis: int, off_rad: float) -> None:
    """Count an angle of a cell from a middle that is this much farther on."""
    low, high = (LOW_A, HIGH_A) if axis == 0 else (LOW_B, HIGH_B)
    cell[REF_A + axis] += off_rad
    rounded = rounding_error(LARGEST_RAD, OPERATIONS)
    cell[low] -= off_rad + rounded
    cell[high] -= off_rad - rounded
    slack = rounding_error(size_of(cell) * LARGEST_RAD, OPERATIONS)
    cell[BELOW] += cell[BELOW + 1 + axis] * off_rad - slack
    cell[ABOVE] += cell[ABOVE + 1 + axis] * off_rad + slack


@kernel(borrows=True)
def _halve(cell: np.ndarray, way: np.ndarray, other: np.ndarray) -> None:
    """Halve a cell along the axis that moves it most; the other half is written to `other`."""
    by_x = (cell[HIGH_A] - cell[LOW_A]) * math.hypot(way[WAY_A], way[WAY_A + 1])
    by_y = (cell[HIGH_B] - cell[LOW_B]) * math.hypot(way[WAY_B], way[WAY_B + 1])
    low, high, axis = NEAR, FAR, -1
    if max(by_x, by_y) >= cell[FAR] - cell[NEAR]:
        low, high, axis = (LOW_A, HIGH_A, 0) if by_x >= by_y else (LOW_B, HIGH_B, 1)
    middle = 0.5 * (cell[low] + cell[high])
    for column in range(CELL):
        other[column] = cell[column]
    cell[high] = other[low] = middle
    if axis >= 0:
        _shift(cell, axis, 0.5 * (cell[low] + cell[high]))
        _shift(other, axis, 0.5 * (other[low] + other[high]))


@kernel
def carry_cells(
    cells: np.ndarray,
    way: np.ndarray,
    readings: np.ndarray,
    near: float,
    far: float,
    carried: np.ndarray,
) -> int:
    """
    Carry cells on by a way, and cut them by readings on it.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, CELL)
    way : numpy.ndarray, shape (WAY,)
    readings : numpy.ndarray, shape (m, WAY)
        Their ways lead from where the bodies are after `way` back to where they were.
    near, far : float
        Bounds of the distance after `way`.
    carried : numpy.ndarray, shape (k, CELL)
        Receives the cells that are left.

    Returns
    -------
    int
        Their number; `NO_ROOM` where there are more, or where they cannot be made small enough.

    """
    look, stack = np.empty(LOOK), np.empty((DEPTH, CELL))
    count, looks, most = 0, 0, MOST_LOOKS * (cells.shape[0] + DEPTH)
    for number in range(cells.shape[0]):
        stack[0] = cells[number]
        waiting = 1
        while waiting > 0:
            waiting, looks = waiting - 1, looks + 1
            cell = stack[waiting]
            nearest, farthest = distances_after(cell, way)
            if nearest > far or farthest < near:
                continue
            if count == carried.shape[0] or looks > most:
                return NO_ROOM
            left = move_cell(cell, way, near, far, look, carried[count])
            if left == TOO_LARGE:
                if waiting + 2 > DEPTH:
                    return NO_ROOM
                _halve(cell, way, stack[waiting + 1])
                waiting += 2
            elif left == LEFT:
                kept = True
                for reading in range(readings.shape[0]):
                    kept = kept and read_cell(carried[count], readings[reading], look)
                count += kept
    return count
