# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers for bounds of linear functions: the linear program, by the dual simplex method.

A linear function of the displacements is to be bounded where every measured pair bounds its own
gradient. The unknown displacements are rows of one table, which writes them in terms of as many
*active* pairs as there are unknowns; so is the function, whose row then holds multipliers, and the
rows of other pairs follow from those of their ends when they are asked for. Active pairs are
bounded on both sides, so any choice of them is dual feasible: there is no first phase, each
exchange improves the bound, and the method may stop after any of them. Nothing here is rounded
outward, because any multipliers give a bound (`linearization`). A pair may have several gradients,
each a measured pair of its own.
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

CANDIDATE = 0.6
"""Violations above this fraction of the largest are compared; the comparison costs most."""

LEAST_ENTRY = 1e-7
"""An entry below this fraction of the largest in its row is no pivot."""

PERTURBATION = 1e-5
"""Of a row, relatively, while it is improved: many of its entries are zero, and ties may cycle."""

GOLDEN = 0.6180339887


@kernel(borrows=True)
def _exchange(
    table: FloatArray, active: IntArray, entries: FloatArray, row: int, column: int
) -> None:
    """Make a pair, which has some entries, active in place of the one of a column."""
    n_rows, n_columns = table.shape
    pivot = entries[column]
    for x in range(n_rows):
        factor = table[x, column] / pivot
        if factor != 0.0:
            for c in range(n_columns):
                table[x, c] -= factor * entries[c]
        table[x, column] = factor
    active[column] = row


@kernel(borrows=True)
def _set_entries(linear: Linearization, table: FloatArray, m: int, entries: FloatArray) -> None:
    """Write the row of a pair, from those of its ends."""
    i, j = linear.edges[m, 0], linear.edges[m, 1]
    entries[:] = 0.0
    for axis in range(linear.gradients.shape[1]):
        slope = linear.gradients[m, axis]
        plus, minus = linear.unknowns[i, axis], linear.unknowns[j, axis]
        for c in range(len(entries)):
            if plus >= 0:
                entries[c] += slope * table[plus, c]
            if minus >= 0:
                entries[c] -= slope * table[minus, c]


@kernel
def set_table(linear: Linearization, table: FloatArray, active: IntArray) -> bool:
    """
    Write the table in terms of well-known measured pairs.

    Parameters
    ----------
    linear : Linearization
        The measured pairs.
    table : ndarray, shape (d + 2, f)
        Rows of the displacements that `linear` numbers, in terms of as many free ones as there
        are columns; and two to work in. It is written in terms of the active pairs.
    active : ndarray of int, shape (f,)
        Where the active pairs are written.

    Returns
    -------
    bool
        False when the pairs do not determine the displacements.

    """
    residuals = linear.residuals
    n_edges, n_free, n_displacements = len(linear.edges), len(active), len(table) - 2
    rows = np.empty((n_edges + n_displacements, n_free))
    rows[n_edges:] = table[:n_displacements]
    for m in range(n_edges):
        _set_entries(linear, table, m, rows[m])
    largest = np.abs(rows[:n_edges]).max()
    is_pair = np.zeros(n_free, dtype=np.bool_)
    for _ in range(n_free):
        best, row, column = 0.0, -1, -1
        for m in range(n_edges):
            width = residuals[m, UPPER] - residuals[m, LOWER] + SMALLEST_WIDTH * largest * largest
            for c in range(n_free):
                if not is_pair[c] and abs(rows[m, c]) > best * width:
                    best, row, column = abs(rows[m, c]) / width, m, c
        if row < 0 or abs(rows[row, column]) < LEAST_ENTRY * largest:
            return False
        _exchange(rows, active, rows[row].copy(), row, column)
        is_pair[column] = True
    table[:n_displacements] = rows[n_edges:]
    return True


@kernel
def _entering_column(
    table: FloatArray,
    active: IntArray,
    residuals: FloatArray,
    entries: FloatArray,
    side: float,
    slope: float,
) -> int:
    """
    Return which column to exchange for a violated pair: where the bound is lowest along its line.

    The bound is convex and piecewise linear along the line; `slope` is its first slope, and each
    entry of the last row that changes its sign makes it steeper.
    """
    n_rows, n_columns = table.shape
    largest = np.abs(entries).max()
    used = np.zeros(n_columns, dtype=np.bool_)
    column = -1
    while slope < 0.0:
        nearest, next_column = math.inf, -1
        for c in range(n_columns):
            entry = side * entries[c]
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
        slope += abs(entries[column]) * (residuals[pair, UPPER] - residuals[pair, LOWER])
    return column


