# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds by linear programs: of any linear function, and of all pairs in the Procrustes frame.

The multipliers are those of a linear program (`simplex`), so that what is left is close to the
linearized hull; the bounds made with them are rigorous whatever they are (`linearization`).

A length L that is turned by t has w . v = |w| L cos(t - a) for a vector w at the angle a. From
below, w . v itself bounds |w| L. From above, the bounds of the turn are divided into sectors of
about `SECTOR_RAD`: in each, L is at most w . v / (|w| cos(t - a)) for a vector in its middle.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, square_down, square_up, up
from dg_localization.interval.scalars import div, sub
from dg_localization.interval.trigonometry import cosine
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow
from dg_localization.solver.contract.linearization import Linearization, bound_linear_function
from dg_localization.solver.contract.procrustes import (
    MOST_TURNED,
    ProcrustesFrame,
    angle_from,
    balance,
    middle_of_turn,
    narrow_turn,
    norm,
    product_with_reference,
    set_chord,
    set_gradient,
    turned_pair,
)
from dg_localization.solver.contract.reference import reference_distance_m2
from dg_localization.solver.contract.simplex import set_multipliers

LENGTH_TOLERANCE = 0.03
ROUGH_TOLERANCE = 0.2
"""
By which fractions of their widths measured pairs may leave their bounds in the linear programs for
lengths, and in those for turns that serve to bound a length: errors of these are squared.
"""

SECTOR_RAD = 0.2
MOST_SECTORS = 3
"""Width of a sector, and how many there are at most."""

LEAST_EXPLAINED = 0.65
"""The errors are taken to explain at least this fraction of what they do by least squares."""


@kernel
def _solve(
    linear: Linearization,
    table: FloatArray,
    active: IntArray,
    target: FloatArray,
    end: int,
    tolerance: float,
    multipliers: FloatArray,
) -> None:
    """Write the multipliers that bound a linear function of the displacements from one side."""
    n_points, dimension = target.shape
    n_rows, n_columns = table.shape
    sign = 1.0 if end == UPPER else -1.0
    table[n_rows - 2] = 0.0
    for i in range(n_points):
        for axis in range(dimension):
            row = linear.unknowns[i, axis]
            if row >= 0 and target[i, axis] != 0.0:
                for c in range(n_columns):
                    table[n_rows - 2, c] += sign * target[i, axis] * table[row, c]
    set_multipliers(linear, table, active, tolerance, multipliers)
    for m in range(len(multipliers)):
        multipliers[m] *= sign


@kernel
def _explained(multipliers: FloatArray, errors: FloatArray) -> float:
    """Return half the width that the multipliers of one side explain."""
    total = 0.0
    for m in range(len(multipliers)):
        total += 0.5 * abs(multipliers[m]) * errors[m]
    return total


@kernel
def _add_losses(
    linear: Linearization,
    multipliers: FloatArray,
    errors: FloatArray,
    weight: float,
    losses: FloatArray,
) -> None:
    """Add what each row adds to a bound by being wider than its errors."""
    for m in range(len(multipliers)):
        extra = linear.residuals[m, UPPER] - linear.residuals[m, LOWER] - errors[m]
        if extra > 0.0:
            losses[m] += weight * abs(multipliers[m]) * extra


@kernel
def bound_by_program(
    linear: Linearization,
    table: FloatArray,
    active: IntArray,
    target: FloatArray,
    errors: FloatArray,
) -> tuple[float, float, float]:
    """
    Bound a linear function of the displacements, from either side with its own multipliers.

    Returns its bounds, and the mean of the widths that the multipliers of the sides explain.
    """
    multipliers = np.empty(len(linear.edges))
    bounds = np.empty(2)
    explained = 0.0
    for end in range(2):
        _solve(linear, table, active, target, end, LENGTH_TOLERANCE, multipliers)
        explained += _explained(multipliers, errors)
        bounds[end] = bound_linear_function(linear, multipliers, target)[end]
    return bounds[LOWER], bounds[UPPER], explained


@kernel
def _bound_end(
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    target: FloatArray,
    end: int,
    tolerance: float,
    multipliers: FloatArray,
) -> float:
    """
    Bound a linear function of the displacements in the Procrustes frame from one side.

    The multipliers are written.
    """
    _solve(linear, table, active, target, end, tolerance, multipliers)
    balanced = target.copy()
    slack = balance(linear, turned, multipliers, balanced)
    bound = bound_linear_function(linear, multipliers, balanced)[end]
    return up(bound + slack) if end == UPPER else down(bound - slack)


@kernel
def narrow_turns(
    box: FloatArray,
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    pairs: IntArray,
    tolerance: float,
    first_row: int,
    n_chords: int,
) -> float:
    """
    Narrow the turns of some pairs by linear programs.

    Each end is sought in its own direction, where its sine is zero.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    linear : Linearization
        The measured pairs in the Procrustes frame.
    turned : ProcrustesFrame
        The frame, with bounds of the turns.
    table, active
        See `set_table`.
    pairs : ndarray of int, shape (k, 2)
        The pairs, i < j.
    tolerance : float
        See `set_multipliers`.
    first_row : int
        Where the chords of the first pair are among the measured pairs, if the pairs are
        measured and in the same order; their residuals are narrowed at once. -1 for others.
    n_chords : int
        How many rows each measured pair has there.

    Returns
    -------
    float
        The largest relative gain; negative when the box is proved to hold no placement.

    """
    target, vector = np.zeros_like(linear.reference), np.empty(2)
    multipliers = np.empty(len(linear.edges))
    largest_gain = 0.0
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        width = turned.turns[i, UPPER, j] - turned.turns[i, LOWER, j]
        if width > 2.0 * MOST_TURNED:
            continue
        for end in range(2):
            turned_pair(linear, i, j, _direction(turned, i, j, end), vector)
            set_gradient(i, j, -vector[1], vector[0], target)
            bound = _bound_end(linear, turned, table, active, target, end, tolerance, multipliers)
            low, high = (-math.inf, bound) if end == UPPER else (bound, math.inf)
            if narrow_turn(box, linear, turned, i, j, vector, low, high) < 0.0:
                return -1.0
        target[i] = 0.0
        target[j] = 0.0
        new = turned.turns[i, UPPER, j] - turned.turns[i, LOWER, j]
        if width > 0.0:
            largest_gain = max(largest_gain, 1.0 - new / width)
        if first_row >= 0:
            for chord in range(n_chords):
                set_chord(box, linear, turned, first_row + p * n_chords + chord)
    return largest_gain


