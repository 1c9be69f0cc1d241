# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers for bounds of linear functions: linear programs, by the dual simplex method.

Every row bounds a linear function of the unknowns on both sides. One table expresses the unknowns
and the function to be bounded in terms of as many *active* rows as there are unknowns; the row of
the function then holds multipliers. Other rows follow from the rows of their unknowns on demand.
Rows are bounded on both sides, so any choice of active rows is dual feasible: there is no first
phase, each exchange improves the bound, and the method may stop after any exchange. The row that
violates its bounds most, as a displacement along its gradient, is exchanged next; steepest-edge
pricing would save few exchanges and cost more. Nothing here is rounded outward, because any
multipliers give a bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.components import HIGH, LOW
from dg_localization.interval.kernels import kernel

MOST_EXCHANGES = 60
"""Most exchanges for one function. As many as rows take four times as long at 30 points in space,
and bounds gain less than 3 %."""

SMALLEST_WIDTH = 1e-13
"""Least relative width of a row, so that weights stay finite for exact bounds; a pivot that keeps
no more than this part of its diagonal entry counts as zero."""

LEAST_ENTRY = 1e-7
"""An entry below this fraction of the largest in its row is no pivot."""

PERTURBATION = 1e-5
"""Relative perturbation of a row during its optimization: its many zeros make ties that cycle."""

GOLDEN = 0.6180339887


class LinearPrograms(NamedTuple):
    """The linear programs of m rows in f unknowns."""

    slopes: np.ndarray  # (f, m): unknowns first, so that many rows are multiplied at once
    bounds: np.ndarray  # (m, 2): lower and upper bounds of the rows
    scales: np.ndarray  # (m,): one over the length of the gradient
    table: np.ndarray  # (f + 2, f): unknowns, the function, and the function without ties
    active: np.ndarray  # (f,)
    values: np.ndarray  # (m,): values of the rows with the active ones at their bounds
    reached: np.ndarray  # (2, f): least and greatest unknowns at the maxima found so far


@kernel
def new_programs(slopes: np.ndarray, bounds: np.ndarray) -> LinearPrograms:
    """Return the linear programs of rows; the last rows, one for each unknown, are active."""
    n_unknowns, n_rows = slopes.shape
    scales = np.zeros(n_rows)
    for m in range(n_rows):
        square = 0.0
        for unknown in range(n_unknowns):
            square += slopes[unknown, m] * slopes[unknown, m]
        if square > 0.0:
            scales[m] = 1.0 / math.sqrt(square)
    table = np.eye(n_unknowns + 2, n_unknowns)
    active = np.arange(n_rows - n_unknowns, n_rows)
    values, reached = np.empty(n_rows), np.zeros((2, n_unknowns))
    return LinearPrograms(slopes, bounds, scales, table, active, values, reached)


@kernel(borrows=True)
def _exchange(
    table: np.ndarray, active: np.ndarray, entries: np.ndarray, row: int, column: int
) -> None:
    """Make a row with given entries active in place of the active row of a column."""
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
def _set_entries(programs: LinearPrograms, m: int, entries: np.ndarray) -> None:
    """Write a row in terms of the active ones."""
    entries[:] = 0.0
    for unknown in range(len(entries)):
        slope = programs.slopes[unknown, m]
        if slope != 0.0:
            for c in range(len(entries)):
                entries[c] += slope * programs.table[unknown, c]


@kernel
def activate_well_known(programs: LinearPrograms) -> bool:
    """
    Make rows with narrow bounds active, before any function is bounded.

    Return False if the rows do not determine the unknowns.
    """
    table, active = programs.table, programs.active
    bounds, n_rows, n_unknowns = programs.bounds, len(programs.bounds), len(active)
    rows = np.empty((n_rows + n_unknowns, n_unknowns))
    rows[n_rows:] = np.eye(n_unknowns)
    table[:] = np.eye(n_unknowns + 2, n_unknowns)
    for m in range(n_rows):
        _set_entries(programs, m, rows[m])
    largest = np.abs(rows[:n_rows]).max()
    is_chosen = np.zeros(n_unknowns, dtype=np.bool_)
    for _ in range(n_unknowns):
        best, row, column = 0.0, -1, -1
        for m in range(n_rows):
            width = bounds[m, HIGH] - bounds[m, LOW] + SMALLEST_WIDTH * largest * largest
            for c in range(n_unknowns):
                if not is_chosen[c] and abs(rows[m, c]) > best * width:
                    best, row, column = abs(rows[m, c]) / width, m, c
        if row < 0 or abs(rows[row, column]) < LEAST_ENTRY * largest:
            return False
        _exchange(rows, active, rows[row].copy(), row, column)
        is_chosen[column] = True
    table[:n_unknowns] = rows[n_rows:]
    return True


