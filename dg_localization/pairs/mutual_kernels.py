# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Kernels of `mutual`: cells of the directions in which two bodies have each other.

A point of a cell is (x, y, d): A has B in the direction REF_A + x, B has A in REF_B + y, and they
are d apart. Its box bounds x, y and d, and d lies between two planes over x and y besides.

When A goes v and B goes w, the vector from A to B becomes, along the line of sight and across it,

    (d - v cos(a) - w cos(b),  -v sin(a) - w sin(b))

with a and b the angles of v and w from the line of sight of their body. It is linear in (x, y, d)
up to r = (|v| x^2 + |w| y^2) / 2. Its length l then lies between p and p + q^2 / (2 p), with p and
q its parts along and across the vector of the middle of the cell, and both directions turn by
atan(q / p).
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, up

# A cell: middles of its directions, the box of what is added to them, the box of the distance,
# the planes below and above it (at the middle, along x, along y).
REF_A, REF_B, LOW_A, HIGH_A, LOW_B, HIGH_B, NEAR, FAR = 0, 1, 2, 3, 4, 5, 6, 7
BELOW, ABOVE = 8, 11
CELL = 14

# The row of a way: that of A (x, y), that of B (x, y), how far both err together in m, and the
# errors of the two turns in rad, or the bounds of a distance in m.
WAY_A, WAY_B, BALL, FIRST, SECOND = 0, 2, 4, 5, 6
WAY = 7

# What a cell looks like after a way: the distance of its middle and how that turned; the slopes of
# the distance and of the turn by x, y and d; how much these err; the least distance; a size.
LENGTH, TURNED, BY_X, BY_Y, BY_D, TURN_X, TURN_Y, TURN_D, MIDDLE = 0, 1, 2, 3, 4, 5, 6, 7, 8
ERROR_BELOW, ERROR_ABOVE, TURN_ERROR, LEAST, SIZE = 9, 10, 11, 12, 13
LOOK = 14

OPERATIONS = 256.0
"""More than any bound here is made of; a sine or an arctangent counts as eight."""

LARGEST_RAD = 16.0
"""More than any angle here."""

LEAST_SHARE = 0.2
"""A cell is linear enough where it stays farther off than this share of its middle."""

LARGEST_RATIO = 1.0
"""And where it strays across the line of sight, and errs, by no more than it is far off."""

STEEPEST = 4.0
"""Planes that are steeper, in multiples of the distance for each rad, are made level."""

LEAST_SLOPE = 1e-12
LEAST_ALONG = 0.3

LEFT, EMPTY, TOO_LARGE = 1, 0, -1
"""What a way leaves of a cell; one that is too large is halved."""


@kernel(borrows=True)
def size_of(cell: np.ndarray) -> float:
    """Return a bound of all numbers that describe distances of a cell."""
    size = abs(cell[NEAR]) + abs(cell[FAR])
    for column in range(BELOW, CELL):
        size += abs(cell[column])
    return size


@kernel(borrows=True)
def least_over_box(cell: np.ndarray, value: float, by_x: float, by_y: float) -> float:
    """Return the least of a linear function over the directions of a cell."""
    least_x = min(by_x * cell[LOW_A], by_x * cell[HIGH_A])
    return value + least_x + min(by_y * cell[LOW_B], by_y * cell[HIGH_B])


@kernel(borrows=True)
def _least_over_cell(
    cell: np.ndarray, value: float, by_x: float, by_y: float, by_d: float, middle: float
) -> float:
    """Return a lower bound of value + by_x x + by_y y + by_d (d - middle) over a cell."""
    plane, end = (BELOW, NEAR) if by_d >= 0.0 else (ABOVE, FAR)
    flat = least_over_box(cell, value + by_d * (cell[end] - middle), by_x, by_y)
    tilted = least_over_box(
        cell,
        value + by_d * (cell[plane] - middle),
        by_x + by_d * cell[plane + 1],
        by_y + by_d * cell[plane + 2],
    )
    return max(flat, tilted)