@kernel
def _direction(turned: ProcrustesFrame, i: int, j: int, end: int) -> float:
    """Return the direction in which an end of a turn is sought, in rad: no more than needed."""
    farthest = MOST_TURNED - (turned.turns[i, UPPER, j] - turned.turns[i, LOWER, j])
    middle, at_end = middle_of_turn(turned, i, j), turned.turns[i, end, j]
    return at_end if farthest > 0.0 else middle


@kernel
def _bound_along(
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    i: int,
    j: int,
    direction: float,
    end: int,
    vector: FloatArray,
    multipliers: FloatArray,
) -> float:
    """
    Bound the product of a pair and its reference, turned to a direction, from one side.

    The turned reference and the multipliers are written.
    """
    target = np.zeros_like(linear.reference)
    turned_pair(linear, i, j, direction, vector)
    set_gradient(i, j, vector[0], vector[1], target)
    bound = _bound_end(linear, turned, table, active, target, end, LENGTH_TOLERANCE, multipliers)
    bound += product_with_reference(linear, i, j, vector[0], vector[1])[end]
    return up(bound) if end == UPPER else down(bound)


@kernel
def _shortest(
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    i: int,
    j: int,
    multipliers: FloatArray,
) -> float:
    """Bound the length of a pair from below, in m; the multipliers are written."""
    frame, vector = (linear, turned, table, active), np.empty(2)
    direction = middle_of_turn(turned, i, j)
    low = max(0.0, _bound_along(*frame, i, j, direction, LOWER, vector, multipliers))
    return div(low, low, *norm(vector))[0]


@kernel
def _longest(
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    i: int,
    j: int,
    first: float,
    last: float,
    multipliers: FloatArray,
) -> float:
    """Bound the length of a pair whose turn is in a sector from above, in m; see `_shortest`."""
    frame, vector = (linear, turned, table, active), np.empty(2)
    direction = 0.5 * (first + last)
    high = _bound_along(*frame, i, j, direction, UPPER, vector, multipliers)
    along = cosine(*sub(first, last, *angle_from(linear, i, j, vector)))[0]
    least = down(along * norm(vector)[0])
    return up(max(high, 0.0) / least) if least > 0.0 else math.inf


@kernel
def narrow_pairs(
    box: FloatArray,
    linear: Linearization,
    turned: ProcrustesFrame,
    table: FloatArray,
    active: IntArray,
    pairs: IntArray,
    errors: FloatArray,
    explained: FloatArray,
    most_excess: float,
    losses: FloatArray,
) -> bool:
    """
    Narrow some pairs of a box in place, in the Procrustes frame.

    Parameters
    ----------
    box, linear, turned, table, active, pairs
        See `narrow_turns`.
    errors : ndarray, shape (m,)
        Width of the measured intervals of the problem in m^2; zero for other rows.
    explained : ndarray, shape (k,)
        What the errors explain of the width of each pair by least squares, in m^2. What they
        explain by linear programs is written, which is less.
    most_excess : float
        A pair that stays wider than so many times what is explained is open.
    losses : ndarray, shape (m,)
        What each row adds to the widths of open pairs, relatively, by being wider than its errors,
        is added here.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    if narrow_turns(box, linear, turned, table, active, pairs, ROUGH_TOLERANCE, -1, 0) < 0.0:
        return False
    multipliers, own = np.empty(len(linear.edges)), np.empty(len(linear.edges))
    for p in range(len(pairs)):
        i, j = pairs[p, 0], pairs[p, 1]
        if not reference_distance_m2(linear.reference, i, j) > 0.0:
            continue
        own[:] = 0.0
        low = _shortest(linear, turned, table, active, i, j, multipliers)
        # In the middle of the turn: near its ends the errors may explain far less.
        by_program = 4.0 * _explained(multipliers, errors)
        explained[p] = max(by_program, LEAST_EXPLAINED * explained[p])
        _add_losses(linear, multipliers, errors, 1.0, own)
        width = turned.turns[i, UPPER, j] - turned.turns[i, LOWER, j]
        sectors = int(min(max(1.0, math.ceil(width / SECTOR_RAD)), MOST_SECTORS))
        high = 0.0
        for sector in range(sectors):
            first = turned.turns[i, LOWER, j] + width * sector / sectors
            last = turned.turns[i, LOWER, j] + width * (sector + 1) / sectors
            if sector == sectors - 1:
                last = turned.turns[i, UPPER, j]
            end = _longest(linear, turned, table, active, i, j, first, last, multipliers)
            high = max(high, end)
            _add_losses(linear, multipliers, errors, 1.0 / sectors, own)
        if not narrow(box, i, j, square_down(low), square_up(high)):
            return False
        width_m2 = box[UPPER, i, j] - box[LOWER, i, j]
        if width_m2 > most_excess * explained[p]:
            for m in range(len(losses)):
                losses[m] += own[m] / width_m2
    return True
