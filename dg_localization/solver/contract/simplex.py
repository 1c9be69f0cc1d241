# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers for bounds of linear functions: the linear program, by the dual simplex method.

A linear function of the displacements is to be bounded where every measured pair bounds its own
gradient. All functions are rows of one table, which writes them in terms of as many *active* pairs
as there are unknowns; a row then holds multipliers. Active pairs are bounded on both sides, so any
choice of them is dual feasible: there is no first phase, each exchange improves the bound, and the
method may stop after any of them. Nothing here is rounded outward, because any
multipliers give a bound (`linearization`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.linearization import Linearization
from dg_localization.solver.contract.reference import SMALLEST_WIDTH

MOST_EXCHANGES = 60

TOLERANCE = 1e-6
"""A pair violates its bounds when it leaves them by more than this fraction of their width."""

LEAST_VIOLATION = 1e-13
"""And by more than this fraction of the widest: exact pairs have rounding errors only."""

LEAST_ENTRY = 1e-7
"""An entry below this fraction of the largest in its row is no pivot."""

PERTURBATION = 1e-5
"""Of a row, relatively, while it is improved: many of its entries are zero, and ties may cycle."""

GOLDEN = 0.6180339887


@kernel(borrows=True)
def _exchange(table: FloatArray, active: IntArray, row: int, column: int) -> None:
    """Make the pair of a row active in place of the one of a column."""
    n_rows, n_columns = table.shape
    pivot = table[row, column]
    for x in range(n_rows):
        if x == row:
            continue
        factor = table[x, column] / pivot
        if factor != 0.0:
            for c in range(n_columns):
                table[x, c] -= factor * table[row, c]
        table[x, column] = factor
    for c in range(n_columns):
        table[row, c] = 0.0
    table[row, column] = 1.0
    active[column] = row


@kernel
def set_table(linear: Linearization, table: FloatArray, active: IntArray) -> bool:
    """
    Write the table of the measured pairs, with well-known pairs active.

    Parameters
    ----------
    linear : Linearization
        The measured pairs.
    table : ndarray, shape (m + f + 2, f)
        The table: rows of the pairs, of the unknown displacements, and two to work in.
    active : ndarray of int, shape (f,)
        The active pairs.

    Returns
    -------
    bool
        False when the pairs do not determine the displacements.

    """
    reference, edges, unknowns = linear.reference, linear.edges, linear.unknowns
    residuals = linear.residuals
    n_edges, n_free = len(edges), len(active)
    table[:] = 0.0
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(reference.shape[1]):
            slope = 2.0 * (reference[i, axis] - reference[j, axis])
            if unknowns[i, axis] >= 0:
                table[m, unknowns[i, axis]] += slope
            if unknowns[j, axis] >= 0:
                table[m, unknowns[j, axis]] -= slope
    for c in range(n_free):
        table[n_edges + c, c] = 1.0
    largest = np.abs(table[:n_edges]).max()
    is_pair = np.zeros(n_free, dtype=np.bool_)
    for _ in range(n_free):
        best, row, column = 0.0, -1, -1
        for m in range(n_edges):
            width = residuals[m, UPPER] - residuals[m, LOWER] + SMALLEST_WIDTH * largest * largest
            for c in range(n_free):
                if not is_pair[c] and abs(table[m, c]) > best * width:
                    best, row, column = abs(table[m, c]) / width, m, c
        if row < 0 or abs(table[row, column]) < LEAST_ENTRY * largest:
            return False
        _exchange(table, active, row, column)
        is_pair[column] = True
    return True


@kernel
def _entering_column(
    table: FloatArray, active: IntArray, residuals: FloatArray, row: int, side: float, slope: float
) -> int:
    """
    Return which column to exchange for a violated row: where the bound is lowest along its line.

    The bound is convex and piecewise linear along the line; `slope` is its first slope, and each
    entry of the last row that changes its sign makes it steeper.
    """
    n_rows, n_columns = table.shape
    largest = np.abs(table[row]).max()
    used = np.zeros(n_columns, dtype=np.bool_)
    column = -1
    while slope < 0.0:
        nearest, next_column = math.inf, -1
        for c in range(n_columns):
            entry = side * table[row, c]
            if used[c] or abs(entry) < LEAST_ENTRY * largest:
                continue
            ratio = table[n_rows - 1, c] / entry
            if (ratio > 0.0 or (ratio == 0.0 and entry < 0.0)) and ratio < nearest:
                nearest, next_column = ratio, c
        if next_column < 0:
            return -1
        column = next_column
        used[column] = True
        pair = active[column]
        slope += abs(table[row, column]) * (residuals[pair, UPPER] - residuals[pair, LOWER])
    return column


@kernel(borrows=True)
def _leaving_row(
    table: FloatArray,
    is_active: NDArray[np.bool_],
    residuals: FloatArray,
    vertex: FloatArray,
    widths: FloatArray,
    widest: float,
) -> tuple[int, float, float]:
    """
    Return the pair that is violated most, on which side (1 or -1) and by how much; -1: none is.

    Violations are compared in units of the step that mends them, with multipliers measured by
    the widths of their pairs (dual steepest edge). That takes a quarter fewer exchanges than the
    largest violation does. `widths` are those of the active pairs, over the `widest` of all.
    """
    n_columns = table.shape[1]
    row, side, violation, best = -1, 0.0, 0.0, 0.0
    for m in range(len(residuals)):
        if is_active[m]:
            continue
        value = 0.0
        width = residuals[m, UPPER] - residuals[m, LOWER]
        own = width / widest
        edge = own * own
        for c in range(n_columns):
            value += table[m, c] * vertex[c]
            along = table[m, c] * widths[c]
            edge += along * along
        excess = max(value - residuals[m, UPPER], residuals[m, LOWER] - value)
        least = max(TOLERANCE * width, LEAST_VIOLATION * widest)
        if edge > 0.0 and excess > max(least, best * math.sqrt(edge)):
            row, violation, best = m, excess, excess / math.sqrt(edge)
            side = 1.0 if value > residuals[m, UPPER] else -1.0
    return row, side, violation


@kernel
def set_multipliers(
    table: FloatArray, active: IntArray, residuals: FloatArray, multipliers: FloatArray
) -> None:
    """
    Write the multipliers that bound the function in the last row but one from above.

    Parameters
    ----------
    table, active
        As `set_table` wrote them, and the function in the last row but one.
    residuals : ndarray, shape (m, 2)
        Bounds of the gradients in m^2.
    multipliers : ndarray, shape (m,)
        Where they are written.

    """
    n_rows, n_columns = table.shape
    n_edges = len(residuals)
    function, work = n_rows - 2, n_rows - 1
    scale = np.abs(table[function]).max()
    for c in range(n_columns):
        table[work, c] = table[function, c] + PERTURBATION * scale * ((c * GOLDEN) % 1.0 - 0.5)
    is_active = np.zeros(n_edges, dtype=np.bool_)
    for c in range(n_columns):
        is_active[active[c]] = True
    vertex, widths = np.empty(n_columns), np.empty(n_columns)
    widest = (residuals[:, UPPER] - residuals[:, LOWER]).max()
    if widest == 0.0:
        widest = 1.0
    for _ in range(MOST_EXCHANGES):
        for c in range(n_columns):
            pair = active[c]
            vertex[c] = residuals[pair, UPPER if table[work, c] > 0.0 else LOWER]
            widths[c] = (residuals[pair, UPPER] - residuals[pair, LOWER]) / widest
        row, side, violation = _leaving_row(table, is_active, residuals, vertex, widths, widest)
        if row < 0:
            break
        column = _entering_column(table, active, residuals, row, side, -violation)
        if column < 0:
            break
        is_active[active[column]] = False
        is_active[row] = True
        _exchange(table, active, row, column)
    multipliers[:] = 0.0
    for c in range(n_columns):
        multipliers[active[c]] = table[function, c]
