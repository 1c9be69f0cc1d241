# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers for bounds of each of a few unknowns: linear programs, by the dual simplex method.

Every row bounds a linear function of the unknowns on both sides, and the unknowns themselves are
within -1 and 1. As many *active* rows as there are unknowns have multipliers. Any choice of them
is dual feasible: there is no first phase, each exchange improves the bound, and the method may
stop after any of them. Rows are many and unknowns few, so the inverse of the active rows is kept
(the revised method), not a table of all rows in terms of them as in `solver.contract.simplex`.
Nothing here is rounded outward, because any multipliers give a bound.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.poses.half_spaces import HIGH, LOW

MOST_EXCHANGES = 60

TOLERANCE = 1e-6
"""A row is violated when its function leaves its bounds by more than this part of their width."""

LEAST_ENTRY = 1e-7
"""An entry below this fraction of the largest in its row is no pivot."""

PERTURBATION = 1e-5
"""Of the function that is bounded: many of its entries are zero, and ties may cycle."""

GOLDEN = 0.6180339887


class LinearPrograms(NamedTuple):
    """
    The linear programs of one set of rows, with what they work in.

    Attributes
    ----------
    slopes : numpy.ndarray, shape (f, m)
        Of the rows, by unknown: f rows are multiplied at once.
    bounds : numpy.ndarray, shape (m + f, 2)
        Of the rows and of the unknowns themselves.
    active : numpy.ndarray of int, shape (f,)
        The active rows; from m on they are unknowns.
    is_active : numpy.ndarray of bool, shape (m + f,)
    inverse : numpy.ndarray, shape (f, f)
        A row times this gives its entries: factors of the active rows that make it.
    multipliers : numpy.ndarray, shape (f,)
        Of the active rows, for the function that was bounded last.
    perturbed : numpy.ndarray, shape (f,)
        The same while it is improved, without ties.
    entries, used : numpy.ndarray, shape (f,)
        Of the row that becomes active.
    values : numpy.ndarray, shape (m + f,)
        Of all rows where the active ones are at their bounds.

    """

    slopes: np.ndarray
    bounds: np.ndarray
    active: np.ndarray
    is_active: np.ndarray
    inverse: np.ndarray
    multipliers: np.ndarray
    perturbed: np.ndarray
    entries: np.ndarray
    used: np.ndarray
    values: np.ndarray


@kernel
def set_up_programs(slopes: np.ndarray, bounds: np.ndarray, columns: np.ndarray) -> LinearPrograms:
    """
    Return the linear programs of some rows, the unknowns active.

    Parameters
    ----------
    slopes : numpy.ndarray, shape (m, n)
    bounds : numpy.ndarray, shape (m, 2)
    columns : numpy.ndarray of int, shape (f,)
        The unknowns.

    """
    rows, free = slopes.shape[0], columns.shape[0]
    chosen = np.empty((free, rows))
    all_bounds = np.empty((rows + free, 2))
    all_bounds[:rows] = bounds
    active, is_active = np.empty(free, np.int64), np.zeros(rows + free, np.bool_)
    inverse = np.zeros((free, free))
    for column in range(free):
        for row in range(rows):
            chosen[column, row] = slopes[row, columns[column]]
        all_bounds[rows + column, LOW], all_bounds[rows + column, HIGH] = -1.0, 1.0
        active[column] = rows + column
        is_active[rows + column] = True
        inverse[column, column] = 1.0
    return LinearPrograms(
        chosen,
        all_bounds,
        active,
        is_active,
        inverse,
        np.empty(free),
        np.empty(free),
        np.empty(free),
        np.empty(free, np.bool_),
        np.empty(rows + free),
    )


