# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `counted`: cells of poses, by how many readings these may have broken."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.pairs.cuts import W_SIZE
from dg_localization.pairs.half_spaces import (
    COSINE,
    HALF,
    HIGH,
    LOW,
    SINE,
    VIEW,
    YAW,
    X,
    Y,
    Z,
    view_box,
    with_error,
)
from dg_localization.pairs.inversion import cut_to, read_all

# A grid: the lower end of its yaws, its sides, how many cells there are along each axis.
START_RAD, SIDE_M, SIDE_RAD, ALONG_X, ALONG_Y, SLICES = 0, 1, 2, 3, 4, 5
GRID = 6


@kernel(borrows=True)
def _widen(hull: np.ndarray, box: np.ndarray) -> None:
    """Widen a hull (2, 4) by a box."""
    for axis in range(4):
        hull[LOW, axis] = min(hull[LOW, axis], box[LOW, axis])
        hull[HIGH, axis] = max(hull[HIGH, axis], box[HIGH, axis])


@kernel(borrows=True)
def _clear(levels: np.ndarray) -> None:
    """Make all levels (k + 1, 2, 4) empty."""
    for level in range(levels.shape[0]):
        for axis in range(4):
            levels[level, LOW, axis], levels[level, HIGH, axis] = math.inf, -math.inf


@kernel(borrows=True)
def _nest(levels: np.ndarray) -> None:
    """Widen each level by the one before: who broke fewer readings broke no more than these."""
    for level in range(1, levels.shape[0]):
        _widen(levels[level], levels[level - 1])


@kernel(borrows=True)
def _is_new(levels: np.ndarray, level: int) -> bool:
    """Return whether a level holds anything that the one before does not."""
    box = levels[level]
    if box[LOW, X] > box[HIGH, X]:
        return False
    if level == 0:
        return True
    for axis in range(4):
        for end in range(2):
            if box[end, axis] != levels[level - 1, end, axis]:
                return True
    return False


@kernel(borrows=True)
def _cut_level(
    left: np.ndarray,
    box: np.ndarray,
    level: int,
    ruled_out: int,
    tops: np.ndarray,
    part: np.ndarray,
) -> None:
    """Add what is left of a level to all levels, which break one reading more each."""
    for broken in range(ruled_out, left.shape[0] - level):
        for axis in range(4):
            part[LOW, axis], part[HIGH, axis] = box[LOW, axis], box[HIGH, axis]
        if cut_to(part, tops, broken - ruled_out) > 0.0:
            _widen(left[level + broken], part)


@kernel
def cut_cells(cells: np.ndarray, table: np.ndarray, kept: np.ndarray) -> int:
    """
    Cut the levels of cells by readings, each of which may be broken at the cost of a level.

    What a reading allows all over the last level it allows in the others, which are parts of it,
    and what rules out all of it rules out these.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, k + 1, 2, 4)
        Level j holds the poses of the cell that broke j readings at most.
    table : numpy.ndarray, shape (m, COLUMNS)
    kept : numpy.ndarray, shape (n, k + 1, 2, 4)
        Receives the cells that are left.

    Returns
    -------
    int
        Their number.

    """
    levels, most = cells.shape[1], table.shape[0]
    view, faces, smear, w = np.empty(VIEW), np.empty((2, 4)), np.empty(4), np.empty(W_SIZE)
    tops, part = np.empty((2, 4, levels)), np.empty((2, 4))
    work = (view, faces, smear, w, tops)
    listed, undecided, rest = np.arange(most), np.empty(most, np.int64), np.empty(most, np.int64)
    count = 0
    for number in range(cells.shape[0]):
        cell, left = cells[number], kept[count]
        _clear(left)
        last = levels - 1
        while last > 0 and not _is_new(cell, last):
            last -= 1
        known, ruled_out = read_all(cell[last], table, listed, undecided, most, levels - 1, work)
        _cut_level(left, cell[last], last, ruled_out, tops, part)
        for level in range(last):
            spare = levels - 1 - level - ruled_out
            if spare >= 0 and _is_new(cell, level):
                more = read_all(cell[level], table, undecided[:known], rest, known, spare, work)[1]
                _cut_level(left, cell[level], level, ruled_out + more, tops, part)
        _nest(left)
        if left[levels - 1, LOW, X] <= left[levels - 1, HIGH, X]:
            count += 1
    return count