@kernel(borrows=True)
def _leaving_row(
    programs: LinearPrograms, displaced: np.ndarray, tolerance: float, widest: float
) -> int:
    """Return the row that violates its bounds most, -1 if none does clearly."""
    bounds, values = programs.bounds, programs.values
    values[:] = 0.0
    for unknown in range(len(displaced)):
        slopes, place = programs.slopes[unknown], displaced[unknown]
        if place != 0.0:
            for m in range(len(values)):
                values[m] += slopes[m] * place
    row, farthest = -1, 0.0
    for m in range(len(bounds)):
        low, high = bounds[m, LOW], bounds[m, HIGH]
        excess = max(values[m] - high, low - values[m])
        if excess * programs.scales[m] > farthest:
            # A smaller violation is a rounding error.
            least = max(tolerance * (high - low), SMALLEST_WIDTH * widest)
            if excess > least:
                row, farthest = m, excess * programs.scales[m]
    return row


@kernel(borrows=True)
def _entering_column(
    programs: LinearPrograms, entries: np.ndarray, side: float, slope: float, ratios: np.ndarray
) -> int:
    """
    Return the column to exchange for a violated row: where the bound is lowest along its line.

    The bound is convex and piecewise linear along the line; `slope` is its first slope, and each
    entry of the last row that changes its sign makes it steeper.
    """
    multipliers, bounds = programs.table[len(programs.table) - 1], programs.bounds
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
        row = programs.active[column]
        slope += abs(entries[column]) * (bounds[row, HIGH] - bounds[row, LOW])
    return column


@kernel(borrows=True)
def _move_to_vertex(programs: LinearPrograms, vertex: np.ndarray, displaced: np.ndarray) -> None:
    """Move active rows to the bounds given by their multipliers, and the unknowns with them."""
    table = programs.table
    n_unknowns = len(vertex)
    for c in range(n_unknowns):
        row = programs.active[c]
        end = programs.bounds[row, HIGH if table[n_unknowns + 1, c] > 0.0 else LOW]
        step = end - vertex[c]
        if step != 0.0:
            vertex[c] = end
            for x in range(n_unknowns):
                displaced[x] += table[x, c] * step


@kernel
def find_multipliers(programs: LinearPrograms, tolerance: float) -> None:
    """
    Find the multipliers of the active rows that bound the function of the table from above.

    Rows may violate their bounds by the tolerance, a fraction of their widths.
    """
    table, active = programs.table, programs.active
    n_unknowns = len(active)
    function, untied = table[n_unknowns], table[n_unknowns + 1]
    scale = np.abs(function).max()
    for c in range(n_unknowns):
        untied[c] = function[c] + PERTURBATION * scale * ((c * GOLDEN) % 1.0 - 0.5)
    widest = (programs.bounds[:, HIGH] - programs.bounds[:, LOW]).max()
    vertex, displaced = np.zeros(n_unknowns), np.zeros(n_unknowns)
    entries, ratios = np.empty(n_unknowns), np.empty(n_unknowns)
    for _ in range(MOST_EXCHANGES):
        _move_to_vertex(programs, vertex, displaced)
        row = _leaving_row(programs, displaced, tolerance, widest)
        if row < 0:
            for x in range(n_unknowns):
                programs.reached[LOW, x] = min(programs.reached[LOW, x], displaced[x])
                programs.reached[HIGH, x] = max(programs.reached[HIGH, x], displaced[x])
            break
        value = programs.values[row]
        low, high = programs.bounds[row, LOW], programs.bounds[row, HIGH]
        side, excess = (1.0, value - high) if value > high else (-1.0, low - value)
        _set_entries(programs, row, entries)
        column = _entering_column(programs, entries, side, -excess, ratios)
        if column < 0:
            break
        _exchange(table, active, entries, row, column)
        vertex[column] = value