@kernel(borrows=True)
def _cut(cell: np.ndarray, value: float, by_x: float, by_y: float) -> bool:
    """Cut a cell to where a linear function is not negative; return whether anything is left."""
    most_y = max(by_y * cell[LOW_B], by_y * cell[HIGH_B])
    if value + max(by_x * cell[LOW_A], by_x * cell[HIGH_A]) + most_y < 0.0:
        return False
    if by_x > LEAST_SLOPE:
        cell[LOW_A] = max(cell[LOW_A], down(-(value + most_y) / by_x))
    elif by_x < -LEAST_SLOPE:
        cell[HIGH_A] = min(cell[HIGH_A], up(-(value + most_y) / by_x))
    most_x = max(by_x * cell[LOW_A], by_x * cell[HIGH_A])
    if by_y > LEAST_SLOPE:
        cell[LOW_B] = max(cell[LOW_B], down(-(value + most_x) / by_y))
    elif by_y < -LEAST_SLOPE:
        cell[HIGH_B] = min(cell[HIGH_B], up(-(value + most_x) / by_y))
    return cell[LOW_A] <= cell[HIGH_A] and cell[LOW_B] <= cell[HIGH_B]


@kernel(borrows=True)
def _value_at_middle(cell: np.ndarray, value: float, by_x: float, by_y: float) -> float:
    """Return a linear function at the middle of a cell."""
    middle_x = 0.5 * (cell[LOW_A] + cell[HIGH_A])
    return value + by_x * middle_x + by_y * 0.5 * (cell[LOW_B] + cell[HIGH_B])


@kernel(borrows=True)
def _set_plane(cell: np.ndarray, plane: int, value: float, by_x: float, by_y: float) -> None:
    """Replace a plane of a cell."""
    cell[plane], cell[plane + 1], cell[plane + 2] = value, by_x, by_y


@kernel(borrows=True)
def close_cell(cell: np.ndarray) -> bool:
    """
    Cut a cell to where its distances have anything in common; return whether anything is left.

    Of a plane and the level end of the box the sharper one at the middle becomes the plane.
    """
    slack = rounding_error(size_of(cell), OPERATIONS)
    below, below_x, below_y = cell[BELOW], cell[BELOW + 1], cell[BELOW + 2]
    above, above_x, above_y = cell[ABOVE], cell[ABOVE + 1], cell[ABOVE + 2]
    if not _cut(cell, above - below + slack, above_x - below_x, above_y - below_y):
        return False
    if not _cut(cell, above - cell[NEAR] + slack, above_x, above_y):
        return False
    if not _cut(cell, cell[FAR] - below + slack, -below_x, -below_y):
        return False
    cell[NEAR] = max(cell[NEAR], least_over_box(cell, below, below_x, below_y) - slack)
    cell[FAR] = min(cell[FAR], slack - least_over_box(cell, -above, -above_x, -above_y))
    if cell[NEAR] > _value_at_middle(cell, below, below_x, below_y):
        _set_plane(cell, BELOW, cell[NEAR], 0.0, 0.0)
    if cell[FAR] < _value_at_middle(cell, above, above_x, above_y):
        _set_plane(cell, ABOVE, cell[FAR], 0.0, 0.0)
    return cell[NEAR] <= cell[FAR]


@kernel(borrows=True)
def _along_and_across(cell: np.ndarray, way: np.ndarray) -> tuple[float, float, float, float]:
    """Return both ways along and across the lines of sight of the middle of a cell."""
    cosine_a, sine_a = math.cos(cell[REF_A]), math.sin(cell[REF_A])
    cosine_b, sine_b = math.cos(cell[REF_B]), math.sin(cell[REF_B])
    return (
        cosine_a * way[WAY_A] + sine_a * way[WAY_A + 1],
        cosine_a * way[WAY_A + 1] - sine_a * way[WAY_A],
        cosine_b * way[WAY_B] + sine_b * way[WAY_B + 1],
        cosine_b * way[WAY_B + 1] - sine_b * way[WAY_B],
    )


@kernel(borrows=True)
def _reach(cell: np.ndarray, way: np.ndarray) -> float:
    """Return how much both ways are, in the greatest norms that occur."""
    return abs(way[WAY_A]) + abs(way[WAY_A + 1]) + abs(way[WAY_B]) + abs(way[WAY_B + 1])


@kernel(borrows=True)
def distances_after(cell: np.ndarray, way: np.ndarray) -> tuple[float, float]:
    """Bound the distances of a cell after a way, roughly, however near the bodies come."""
    along_a, across_a, along_b, across_b = _along_and_across(cell, way)
    length_a = math.hypot(way[WAY_A], way[WAY_A + 1])
    length_b = math.hypot(way[WAY_B], way[WAY_B + 1])
    middle = 0.5 * (cell[NEAR] + cell[FAR])
    after = math.hypot(middle - along_a - along_b, across_a + across_b)
    off = 0.5 * (cell[FAR] - cell[NEAR]) + way[BALL]
    off += max(-cell[LOW_A], cell[HIGH_A]) * length_a + max(-cell[LOW_B], cell[HIGH_B]) * length_b
    size = abs(middle) + after + off + _reach(cell, way)
    off += rounding_error(size, OPERATIONS)
    return max(0.0, after - off), after + off