@kernel(inlined=True)
def _most_violated(programs: LinearPrograms) -> tuple[int, float, float]:
    """Return the row that is violated most, by how much, and the side: 1.0 above, -1.0 below."""
    slopes, bounds, values = programs.slopes, programs.bounds, programs.values
    free, rows = slopes.shape
    for row in range(rows):
        values[row] = 0.0
    for unknown in range(free):
        place = 0.0
        for c in range(free):
            end = bounds[programs.active[c], HIGH if programs.perturbed[c] > 0.0 else LOW]
            place += programs.inverse[unknown, c] * end
        values[rows + unknown] = place
        for row in range(rows):
            values[row] += place * slopes[unknown, row]
    worst_row, worst, side = -1, 0.0, 0.0
    for row in range(rows + free):
        above, below = values[row] - bounds[row, HIGH], bounds[row, LOW] - values[row]
        beyond = max(above, below)
        least = TOLERANCE * (bounds[row, HIGH] - bounds[row, LOW])
        if beyond > worst and beyond > least and not programs.is_active[row]:
            worst_row, worst, side = row, beyond, 1.0 if above > below else -1.0
    return worst_row, worst, side


@kernel(inlined=True)
def _leaving(programs: LinearPrograms, row: int, side: float, slope: float) -> int:
    """
    Return which active row a violated one takes the place of: where the bound is lowest.

    The bound is convex and piecewise linear along the line of the exchange; `slope` is its first
    slope, and each multiplier that changes its sign makes it steeper.
    """
    entries, used, perturbed = programs.entries, programs.used, programs.perturbed
    free, rows = programs.slopes.shape
    largest = 0.0
    for c in range(free):
        entry = 0.0
        if row < rows:
            for unknown in range(free):
                entry += programs.slopes[unknown, row] * programs.inverse[unknown, c]
        else:
            entry = programs.inverse[row - rows, c]
        entries[c] = entry
        used[c] = False
        largest = max(largest, abs(entry))
    leaving = -1
    while slope < 0.0:
        nearest, following = math.inf, -1
        for c in range(free):
            entry = side * entries[c]
            if used[c] or abs(entry) < LEAST_ENTRY * largest:
                continue
            ratio = perturbed[c] / entry
            if (ratio > 0.0 or (ratio == 0.0 and entry < 0.0)) and ratio < nearest:
                nearest, following = ratio, c
        if following < 0:
            return -1
        leaving = following
        used[leaving] = True
        bounds = programs.bounds[programs.active[leaving]]
        slope += abs(entries[leaving]) * (bounds[HIGH] - bounds[LOW])
    return leaving


@kernel(inlined=True)
def _exchange(programs: LinearPrograms, row: int, leaving: int) -> None:
    """Make a row active in place of another; `entries` are its own."""
    inverse, entries = programs.inverse, programs.entries
    free = len(entries)
    pivot = entries[leaving]
    for unknown in range(free):
        factor = inverse[unknown, leaving] / pivot
        if factor != 0.0:
            for c in range(free):
                inverse[unknown, c] -= factor * entries[c]
        inverse[unknown, leaving] = factor
    factor = programs.perturbed[leaving] / pivot
    for c in range(free):
        programs.perturbed[c] -= factor * entries[c]
    programs.perturbed[leaving] = factor
    programs.is_active[programs.active[leaving]] = False
    programs.is_active[row] = True
    programs.active[leaving] = row


@kernel(borrows=True)
def find_multipliers(programs: LinearPrograms, unknown: int, sign: float) -> None:
    """Write the multipliers of the active rows that bound sign times an unknown from above."""
    free = len(programs.active)
    scale = 0.0
    for c in range(free):
        scale = max(scale, abs(programs.inverse[unknown, c]))
    for c in range(free):
        nudge = PERTURBATION * scale * ((c * GOLDEN) % 1.0 - 0.5)
        programs.perturbed[c] = sign * programs.inverse[unknown, c] + nudge
    for _ in range(MOST_EXCHANGES):
        row, violation, side = _most_violated(programs)
        if row < 0:
            break
        leaving = _leaving(programs, row, side, -violation)
        if leaving < 0:
            break
        _exchange(programs, row, leaving)
    for c in range(free):
        programs.multipliers[c] = sign * programs.inverse[unknown, c]
