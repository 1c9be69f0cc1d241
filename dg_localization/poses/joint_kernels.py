# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Kernels of `joint`: what the distances of several pairs say together of the poses of all bodies.

The unknowns are x, y and heading of every body, in one frame. About the center of a box of them,
a distance bounds a linear function on both sides:

- |w| <= d: u.w <= d for the unit vector u along w at the center;
- |w| >= d: w strays from u's line by T at most within the box, and (u.w)^2 >= d^2 - T^2.

What is left of the rotations is bounded by their second and third derivative, as in `cuts`. Linear
programs then bound every unknown by all of these functions at once.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import (
    down,
    rounding_error,
    sqrt_down,
    square_down,
    square_up,
    up,
)
from dg_localization.interval.simplex import LinearPrograms, find_multipliers, new_programs
from dg_localization.poses.cuts import (
    A_ERROR,
    B_ERROR,
    ERROR_RADIUS,
    FARTHEST,
    NEAREST,
    TERMS,
    A,
    B,
)
from dg_localization.poses.half_spaces import HIGH, LOW, X, Y, beyond_first_order, with_error

HEADING = 2
"""Column of a pose (x, y, heading)."""

POSSIBLE = -1
"""No pair rules out a box."""

_SHORTEST_M = 1e-9
"""Points nearer than this at the center of a box have no direction from one to the other."""

TOLERANCE = 1e-6
"""By which fraction of their widths functions may leave their bounds in a linear program."""

LEAST_NARROWED = 0.05
"""A box is narrowed again while some unknown loses this share of its width."""


@kernel(borrows=True)
def _error_along(
    ux: float, uy: float, error_x: float, error_y: float, turn: np.ndarray, half: float
) -> float:
    """Bound what the error of a point of a body adds to u.(point) anywhere in the box."""
    along_x, along_y = turn[0] * ux + turn[1] * uy, turn[0] * uy - turn[1] * ux
    drift = half * (abs(ux) + abs(uy)) * (error_x + error_y)
    return abs(along_x) * error_x + abs(along_y) * error_y + drift


@kernel(borrows=True)
def _along(
    ux: float, uy: float, x: float, y: float, half: float
) -> tuple[float, float, float, float]:
    """
    Return the slope of u.(point) in the heading, what it reaches, and its second-order bounds.

    The first of these is of the upper bound of u.(point), the second of the lower one.
    """
    value, slope = ux * x + uy * y, uy * x - ux * y
    return (
        slope,
        abs(slope) * half,
        beyond_first_order(half, value, slope),
        beyond_first_order(half, -value, slope),
    )