@kernel(borrows=True)
def _look(cell: np.ndarray, way: np.ndarray, look: np.ndarray) -> bool:
    """Write what a cell looks like after a way; return whether it is linear enough."""
    most_x = max(abs(cell[LOW_A]), abs(cell[HIGH_A]))
    most_y = max(abs(cell[LOW_B]), abs(cell[HIGH_B]))
    middle, most_d = 0.5 * (cell[NEAR] + cell[FAR]), 0.5 * (cell[FAR] - cell[NEAR])
    along_a, across_a, along_b, across_b = _along_and_across(cell, way)
    x, y = middle - along_a - along_b, -across_a - across_b
    length, reach = math.hypot(x, y), _reach(cell, way)
    if not 0.0 < length < math.inf:
        return False
    size = size_of(cell) + abs(middle) + length + 2.0 * reach + way[BALL] + 8.0
    curved = math.hypot(way[WAY_A], way[WAY_A + 1]) * most_x * most_x
    curved += math.hypot(way[WAY_B], way[WAY_B + 1]) * most_y * most_y
    error = up(0.5 * curved) + rounding_error(size, OPERATIONS)
    ux, uy = x / length, y / length
    by_x, by_y = uy * along_a - ux * across_a, uy * along_b - ux * across_b
    turn_x, turn_y = uy * across_a + ux * along_a, uy * across_b + ux * along_b
    along = abs(by_x) * most_x + abs(by_y) * most_y + abs(ux) * most_d + error
    across = abs(turn_x) * most_x + abs(turn_y) * most_y + abs(uy) * most_d + error
    least = length - along
    if not least > LEAST_SHARE * length:
        return False
    ratio = across / least
    if not ratio <= LARGEST_RATIO:
        return False
    look[LENGTH], look[TURNED], look[MIDDLE] = length, math.atan2(y, x), middle
    look[BY_X], look[BY_Y], look[BY_D] = by_x, by_y, ux
    look[TURN_X], look[TURN_Y], look[TURN_D] = turn_x / length, turn_y / length, -uy / length
    look[ERROR_BELOW] = error
    look[ERROR_ABOVE] = error + 0.5 * across * ratio
    look[TURN_ERROR] = (error + ratio * along) / length + ratio * ratio * ratio
    look[TURN_ERROR] += rounding_error(LARGEST_RAD, OPERATIONS)
    look[LEAST], look[SIZE] = least, size
    return True


@kernel(borrows=True)
def _move_plane(
    cell: np.ndarray,
    way: np.ndarray,
    look: np.ndarray,
    plane: int,
    beyond: float,
    moved: np.ndarray,
) -> None:
    """
    Write a plane of a cell after a way.

    Any slopes give a bound; these are those of the plane as it moves. The error of the ways is a
    ball: what it adds to the distance it does not add to the directions.
    """
    slope_x, slope_y = cell[plane + 1], cell[plane + 2]
    along_x = look[BY_X] + look[BY_D] * slope_x
    along_y = look[BY_Y] + look[BY_D] * slope_y
    turn_x, turn_y = look[TURN_X] + look[TURN_D] * slope_x, look[TURN_Y] + look[TURN_D] * slope_y
    apart = 1.0 + turn_x + turn_y
    by_x, by_y = 0.0, 0.0
    if apart > LEAST_SHARE:
        both = (along_x + along_y) / apart
        by_x, by_y = along_x - both * turn_x, along_y - both * turn_y
        if not abs(by_x) + abs(by_y) <= STEEPEST * look[MIDDLE]:
            by_x, by_y = 0.0, 0.0
    both = by_x + by_y
    off = abs(by_x) * way[FIRST] + abs(by_y) * way[SECOND]
    off += abs(both) * (look[TURN_ERROR] + beyond)
    off += up(way[BALL] * math.hypot(1.0, both / look[LEAST]))
    off += rounding_error(look[SIZE] + abs(by_x) + abs(by_y), OPERATIONS)
    rest_x = look[BY_X] - by_x - both * look[TURN_X]
    rest_y = look[BY_Y] - by_y - both * look[TURN_Y]
    rest_d, middle = look[BY_D] - both * look[TURN_D], look[MIDDLE]
    if plane == BELOW:
        value = _least_over_cell(cell, look[LENGTH], rest_x, rest_y, rest_d, middle)
        value -= off + look[ERROR_BELOW]
    else:
        value = -_least_over_cell(cell, -look[LENGTH], -rest_x, -rest_y, -rest_d, middle)
        value += off + look[ERROR_ABOVE] + beyond * look[LEAST]
    _set_plane(moved, plane, value, by_x, by_y)


