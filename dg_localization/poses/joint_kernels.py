# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Kernels of `joint`: the poses of all bodies by the distances of several pairs together.

The unknowns are x, y, z and yaw of every body, in one frame. Within a box, each distance gives two
parallel half-spaces (`cuts`). Linear programs bound every unknown by all half-spaces at once.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.pave import LEAST_GAIN
from dg_localization.interval.rounding import down, rounding_error, up
from dg_localization.interval.simplex import LinearPrograms, find_multipliers, new_programs
from dg_localization.poses.cuts import (
    A_BODY,
    B_BODY,
    GROUP,
    LONGEST,
    MAGNITUDE,
    W_SIZE,
    distance_half_spaces,
    place_ends,
)
from dg_localization.poses.half_spaces import CENTER, HALF, HIGH, LOW, VIEW, YAW, view_box

POSSIBLE = -1
"""No pair rules out a box."""

TOLERANCE = 1e-6
"""Fraction of their widths by which functions may violate their bounds in a linear program."""


@kernel(borrows=True)
def _write_rows(
    box: np.ndarray,
    table: np.ndarray,
    view: np.ndarray,
    slopes: np.ndarray,
    bounds: np.ndarray,
    owners: np.ndarray,
    w: np.ndarray,
) -> tuple[int, int]:
    """
    Write the linear functions that distances bound, scaled by the half-widths of the box.

    Returns their number, and the pair that rules the box out.
    """
    view_box(box, view)
    count = 0
    for index in range(len(table)):
        row = table[index]
        a, b = int(row[A_BODY]), int(row[B_BODY])
        place_ends(view, (a, b), row, w)
        if not w[MAGNITUDE] < LONGEST:
            continue
        settled, along, reach, far, near = distance_half_spaces(view, (a, b), row, w)
        # The function is also bounded by its reach.
        low, high = max(-near, -reach), min(far, reach)
        if settled or low == -reach and high == reach:
            continue
        if low > high:
            return count, int(row[GROUP])
        slopes[count] = 0.0
        for axis in range(YAW):
            slopes[count, 4 * a + axis] = -along[axis] * view[a, HALF + axis]
            slopes[count, 4 * b + axis] = along[axis] * view[b, HALF + axis]
        slopes[count, 4 * a + YAW] = along[3] * view[a, HALF + YAW]
        slopes[count, 4 * b + YAW] = along[4] * view[b, HALF + YAW]
        bounds[count, LOW], bounds[count, HIGH] = low, high
        owners[count] = int(row[GROUP])
        count += 1
    return count, POSSIBLE


@kernel
def _programs_of(slopes: np.ndarray, bounds: np.ndarray, columns: np.ndarray) -> LinearPrograms:
    """Return the linear programs of rows, and of some unknowns, each of them within -1 and 1."""
    rows, n_unknowns = len(slopes), len(columns)
    by_unknowns = np.zeros((n_unknowns, rows + n_unknowns))
    all_bounds = np.empty((rows + n_unknowns, 2))
    all_bounds[:rows] = bounds
    all_bounds[rows:, LOW], all_bounds[rows:, HIGH] = -1.0, 1.0
    for unknown in range(n_unknowns):
        for row in range(rows):
            by_unknowns[unknown, row] = slopes[row, columns[unknown]]
        by_unknowns[unknown, rows + unknown] = 1.0
    return new_programs(by_unknowns, all_bounds)


@kernel(borrows=True)
def _bound(
    programs: LinearPrograms, slopes: np.ndarray, bounds: np.ndarray, unknown: int, sign: float
) -> float:
    """Bound sign times a scaled unknown from above by the rows with these multipliers."""
    rows, unknowns = slopes.shape
    active, multipliers = programs.active, programs.table[len(programs.active)]
    total, magnitude, used = 0.0, 1.0, 0
    for place in range(len(active)):
        row, factor = active[place], multipliers[place]
        if row < rows and factor != 0.0:
            value = factor * bounds[row, HIGH if factor > 0.0 else LOW]
            total += value
            magnitude += abs(value)
            used += 1
    for column in range(unknowns):
        rest = sign if column == unknown else 0.0
        for place in range(len(active)):
            row = active[place]
            if row < rows and multipliers[place] != 0.0:
                product = multipliers[place] * slopes[row, column]
                rest -= product
                magnitude += abs(product)
        total += abs(rest)
    return up(total + rounding_error(2.0 * magnitude, 4.0 * (used + 1.0) * (unknowns + 1.0)))


@kernel
def _guilty(programs: LinearPrograms, bounds: np.ndarray, owners: np.ndarray) -> int:
    """Return the pair whose rows weigh most in a bound."""
    weights = np.zeros(owners.max() + 1)
    multipliers = programs.table[len(programs.active)]
    for place in range(len(programs.active)):
        row = programs.active[place]
        if row < len(bounds):
            weight = abs(multipliers[place]) * (bounds[row, HIGH] - bounds[row, LOW])
            weights[owners[row]] += weight
    return int(np.argmax(weights))


@kernel
def narrow_box(box: np.ndarray, table: np.ndarray, passes: int) -> int:
    """Narrow a box in place; return the pair that rules it out, or `POSSIBLE`."""
    view = np.empty((box.shape[1] // 4 + 1, VIEW))
    all_slopes = np.empty((len(table), box.shape[1]))
    all_bounds = np.empty((len(table), 2))
    owners, w = np.zeros(len(table), np.int64), np.empty(W_SIZE)
    for _pass in range(passes):
        count, ruled_out_by = _write_rows(box, table, view, all_slopes, all_bounds, owners, w)
        if ruled_out_by != POSSIBLE or count == 0:
            return ruled_out_by
        slopes, bounds = all_slopes[:count], all_bounds[:count]
        half = view[:-1, HALF : HALF + 4].copy().ravel()
        open_columns = np.flatnonzero(half > 0.0)
        programs = _programs_of(slopes, bounds, open_columns)
        narrowed = 0.0
        for column in range(len(open_columns)):
            unknown = open_columns[column]
            ends = np.ones(2)
            for end in range(2):
                sign = 1.0 if end == HIGH else -1.0
                # A feasible point so near to the end leaves too little to gain.
                if sign * programs.reached[end, column] > 1.0 - LEAST_GAIN:
                    continue
                programs.table[len(open_columns)] = sign * programs.table[column]
                find_multipliers(programs, TOLERANCE)
                ends[end] = min(1.0, _bound(programs, slopes, bounds, unknown, sign))
            middle, wide = view[unknown // 4, CENTER + unknown % 4], half[unknown]
            if ends[LOW] < 1.0:
                lower = down(middle - up(ends[LOW] * wide))
                box[LOW, unknown] = max(box[LOW, unknown], lower)
            if ends[HIGH] < 1.0:
                upper = up(middle + up(ends[HIGH] * wide))
                box[HIGH, unknown] = min(box[HIGH, unknown], upper)
            if ends[HIGH] < -ends[LOW] or box[LOW, unknown] > box[HIGH, unknown]:
                return _guilty(programs, bounds, owners)
            narrowed = max(narrowed, 1.0 - 0.5 * (ends[LOW] + ends[HIGH]))
        if narrowed < LEAST_GAIN:
            break
    return POSSIBLE