@kernel(borrows=True)
def _write_row(
    box: np.ndarray,
    center: np.ndarray,
    half: np.ndarray,
    turns: np.ndarray,
    pair: np.ndarray,
    row: np.ndarray,
    slopes: np.ndarray,
    bounds: np.ndarray,
) -> int:
    """
    Write the linear function that a distance bounds, scaled by the half-widths of the box.

    Returns 1 if it says anything, 0 if not, and -1 where it rules out the box.
    """
    a, b = pair[0], pair[1]
    half_a, half_b = half[a, HEADING], half[b, HEADING]
    ax = turns[a, 1] * row[A + Y] - turns[a, 0] * row[A + X]
    ay = -turns[a, 1] * row[A + X] - turns[a, 0] * row[A + Y]
    bx = turns[b, 0] * row[B + X] - turns[b, 1] * row[B + Y]
    by = turns[b, 1] * row[B + X] + turns[b, 0] * row[B + Y]
    wx = center[b, X] - center[a, X] + bx + ax
    wy = center[b, Y] - center[a, Y] + by + ay
    norm = math.sqrt(wx * wx + wy * wy)
    magnitude = row[TERMS]
    for body in (a, b):
        magnitude += abs(center[body, X]) + abs(center[body, Y]) + half[body, X] + half[body, Y]
    if not _SHORTEST_M < norm < math.inf or not magnitude < math.inf:
        return 0
    ux, uy = wx / norm, wy / norm
    half_x, half_y = half[a, X] + half[b, X], half[a, Y] + half[b, Y]
    slope_a, reach_a, below_a, above_a = _along(ux, uy, ax, ay, half_a)
    slope_b, reach_b, below_b, above_b = _along(ux, uy, bx, by, half_b)
    reach = abs(ux) * half_x + abs(uy) * half_y + reach_a + reach_b
    reach = with_error(reach, magnitude)
    along = ux * wx + uy * wy
    error = _error_along(ux, uy, row[A_ERROR + X], row[A_ERROR + Y], turns[a], half_a)
    error += _error_along(ux, uy, row[B_ERROR + X], row[B_ERROR + Y], turns[b], half_b)
    # The linear function is bounded by its reach, whatever was measured.
    low, high = -reach, reach
    if row[FARTHEST] < math.inf:
        room = with_error(
            row[FARTHEST] - along + error + below_a + below_b, magnitude + row[FARTHEST]
        )
        high = min(high, room)
    _, stray_a, more_a, less_a = _along(-uy, ux, ax, ay, half_a)
    _, stray_b, more_b, less_b = _along(-uy, ux, bx, by, half_b)
    stray = abs(uy) * half_x + abs(ux) * half_y + stray_a + stray_b
    stray += row[ERROR_RADIUS]
    stray = with_error(stray + max(more_a, less_a) + max(more_b, less_b), magnitude)
    nearest = row[NEAREST]
    if nearest > stray:
        least = sqrt_down(down(square_down(nearest) - square_up(stray)))
        backward = reach + error + below_a + below_b - along
        if with_error(backward, magnitude) < least:
            room = with_error(along - least + error + above_a + above_b, magnitude + row[NEAREST])
            low = max(low, -room)
    if high < -reach or low > reach or low > high:
        return -1
    if high == reach and low == -reach:
        return 0
    slopes[:] = 0.0
    slopes[3 * a + X], slopes[3 * a + Y] = -ux * half[a, X], -uy * half[a, Y]
    slopes[3 * b + X], slopes[3 * b + Y] = ux * half[b, X], uy * half[b, Y]
    slopes[3 * a + HEADING], slopes[3 * b + HEADING] = slope_a * half_a, slope_b * half_b
    bounds[LOW], bounds[HIGH] = low, high
    return 1


@kernel
def _write_rows(
    box: np.ndarray,
    center: np.ndarray,
    half: np.ndarray,
    pairs: np.ndarray,
    starts: np.ndarray,
    table: np.ndarray,
    slopes: np.ndarray,
    bounds: np.ndarray,
    owners: np.ndarray,
) -> tuple[int, int]:
    """Write all rows that say anything; return their number, and the pair that rules out."""
    n = box.shape[1]
    turns = np.empty((n, 2))
    for body in range(n):
        for axis in range(3):
            low, high = box[LOW, body, axis], box[HIGH, body, axis]
            center[body, axis] = 0.5 * low + 0.5 * high
            half[body, axis] = 0.0
            if low < high:
                middle = center[body, axis]
                half[body, axis] = max(up(high - middle), up(middle - low))
        turns[body, 0] = math.cos(center[body, HEADING])
        turns[body, 1] = math.sin(center[body, HEADING])
    count = 0
    for number in range(pairs.shape[0]):
        for index in range(starts[number], starts[number + 1]):
            state = _write_row(
                box,
                center,
                half,
                turns,
                pairs[number],
                table[index],
                slopes[count],
                bounds[count],
            )
            if state < 0:
                return count, number
            owners[count] = number
            count += state
    return count, POSSIBLE


@kernel
def _programs_of(slopes: np.ndarray, bounds: np.ndarray, columns: np.ndarray) -> LinearPrograms:
    """Return the linear programs of rows, and of some unknowns, each of them within -1 and 1."""
    rows, n_unknowns = len(slopes), len(columns)
    ends = np.full((6, rows + n_unknowns), n_unknowns)
    values = np.zeros((6, rows + n_unknowns))
    all_bounds = np.empty((rows + n_unknowns, 2))
    all_bounds[:rows] = bounds
    all_bounds[rows:, LOW], all_bounds[rows:, HIGH] = -1.0, 1.0
    for row in range(rows):
        slot = 0
        for unknown in range(n_unknowns):
            slope = slopes[row, columns[unknown]]
            if slope != 0.0:
                ends[slot, row], values[slot, row] = unknown, slope
                slot += 1
    for unknown in range(n_unknowns):
        ends[0, rows + unknown], values[0, rows + unknown] = unknown, 1.0
    return new_programs(ends, values, all_bounds, n_unknowns)


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