@kernel(borrows=True)
def _set_vertex(
    table: FloatArray,
    active: IntArray,
    residuals: FloatArray,
    vertex: FloatArray,
    displaced: FloatArray,
) -> None:
    """Write the ends at which the active pairs are, and the displacements that follow."""
    n_rows, n_columns = table.shape
    for c in range(n_columns):
        vertex[c] = residuals[active[c], UPPER if table[n_rows - 1, c] > 0.0 else LOWER]
    displaced[:] = 0.0
    # Column by column: sums that wait for each other would take three times as long.
    for c in range(n_columns):
        for x in range(n_rows - 2):
            displaced[x] += table[x, c] * vertex[c]


@kernel(borrows=True)
def _set_excesses(
    linear: Linearization,
    is_active: NDArray[np.bool_],
    displaced: FloatArray,
    widest: float,
    excesses: FloatArray,
) -> float:
    """Write by how much each pair leaves its bounds, if it does so clearly; return the most."""
    edges, gradients, unknowns = linear.edges, linear.gradients, linear.unknowns
    residuals = linear.residuals
    largest = 0.0
    for m in range(len(residuals)):
        excesses[m] = 0.0
        if is_active[m]:
            continue
        value = 0.0
        for axis in range(gradients.shape[1]):
            plus, minus = unknowns[edges[m, 0], axis], unknowns[edges[m, 1], axis]
            if plus >= 0:
                value += gradients[m, axis] * displaced[plus]
            if minus >= 0:
                value -= gradients[m, axis] * displaced[minus]
        low, high = residuals[m, LOWER], residuals[m, UPPER]
        least = max(TOLERANCE * (high - low), LEAST_VIOLATION * widest)
        if value - high > least:
            excesses[m] = value - high
        elif low - value > least:
            excesses[m] = value - low
        largest = max(largest, abs(excesses[m]))
    return largest


@kernel(borrows=True)
def _leaving_row(
    linear: Linearization,
    table: FloatArray,
    excesses: FloatArray,
    largest: float,
    widths: FloatArray,
    widest: float,
    entries: FloatArray,
) -> int:
    """
    Return the pair that is violated most, and write its row.

    Large violations are compared in units of the step that mends them, with multipliers measured
    by the widths of their pairs (dual steepest edge). That takes a quarter fewer exchanges than
    the largest violation does. `widths` are those of the active pairs, over the `widest` of all.
    """
    row, best = -1, 0.0
    for m in range(len(excesses)):
        excess = abs(excesses[m])
        if not excess > CANDIDATE * largest:
            continue
        _set_entries(linear, table, m, entries)
        own = (linear.residuals[m, UPPER] - linear.residuals[m, LOWER]) / widest
        edge = own * own
        for c in range(len(entries)):
            along = entries[c] * widths[c]
            edge += along * along
        if edge > 0.0 and excess > best * math.sqrt(edge):
            row, best = m, excess / math.sqrt(edge)
    if row >= 0:
        _set_entries(linear, table, row, entries)
    return row


@kernel
def set_multipliers(
    linear: Linearization, table: FloatArray, active: IntArray, multipliers: FloatArray
) -> None:
    """
    Write the multipliers that bound the function in the last row but one from above.

    Parameters
    ----------
    linear : Linearization
        The measured pairs.
    table, active
        As `set_table` wrote them, and the function in the last row but one.
    multipliers : ndarray, shape (m,)
        Where they are written.

    """
    residuals = linear.residuals
    n_rows, n_columns = table.shape
    function, work = n_rows - 2, n_rows - 1
    scale = np.abs(table[function]).max()
    for c in range(n_columns):
        table[work, c] = table[function, c] + PERTURBATION * scale * ((c * GOLDEN) % 1.0 - 0.5)
    is_active = np.zeros(len(residuals), dtype=np.bool_)
    for c in range(n_columns):
        is_active[active[c]] = True
    vertex, displaced = np.empty(n_columns), np.empty(n_rows - 2)
    widths, entries = np.empty(n_columns), np.empty(n_columns)
    excesses = np.empty(len(residuals))
    widest = (residuals[:, UPPER] - residuals[:, LOWER]).max()
    if widest == 0.0:
        widest = 1.0
    for _ in range(MOST_EXCHANGES):
        for c in range(n_columns):
            pair = active[c]
            widths[c] = (residuals[pair, UPPER] - residuals[pair, LOWER]) / widest
        _set_vertex(table, active, residuals, vertex, displaced)
        largest = _set_excesses(linear, is_active, displaced, widest, excesses)
        row = _leaving_row(linear, table, excesses, largest, widths, widest, entries)
        if row < 0:
            break
        side = 1.0 if excesses[row] > 0.0 else -1.0
        column = _entering_column(table, active, residuals, entries, side, -abs(excesses[row]))
        if column < 0:
            break
        is_active[active[column]] = False
        is_active[row] = True
        _exchange(table, active, entries, row, column)
    multipliers[:] = 0.0
    for c in range(n_columns):
        multipliers[active[c]] = table[function, c]
