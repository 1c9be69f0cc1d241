# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers for bounds of linear functions: the linear program, by the dual simplex method.

A linear function of the displacements is to be bounded where every measured pair bounds its own
gradient. The unknown displacements are rows of one table, which writes them in terms of as many
*active* pairs as there are unknowns; so is the function, whose row then holds multipliers, and the
rows of other pairs follow from those of their ends when they are asked for. Active pairs are
bounded on both sides, so any choice of them is dual feasible: there is no first phase, each
exchange improves the bound, and the method may stop after any of them. The pair that leaves its
bounds farthest, as a displacement along its gradient, is exchanged next; steepest edges would
take hardly fewer exchanges and cost more than they save. Nothing here is rounded outward, because
any multipliers give a bound (`linearization`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.linearization import SMALLEST_WIDTH, Linearization

MOST_EXCHANGES = 60

LEAST_VIOLATION = 1e-13
"""A smaller violation, as a fraction of the widest bounds, is a rounding error."""

LEAST_ENTRY = 1e-7
"""An entry below this fraction of the largest in its row is no pivot."""

PERTURBATION = 1e-5
"""Of a row, relatively, while it is improved: many of its entries are zero, and ties may cycle."""

GOLDEN = 0.6180339887


class _Rows(NamedTuple):
    """The measured pairs once more, in the order in which the method runs through them."""

    ends: IntArray  # (q, 2, m): numbers of the displacements of both ends; the last is always zero
    slopes: FloatArray  # (q, m): the gradients, in m
    low: FloatArray  # (m,): lower bounds of the residuals, in m^2
    high: FloatArray  # (m,): upper bounds
    scales: FloatArray  # (m,): one over the length of the gradient, in 1/m
    values: FloatArray  # (m,): the residuals of the current displacements


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
        if plus >= 0:
            for c in range(len(entries)):
                entries[c] += slope * table[plus, c]
        if minus >= 0:
            for c in range(len(entries)):
                entries[c] -= slope * table[minus, c]


@kernel
def set_table(linear: Linearization, table: FloatArray, active: IntArray) -> bool:
    """
    Write the table in terms of well-known measured pairs.

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
def _rows_of(linear: Linearization, n_displacements: int) -> _Rows:
    """Return the measured pairs as the method needs them."""
    edges, gradients, residuals = linear.edges, linear.gradients, linear.residuals
    n_edges, dimension = gradients.shape
    ends = np.empty((dimension, 2, n_edges), dtype=np.int64)
    low, high = residuals[:, LOWER].copy(), residuals[:, UPPER].copy()
    slopes, scales = np.empty((dimension, n_edges)), np.zeros(n_edges)
    for m in range(n_edges):
        square = 0.0
        for axis in range(dimension):
            slopes[axis, m] = gradients[m, axis]
            square += gradients[m, axis] * gradients[m, axis]
            for end in range(2):
                unknown = linear.unknowns[edges[m, end], axis]
                ends[axis, end, m] = unknown if unknown >= 0 else n_displacements
        if square > 0.0:
            scales[m] = 1.0 / math.sqrt(square)
    return _Rows(ends, slopes, low, high, scales, np.empty(n_edges))


@kernel(borrows=True)
def _leaving_row(rows: _Rows, displaced: FloatArray, tolerance: float, widest: float) -> int:
    """Return the pair that leaves its bounds farthest, -1 where none does clearly."""
    low, high, values = rows.low, rows.high, rows.values
    values[:] = 0.0
    for axis in range(len(rows.slopes)):
        slopes, plus, minus = rows.slopes[axis], rows.ends[axis, 0], rows.ends[axis, 1]
        for m in range(len(values)):
            values[m] += slopes[m] * (displaced[plus[m]] - displaced[minus[m]])
    row, farthest = -1, 0.0
    for m in range(len(values)):
        excess = max(values[m] - high[m], low[m] - values[m])
        if excess * rows.scales[m] > farthest:
            least = max(tolerance * (high[m] - low[m]), LEAST_VIOLATION * widest)
            if excess > least:
                row, farthest = m, excess * rows.scales[m]
    return row


@kernel(borrows=True)
def _entering_column(
    table: FloatArray,
    active: IntArray,
    rows: _Rows,
    entries: FloatArray,
    side: float,
    slope: float,
    ratios: FloatArray,
) -> int:
    """
    Return which column to exchange for a violated pair: where the bound is lowest along its line.

    The bound is convex and piecewise linear along the line; `slope` is its first slope, and each
    entry of the last row that changes its sign makes it steeper.
    """
    multipliers = table[len(table) - 1]
    largest = 0.0
    for c in range(len(entries)):
        largest = max(largest, abs(entries[c]))
    for c in range(len(entries)):
        entry = side * entries[c]
        ratios[c] = math.inf
        if abs(entry) > LEAST_ENTRY * largest:
            ratio = multipliers[c] / entry
            if ratio > 0.0 or (ratio == 0.0 and entry < 0.0):
                ratios[c] = ratio
    column = -1
    while slope < 0.0:
        column, nearest = -1, math.inf
        for c in range(len(ratios)):
            if ratios[c] < nearest:
                column, nearest = c, ratios[c]
        if column < 0:
            break
        ratios[column] = math.inf
        pair = active[column]
        slope += abs(entries[column]) * (rows.high[pair] - rows.low[pair])
    return column


@kernel(borrows=True)
def _move_to_vertex(
    table: FloatArray,
    active: IntArray,
    rows: _Rows,
    vertex: FloatArray,
    displaced: FloatArray,
) -> None:
    """Move active pairs to the ends where their multipliers have them, and the displacements."""
    n_rows, n_columns = table.shape
    for c in range(n_columns):
        pair = active[c]
        end = rows.high[pair] if table[n_rows - 1, c] > 0.0 else rows.low[pair]
        step = end - vertex[c]
        if step != 0.0:
            vertex[c] = end
            for x in range(n_rows - 2):
                displaced[x] += table[x, c] * step


@kernel
def set_program_multipliers(
    linear: Linearization,
    table: FloatArray,
    active: IntArray,
    tolerance: float,
    multipliers: FloatArray,
) -> None:
    """Write the multipliers that bound the function in the last row but one from above."""
    n_rows, n_columns = table.shape
    function, work = n_rows - 2, n_rows - 1
    scale = np.abs(table[function]).max()
    for c in range(n_columns):
        table[work, c] = table[function, c] + PERTURBATION * scale * ((c * GOLDEN) % 1.0 - 0.5)
    rows = _rows_of(linear, n_rows - 2)
    widest = (rows.high - rows.low).max()
    vertex, displaced = np.zeros(n_columns), np.zeros(n_rows - 1)
    entries, ratios = np.empty(n_columns), np.empty(n_columns)
    for _ in range(MOST_EXCHANGES):
        _move_to_vertex(table, active, rows, vertex, displaced)
        row = _leaving_row(rows, displaced, tolerance, widest)
        if row < 0:
            break
        value = rows.values[row]
        side = 1.0 if value > rows.high[row] else -1.0
        excess = max(value - rows.high[row], rows.low[row] - value)
        _set_entries(linear, table, row, entries)
        column = _entering_column(table, active, rows, entries, side, -excess, ratios)
        if column < 0:
            break
        _exchange(table, active, entries, row, column)
        vertex[column] = value
    multipliers[:] = 0.0
    for c in range(n_columns):
        multipliers[active[c]] = table[function, c]