@kernel(borrows=True)
def move_cell(
    cell: np.ndarray,
    way: np.ndarray,
    near: float,
    far: float,
    look: np.ndarray,
    moved: np.ndarray,
) -> int:
    """Write a cell after a way, where the distance is between `near` and `far` by then."""
    if not _look(cell, way, look):
        return TOO_LARGE
    ball, least, middle = way[BALL], look[LEAST], look[MIDDLE]
    if not least - ball > LEAST_SHARE * look[LENGTH]:
        return TOO_LARGE
    # What the ball does beyond the first order: to the directions, and times `least` to l.
    ratio = ball / (least - ball)
    if not ratio <= LARGEST_RATIO:
        return TOO_LARGE
    beyond = ratio * ratio * (1.0 + ratio)
    turn = look[TURN_ERROR] + ball / least + beyond + rounding_error(look[SIZE], OPERATIONS)
    x, y, d = look[TURN_X], look[TURN_Y], look[TURN_D]
    moved[REF_A], moved[REF_B] = cell[REF_A] + look[TURNED], cell[REF_B] + look[TURNED]
    off = turn + way[FIRST]
    moved[LOW_A] = _least_over_cell(cell, 0.0, 1.0 + x, y, d, middle) - off
    moved[HIGH_A] = off - _least_over_cell(cell, 0.0, -1.0 - x, -y, -d, middle)
    off = turn + way[SECOND]
    moved[LOW_B] = _least_over_cell(cell, 0.0, x, 1.0 + y, d, middle) - off
    moved[HIGH_B] = off - _least_over_cell(cell, 0.0, -x, -1.0 - y, -d, middle)
    _move_plane(cell, way, look, BELOW, beyond, moved)
    _move_plane(cell, way, look, ABOVE, beyond, moved)
    length, x, y, d = look[LENGTH], look[BY_X], look[BY_Y], look[BY_D]
    off = ball + rounding_error(look[SIZE], OPERATIONS)
    nearest = _least_over_cell(cell, length, x, y, d, middle) - off - look[ERROR_BELOW]
    farthest = _least_over_cell(cell, -length, -x, -y, -d, middle) - off - look[ERROR_ABOVE]
    moved[NEAR], moved[FAR] = max(near, nearest), min(far, -farthest)
    if moved[NEAR] > moved[FAR] or not close_cell(moved):
        return EMPTY
    return LEFT


@kernel(borrows=True)
def read_cell(cell: np.ndarray, way: np.ndarray, look: np.ndarray) -> bool:
    """
    Cut a cell by a distance after a way; return whether anything is left.

    `way[FIRST]` and `way[SECOND]` are its bounds. It becomes two planes, and the sharper ones at
    the middle are kept.
    """
    if not _look(cell, way, look) or look[BY_D] < LEAST_ALONG:
        return True
    by_d, middle, length = look[BY_D], look[MIDDLE], look[LENGTH]
    by_x, by_y = -look[BY_X] / by_d, -look[BY_Y] / by_d
    slack = rounding_error(look[SIZE] + way[FIRST], OPERATIONS)
    low = middle + (way[FIRST] - length - look[ERROR_ABOVE] - way[BALL] - slack) / by_d
    if not _cut(cell, cell[ABOVE] - low + slack, cell[ABOVE + 1] - by_x, cell[ABOVE + 2] - by_y):
        return False
    below = _value_at_middle(cell, cell[BELOW], cell[BELOW + 1], cell[BELOW + 2])
    if _value_at_middle(cell, low, by_x, by_y) > below:
        _set_plane(cell, BELOW, low, by_x, by_y)
    if way[SECOND] < math.inf:
        slack = rounding_error(look[SIZE] + way[SECOND], OPERATIONS)
        high = middle + (way[SECOND] - length + look[ERROR_BELOW] + way[BALL] + slack) / by_d
        below, below_x, below_y = cell[BELOW], cell[BELOW + 1], cell[BELOW + 2]
        if not _cut(cell, high - below + slack, by_x - below_x, by_y - below_y):
            return False
        above = _value_at_middle(cell, cell[ABOVE], cell[ABOVE + 1], cell[ABOVE + 2])
        if _value_at_middle(cell, high, by_x, by_y) < above:
            _set_plane(cell, ABOVE, high, by_x, by_y)
    return close_cell(cell)
