# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `mutual`: cells of directions, gathered in those of a grid."""

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
    LOW_A,
    LOW_B,
    NEAR,
    OPERATIONS,
    REF_A,
    REF_B,
    close_cell,
    least_over_box,
)
from dg_localization.pairs.mutual_steps import NO_ROOM

OVERLAP_RAD = 1e-12
"""Cells of a grid overlap by this, so that nothing falls between them."""

ON_EDGE = 1e-9
"""In cells: what is so near to an edge is on both sides."""

LEAST_WEIGHT = 1e-9
"""In cells: what has no area has a slope, too."""

SUMS = 5
"""For each cell: the sum of weights, and of the four slopes by weight."""


@kernel(borrows=True)
def _part_of(cell: np.ndarray, i: int, j: int, side: float, part: np.ndarray) -> bool:
    """Write what a cell has of a cell of the grid; return whether that is anything."""
    off_a, off_b = cell[REF_A] - (i + 0.5) * side, cell[REF_B] - (j + 0.5) * side
    half = 0.5 * side + OVERLAP_RAD
    rounded = rounding_error(LARGEST_RAD, OPERATIONS)
    part[LOW_A] = max(cell[LOW_A] + off_a - rounded, -half)
    part[HIGH_A] = min(cell[HIGH_A] + off_a + rounded, half)
    part[LOW_B] = max(cell[LOW_B] + off_b - rounded, -half)
    part[HIGH_B] = min(cell[HIGH_B] + off_b + rounded, half)
    if part[LOW_A] > part[HIGH_A] or part[LOW_B] > part[HIGH_B]:
        return False
    part[NEAR], part[FAR] = cell[NEAR], cell[FAR]
    for plane in (BELOW, ABOVE):
        by_x, by_y = cell[plane + 1], cell[plane + 2]
        steep = abs(by_x) + abs(by_y)
        slack = rounding_error(abs(cell[plane]) + LARGEST_RAD * steep, OPERATIONS)
        value = cell[plane] - by_x * off_a - by_y * off_b
        part[plane] = value - slack if plane == BELOW else value + slack
        part[plane + 1], part[plane + 2] = by_x, by_y
    return close_cell(part)


@kernel(borrows=True)
def _begin(cell: np.ndarray, i: int, j: int, side: float, sums: np.ndarray) -> None:
    """Make a cell of the grid that has nothing yet."""
    cell[REF_A], cell[REF_B] = (i + 0.5) * side, (j + 0.5) * side
    for low, high in ((LOW_A, HIGH_A), (LOW_B, HIGH_B), (NEAR, FAR), (BELOW, ABOVE)):
        cell[low], cell[high] = math.inf, -math.inf
    for column in range(SUMS):
        sums[column] = 0.0


@kernel(borrows=True)
def _widen(cell: np.ndarray, part: np.ndarray, area: float, sums: np.ndarray) -> None:
    """Widen the box of a cell by that of a part, and count the slopes of its planes."""
    for low, high in ((LOW_A, HIGH_A), (LOW_B, HIGH_B), (NEAR, FAR)):
        cell[low] = min(cell[low], part[low])
        cell[high] = max(cell[high], part[high])
    weight = (part[HIGH_A] - part[LOW_A]) * (part[HIGH_B] - part[LOW_B]) + LEAST_WEIGHT * area
    sums[0] += weight
    for axis in range(2):
        sums[1 + axis] += weight * part[BELOW + 1 + axis]
        sums[3 + axis] += weight * part[ABOVE + 1 + axis]


@kernel(borrows=True)
def _slope(cell: np.ndarray, sums: np.ndarray) -> None:
    """Give the planes of a cell the mean slopes of its parts: any would do."""
    for axis in range(2):
        cell[BELOW + 1 + axis] = sums[1 + axis] / sums[0]
        cell[ABOVE + 1 + axis] = sums[3 + axis] / sums[0]


@kernel(borrows=True)
def _spread_planes(cell: np.ndarray, part: np.ndarray) -> None:
    """Move the planes of a cell to where those of a part are between them."""
    size = abs(part[BELOW]) + abs(part[ABOVE])
    for axis in range(1, 3):
        size += abs(part[BELOW + axis]) + abs(part[ABOVE + axis])
        size += abs(cell[BELOW + axis]) + abs(cell[ABOVE + axis])
    slack = rounding_error(size, OPERATIONS)
    below = least_over_box(
        part,
        part[BELOW],
        part[BELOW + 1] - cell[BELOW + 1],
        part[BELOW + 2] - cell[BELOW + 2],
    )
    above = least_over_box(
        part,
        -part[ABOVE],
        cell[ABOVE + 1] - part[ABOVE + 1],
        cell[ABOVE + 2] - part[ABOVE + 2],
    )
    cell[BELOW] = min(cell[BELOW], below - slack)
    cell[ABOVE] = max(cell[ABOVE], slack - above)


@kernel
def gather_directions(
    cells: np.ndarray, n: int, slots: np.ndarray, sums: np.ndarray, gathered: np.ndarray
) -> int:
    """
    Gather cells in those of a grid over both directions.

    Parameters
    ----------
    cells : numpy.ndarray, shape (m, CELL)
    n : int
        Cells of the full turn.
    slots : numpy.ndarray of int, shape (n * n,)
        -1 everywhere; receives where each cell is.
    sums : numpy.ndarray, shape (k, SUMS)
        Room to work in.
    gathered : numpy.ndarray, shape (k, CELL)
        Receives the cells of the grid that have anything.

    Returns
    -------
    int
        Their number; `NO_ROOM` where there are more.

    """
    side = 2.0 * math.pi / n
    part = np.empty(CELL)
    count = 0
    for again in range(2):
        for number in range(cells.shape[0]):
            cell = cells[number]
            first_i = int(math.floor((cell[REF_A] + cell[LOW_A]) / side - ON_EDGE))
            last_i = int(math.floor((cell[REF_A] + cell[HIGH_A]) / side + ON_EDGE))
            first_j = int(math.floor((cell[REF_B] + cell[LOW_B]) / side - ON_EDGE))
            last_j = int(math.floor((cell[REF_B] + cell[HIGH_B]) / side + ON_EDGE))
            for i in range(first_i, last_i + 1):
                for j in range(first_j, last_j + 1):
                    if not _part_of(cell, i, j, side, part):
                        continue
                    place = (i % n) * n + j % n
                    if again:
                        _spread_planes(gathered[slots[place]], part)
                        continue
                    if slots[place] < 0:
                        if count == gathered.shape[0]:
                            return NO_ROOM
                        slots[place] = count
                        _begin(gathered[count], i % n, j % n, side, sums[count])
                        count += 1
                    _widen(gathered[slots[place]], part, side * side, sums[slots[place]])
        if not again:
            for number in range(count):
                _slope(gathered[number], sums[number])
    return count