@kernel(borrows=True)
def _guilty(
    programs: LinearPrograms, bounds: np.ndarray, owners: np.ndarray, weights: np.ndarray
) -> int:
    """Return the pair whose rows weigh most in a bound."""
    weights[:] = 0.0
    multipliers = programs.table[len(programs.active)]
    for place in range(len(programs.active)):
        row = programs.active[place]
        if row < len(bounds):
            weight = abs(multipliers[place]) * (bounds[row, HIGH] - bounds[row, LOW])
            weights[owners[row]] += weight
    return int(np.argmax(weights))


@kernel
def _narrow_box(
    box: np.ndarray, pairs: np.ndarray, starts: np.ndarray, table: np.ndarray, passes: int
) -> int:
    """Narrow a box in place; return the pair that rules it out, or `POSSIBLE`."""
    n = box.shape[1]
    center, half = np.empty((n, 3)), np.empty((n, 3))
    all_slopes = np.empty((table.shape[0] + 1, 3 * n))
    all_bounds = np.empty((table.shape[0] + 1, 2))
    owners = np.empty(table.shape[0] + 1, np.int64)
    for _pass in range(passes):
        count, ruled_out_by = _write_rows(
            box, center, half, pairs, starts, table, all_slopes, all_bounds, owners
        )
        if ruled_out_by != POSSIBLE:
            return ruled_out_by
        if count == 0:
            return POSSIBLE
        slopes, bounds = all_slopes[:count], all_bounds[:count]
        open_columns = np.flatnonzero(half.ravel() > 0.0)
        programs = _programs_of(slopes, bounds, open_columns)
        weights = np.empty(len(pairs))
        narrowed = 0.0
        for column in range(len(open_columns)):
            unknown = open_columns[column]
            ends = np.ones(2)
            for end in range(2):
                sign = 1.0 if end == HIGH else -1.0
                programs.table[len(open_columns)] = sign * programs.table[column]
                find_multipliers(programs, TOLERANCE)
                ends[end] = min(1.0, _bound(programs, slopes, bounds, unknown, sign))
            if ends[HIGH] < -ends[LOW]:
                return _guilty(programs, bounds, owners, weights)
            body, axis = unknown // 3, unknown % 3
            middle, wide = center[body, axis], half[body, axis]
            if ends[LOW] < 1.0:
                lower = down(middle - up(ends[LOW] * wide))
                box[LOW, body, axis] = max(box[LOW, body, axis], lower)
            if ends[HIGH] < 1.0:
                upper = up(middle + up(ends[HIGH] * wide))
                box[HIGH, body, axis] = min(box[HIGH, body, axis], upper)
            if box[LOW, body, axis] > box[HIGH, body, axis]:
                return _guilty(programs, bounds, owners, weights)
            narrowed = max(narrowed, 1.0 - 0.5 * (ends[LOW] + ends[HIGH]))
        if narrowed < LEAST_NARROWED:
            break
    return POSSIBLE


@kernel
def narrow_boxes(
    boxes: np.ndarray,
    pairs: np.ndarray,
    starts: np.ndarray,
    table: np.ndarray,
    passes: int,
    found: np.ndarray,
) -> None:
    """
    Narrow boxes of the poses of all bodies by the distances of all pairs.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (k, 2, n, 3)
        Lower and upper bounds of x and y in m and of the heading in rad; narrowed in place.
    pairs : numpy.ndarray of int, shape (p, 2)
    starts : numpy.ndarray of int, shape (p + 1,)
        Where the readings of each pair begin.
    table : numpy.ndarray, shape (m, COLUMNS)
        The readings of all pairs.
    passes : int
        How often at most.
    found : numpy.ndarray of int, shape (k,)
        Receives of each box `POSSIBLE`, or the pair that weighs most in the proof that nothing is
        left.

    """
    for number in range(boxes.shape[0]):
        found[number] = _narrow_box(boxes[number], pairs, starts, table, passes)
