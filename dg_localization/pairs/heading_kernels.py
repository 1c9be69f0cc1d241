# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels of `headings`: which headings of two bodies their readings allow."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.pairs.cuts import W_SIZE
from dg_localization.pairs.half_spaces import HIGH, LOW, VIEW, YAW, X, Y, Z, with_error
from dg_localization.pairs.inversion import LEAST_CUT, cut_to, read_all

MOST_PASSES = 3
"""A cell is cut again while its box shrinks much, so many times at most."""


@kernel(borrows=True)
def turn_box(source: np.ndarray, angle: float, half_angle: float, target: np.ndarray) -> None:
    """
    Write the box around a box (2, 3) turned by an angle, known to `half_angle`, to `target`.

    A turn by t moves a point at distance d by at most t d, across it to first order.
    """
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y = (
        0.5 * source[LOW, X] + 0.5 * source[HIGH, X],
        0.5 * source[LOW, Y] + 0.5 * source[HIGH, Y],
    )
    half_x = max(up(source[HIGH, X] - x), up(x - source[LOW, X]))
    half_y = max(up(source[HIGH, Y] - y), up(y - source[LOW, Y]))
    turned_x, turned_y = cosine * x - sine * y, sine * x + cosine * y
    size = abs(x) + abs(y) + half_x + half_y
    around = half_angle * (half_x + half_y + 0.5 * half_angle * size)
    width_x = abs(cosine) * half_x + abs(sine) * half_y + half_angle * abs(turned_y) + around
    width_y = abs(sine) * half_x + abs(cosine) * half_y + half_angle * abs(turned_x) + around
    width_x, width_y = with_error(width_x, size), with_error(width_y, size)
    target[LOW, X], target[HIGH, X] = down(turned_x - width_x), up(turned_x + width_x)
    target[LOW, Y], target[HIGH, Y] = down(turned_y - width_y), up(turned_y + width_y)
    target[LOW, Z], target[HIGH, Z] = source[LOW, Z], source[HIGH, Z]


@kernel(borrows=True)
def _cut_pose(
    box: np.ndarray,
    table: np.ndarray,
    listed: np.ndarray,
    undecided: np.ndarray,
    max_outliers: int,
    work: tuple,
) -> bool:
    """Cut a box of poses (2, 4) by all readings; return whether anything is left."""
    count = listed.shape[0]
    left = listed
    for _passes in range(MOST_PASSES):
        # What allows all of a box allows all of its parts.
        count, ruled_out = read_all(box, table, left, undecided, count, max_outliers, work)
        if ruled_out > max_outliers:
            return False
        if max_outliers == 0:
            left = undecided[:count]
        share = cut_to(box, work[4], max_outliers - ruled_out)
        if share == 0.0:
            return False
        if share >= LEAST_CUT:
            return True
    return True


@kernel(borrows=True)
def _widen(hull: np.ndarray, first: np.ndarray, second: np.ndarray) -> bool:
    """Widen a hull (2, 3) by what two boxes have in common; return whether that is anything."""
    for axis in range(3):
        if max(first[LOW, axis], second[LOW, axis]) > min(first[HIGH, axis], second[HIGH, axis]):
            return False
    for axis in range(3):
        low = max(first[LOW, axis], second[LOW, axis])
        high = min(first[HIGH, axis], second[HIGH, axis])
        hull[LOW, axis] = min(hull[LOW, axis], low)
        hull[HIGH, axis] = max(hull[HIGH, axis], high)
    return True


@kernel(borrows=True)
def _is_inside(allowed: np.ndarray, a: int, b: int) -> bool:
    """Return whether all pairs of headings next to one are left."""
    count = allowed.shape[0]
    for da in range(-1, 2):
        for db in range(-1, 2):
            if not allowed[(a + da) % count, (b + db) % count]:
                return False
    return True


@kernel(borrows=True)
def _may_widen(hull: np.ndarray, first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether what two boxes have in common reaches beyond a hull (2, 3)."""
    for axis in range(3):
        if max(first[LOW, axis], second[LOW, axis]) < hull[LOW, axis]:
            return True
        if min(first[HIGH, axis], second[HIGH, axis]) > hull[HIGH, axis]:
            return True
    return False


@kernel
def try_cells(
    allowed: np.ndarray,
    ways: np.ndarray,
    between: np.ndarray,
    table: np.ndarray,
    max_outliers: int,
    half_cell: float,
    first: int,
    last: int,
    hull: np.ndarray,
) -> None:
    """
    Drop the pairs of headings that the readings of two bodies rule out.

    Where `ways` are those of coarser cells, pairs inside of what is left are tried only while they
    may widen the hull: few of them are ruled out, and none is at the end of an arc.

    Parameters
    ----------
    allowed : numpy.ndarray of bool, shape (n, n)
        By the cell of the heading of A, and of B. Receives false where a pair is ruled out.
    ways : numpy.ndarray, shape (l, l, 2, 3)
        Bounds of the way from A to B by pairs of headings, of these cells (l = n) or of cells that
        were halved since. Those of these cells are received.
    between : numpy.ndarray, shape (2, 3)
        Bounds of the way from A to B, in m, in the frame of the headings.
    table : numpy.ndarray, shape (m, COLUMNS)
    max_outliers : int
    half_cell : float
        Half the width of a cell, in rad, rounded up.
    first, last : int
        Cells of A to try.
    hull : numpy.ndarray, shape (2, 3)
        Widened by the way from A to B of every pair of headings that is left.

    """
    count, halved = allowed.shape[0], allowed.shape[0] // ways.shape[0]
    listed = np.arange(table.shape[0])
    undecided = np.empty(table.shape[0], np.int64)
    box, pose, back = np.empty((2, 4)), np.empty((2, 3)), np.empty((2, 3))
    work = (
        np.empty(VIEW),
        np.empty((2, 4)),
        np.empty(4),
        np.empty(W_SIZE),
        np.empty((2, 4, max_outliers + 1)),
    )
    cell = 2.0 * math.pi / count
    for a in range(first, last):
        heading = (a + 0.5) * cell
        turn_box(between, -heading, half_cell, pose)
        for b in range(count):
            if not allowed[a, b]:
                continue
            way = ways[a // halved, b // halved]
            if halved > 1 and _is_inside(allowed, a, b) and not _may_widen(hull, way, between):
                continue
            yaw = (b - a) * cell
            box[LOW, :YAW], box[HIGH, :YAW] = pose[LOW], pose[HIGH]
            box[LOW, YAW] = down(yaw - up(2.0 * half_cell))
            box[HIGH, YAW] = up(yaw + up(2.0 * half_cell))
            allowed[a, b] = _cut_pose(box, table, listed, undecided, max_outliers, work)
            if allowed[a, b]:
                turn_box(box[:, :YAW], heading, half_cell, back)
                allowed[a, b] = _widen(hull, back, between)
                if halved == 1:
                    way[:] = back