@kernel(borrows=True)
def move_box(
    box: np.ndarray, step: np.ndarray, ball: float, view: np.ndarray, moved: np.ndarray
) -> None:
    """
    Move a box of poses by a step in their own frames.

    Parameters
    ----------
    box : numpy.ndarray, shape (2, 4)
    step : numpy.ndarray, shape (2, 4)
        Middles and half-widths of what the step adds to x, y, z and yaw.
    ball : float
        How far it may lead from that in the plane, in any direction: a ball does not grow when it
        is turned, as a box does.
    view : numpy.ndarray, shape (VIEW,)
        Room to work in.
    moved : numpy.ndarray, shape (2, 4)
        Receives the box around all poses after the step.

    """
    view_box(box, view)
    c, s, half_yaw = view[COSINE], view[SINE], view[HALF + YAW]
    dx, dy, dz = step[0, X], step[0, Y], step[0, Z]
    x, y = c * dx - s * dy, s * dx + c * dy
    length = abs(dx) + abs(dy)
    # The turn of the step about the middle of the box, to second order.
    beyond = 0.5 * half_yaw * half_yaw * length
    wide = step[1, X] + step[1, Y]
    half_x = abs(c) * step[1, X] + abs(s) * step[1, Y] + ball
    half_y = abs(s) * step[1, X] + abs(c) * step[1, Y] + ball
    if half_yaw > 0.0:
        swing = min(half_yaw, 2.0) * wide
        half_x += abs(y) * half_yaw + beyond + swing
        half_y += abs(x) * half_yaw + beyond + swing
    size = length + wide + ball + abs(dz) + step[1, Z]
    for axis in range(4):
        middle, half = dz, step[1, Z]
        if axis == X:
            middle, half = x, half_x
        elif axis == Y:
            middle, half = y, half_y
        elif axis == YAW:
            middle, half = step[0, YAW], step[1, YAW]
        if middle == half == 0.0 and axis == Z:
            # In the plane heights stay what they are: cuts are simpler there.
            moved[LOW, Z], moved[HIGH, Z] = box[LOW, Z], box[HIGH, Z]
            continue
        magnitude = size + half + abs(middle) + abs(box[LOW, axis]) + abs(box[HIGH, axis])
        moved[LOW, axis] = -with_error(half - middle - box[LOW, axis], magnitude)
        moved[HIGH, axis] = with_error(half + middle + box[HIGH, axis], magnitude)


@kernel(borrows=True)
def _edge(start: float, side: float, number: int, count: int) -> float:
    """Return an edge of the cells along an axis; nothing is beyond the outer ones."""
    if number <= 0:
        return -math.inf
    return math.inf if number >= count else start + side * number


@kernel(borrows=True)
def _place(value: float, start: float, side: float, count: int) -> int:
    """Return about which cell along an axis a number is in."""
    place = (value - start) / side
    return int(max(0.0, min(float(count - 1), math.floor(place))))


@kernel(borrows=True)
def _clip(
    box: np.ndarray,
    axis: int,
    start: float,
    side: float,
    number: int,
    count: int,
    part: np.ndarray,
) -> bool:
    """Write what a box has of a cell along an axis; return whether that is anything."""
    part[LOW, axis] = max(box[LOW, axis], _edge(start, side, number, count))
    part[HIGH, axis] = min(box[HIGH, axis], _edge(start, side, number + 1, count))
    return not part[LOW, axis] > part[HIGH, axis]


@kernel(borrows=True)
def _add_to_slice(
    box: np.ndarray,
    level: int,
    number: int,
    grid: np.ndarray,
    starts: np.ndarray,
    slots: np.ndarray,
    part: np.ndarray,
    cells: np.ndarray,
    count: int,
) -> int:
    """Add what a box has of a slice of yaws to the cells of this; return how many there are."""
    side, n_x, n_y = grid[SIDE_M], int(grid[ALONG_X]), int(grid[ALONG_Y])
    start_x, start_y = starts[number, X], starts[number, Y]
    first_x = max(0, _place(box[LOW, X], start_x, side, n_x) - 1)
    last_x = min(n_x - 1, _place(box[HIGH, X], start_x, side, n_x) + 1)
    first_y = max(0, _place(box[LOW, Y], start_y, side, n_y) - 1)
    last_y = min(n_y - 1, _place(box[HIGH, Y], start_y, side, n_y) + 1)
    for i in range(first_x, last_x + 1):
        if not _clip(box, X, start_x, side, i, n_x, part):
            continue
        for j in range(first_y, last_y + 1):
            if not _clip(box, Y, start_y, side, j, n_y, part):
                continue
            place = (number * n_x + i) * n_y + j
            if slots[place] < 0:
                if count == cells.shape[0]:
                    return count + 1
                slots[place] = count
                _clear(cells[count])
                count += 1
            _widen(cells[slots[place], level], part)
    return count


@kernel
def move_cells(cells: np.ndarray, step: np.ndarray, ball: float, moved: np.ndarray) -> None:
    """
    Move cells, level by level.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, k + 1, 2, 4)
    step, ball
        As for `move_box`.
    moved : numpy.ndarray, shape (n, k + 1, 2, 4)
        Receives the cells after the step.

    """
    view = np.empty(VIEW)
    for number in range(cells.shape[0]):
        levels = moved[number]
        _clear(levels)
        for level in range(cells.shape[1]):
            if _is_new(cells[number], level):
                move_box(cells[number, level], step, ball, view, levels[level])
        _nest(levels)


@kernel
def gather_cells(
    cells: np.ndarray,
    grid: np.ndarray,
    starts: np.ndarray,
    slots: np.ndarray,
    gathered: np.ndarray,
) -> int:
    """
    Gather cells in those of a grid, level by level.

    Parameters
    ----------
    cells : numpy.ndarray, shape (n, k + 1, 2, 4)
    grid : numpy.ndarray, shape (GRID,)
    starts : numpy.ndarray, shape (slices, 2)
        Of each slice of yaws, where its cells begin.
    slots : numpy.ndarray of int, shape (slices * cells along x * cells along y,)
        -1 everywhere; receives where each cell is.
    gathered : numpy.ndarray, shape (m, k + 1, 2, 4)
        Receives the cells of the grid that have anything.

    Returns
    -------
    int
        Their number; m + 1 where there are more than `gathered` has room for.

    """
    part = np.empty((2, 4))
    start, side, slices = grid[START_RAD], grid[SIDE_RAD], int(grid[SLICES])
    count = 0
    for number in range(cells.shape[0]):
        for level in range(cells.shape[1]):
            if not _is_new(cells[number], level):
                continue
            box = cells[number, level]
            part[LOW, Z], part[HIGH, Z] = box[LOW, Z], box[HIGH, Z]
            first = max(0, _place(box[LOW, YAW], start, side, slices) - 1)
            last = min(slices - 1, _place(box[HIGH, YAW], start, side, slices) + 1)
            for m in range(first, last + 1):
                if not _clip(box, YAW, start, side, m, slices, part):
                    continue
                count = _add_to_slice(box, level, m, grid, starts, slots, part, gathered, count)
                if count > gathered.shape[0]:
                    return count
    for number in range(count):
        _nest(gathered[number])
    return count
