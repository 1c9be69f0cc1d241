# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The Procrustes frame of a placement in the plane: the one that turns least against the reference.

A placement may be turned and shifted at will. Turned so that the sum of squares of its
displacements e_i = x_i - x*_i is least, it satisfies two linear equations, exactly:

    sum_i e_i = 0,    sum_i r_i x e_i = 0,    r_i = n x*_i - sum_k x*_k.

In the frame of two points, the displacements of a pair far away are large, because the frame
turns. Here they are small for all pairs at once: one table of linear programs serves all pairs.

**Chords.** Let v = x_i - x_j be a pair of length L that is turned by t against g = x*_i - x*_j.
For any vector w, at the angle a from g,

    w . v = |w| L cos(t - a),    w x v = |w| L sin(t - a),    v = g + e_i - e_j.

The first is a linear function of the displacements that a measured length and bounds of the turn
bound: the chord of the arc where v ends, and the tangent. It is best with a in the middle of the
bounds of the turn, where a chord is closest to its arc. No squares are left out.

**Crossings.** The second one is a row of its own where a turn is bounded by more than the measured
pairs: where the box has been cut in two at one of its values.

**Programs.** With these rows, linear programs bound the second one, and by it the turn. Any
multiple of sum_k r_k x e_k may be added to a linear function, because it is zero here. The first
bounds of the turns come from triangles (`turns`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import rounding_error, sqrt_down, sqrt_up, up
from dg_localization.interval.scalars import add, div, mul, sqrt, square, sub
from dg_localization.interval.trigonometry import angle_between, arcsine, cosine, sine
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.linearization import Linearization
from dg_localization.solver.contract.newton import narrow_bounds
from dg_localization.solver.contract.reference import (
    choose_axis,
    complete_frame,
    point_errors_m,
    reference_distance_m2,
    set_reference,
)

ROUNDINGS = 16.0
"""Those of a coefficient and its magnitude; its sum has as many more as there are terms."""

MOST_TURNED = 1.5
"""In rad, below a quarter turn: a pair turned further against a vector is not bounded by it."""


class ProcrustesFrame(NamedTuple):
    """What is known of the displacements in the Procrustes frame, for the kernels."""

    arms: FloatArray  # (n, 2): r_i, n times the reference relative to its centroid, in m
    turns: FloatArray  # (n, 2, n): bounds of the turn of pair i < j at [i, :, j], in rad


@kernel
def new_procrustes_frame(n_points: int) -> ProcrustesFrame:
    """Allocate a frame in which any pair may be turned by any angle."""
    turned = ProcrustesFrame(np.empty((n_points, 2)), np.empty((n_points, 2, n_points)))
    turned.turns[:, UPPER] = up(math.pi)
    turned.turns[:, LOWER] = -up(math.pi)
    return turned


@kernel
def set_frame(
    box: FloatArray, positions: FloatArray, linear: Linearization, turned: ProcrustesFrame
) -> int:
    """
    Write the reference, the arms and the numbers of the displacements.

    The displacement of one point is zero, because the measured pairs are differences. Along one
    axis that of another point, with the last number, depends on all others (`set_free_rows`).

    Returns
    -------
    int
        The number of free displacements; 0 where there is no frame.

    """
    n_points = len(positions)
    frame = np.full(3, -1)
    basis = np.zeros((2, 2))
    errors_m = point_errors_m(box, np.arange(n_points))
    if not choose_axis(positions, errors_m, frame):
        return 0
    if not complete_frame(positions, errors_m, frame, basis):
        return 0
    if not set_reference(positions, frame, basis, linear.reference):
        return 0
    for axis in range(2):
        total = 0.0
        for i in range(n_points):
            total += linear.reference[i, axis]
        for i in range(n_points):
            turned.arms[i, axis] = n_points * linear.reference[i, axis] - total
    longest, dependent, dependent_axis = 0.0, -1, -1
    for i in range(n_points):
        for axis in range(2):
            if i != frame[0] and abs(turned.arms[i, 1 - axis]) > longest:
                longest, dependent, dependent_axis = abs(turned.arms[i, 1 - axis]), i, axis
    if dependent < 0:
        return 0
    n_free = 0
    for i in range(n_points):
        for axis in range(2):
            linear.unknowns[i, axis] = -1
            if i != frame[0] and (i != dependent or axis != dependent_axis):
                linear.unknowns[i, axis] = n_free
                n_free += 1
    linear.unknowns[dependent, dependent_axis] = n_free
    return n_free


@kernel
def set_free_rows(linear: Linearization, turned: ProcrustesFrame, table: FloatArray) -> None:
    """Write the displacements in terms of the free ones, with sum_k r_k x e_k = 0."""
    n_free = table.shape[1]
    table[:] = 0.0
    own = 0.0
    for k in range(len(turned.arms)):
        for axis, slope in ((0, -turned.arms[k, 1]), (1, turned.arms[k, 0])):
            row = linear.unknowns[k, axis]
            if row == n_free:
                own = slope
            elif row >= 0:
                table[row, row] = 1.0
                table[n_free, row] = -slope
    for c in range(n_free):
        table[n_free, c] /= own


@kernel
def turned_pair(
    linear: Linearization, i: int, j: int, angle_rad: float, vector: FloatArray
) -> None:
    """Write about g of a pair, turned by an angle; any vector serves."""
    x = linear.reference[i, 0] - linear.reference[j, 0]
    y = linear.reference[i, 1] - linear.reference[j, 1]
    cosine_rad, sine_rad = math.cos(angle_rad), math.sin(angle_rad)
    vector[0] = cosine_rad * x - sine_rad * y
    vector[1] = sine_rad * x + cosine_rad * y


@kernel
def middle_of_turn(turned: ProcrustesFrame, i: int, j: int) -> float:
    """Return the middle of the bounds of a turn in rad."""
    return 0.5 * (turned.turns[i, LOWER, j] + turned.turns[i, UPPER, j])


@kernel
def angle_from(linear: Linearization, i: int, j: int, vector: FloatArray) -> tuple[float, float]:
    """Bound the angle from g of a pair to a vector, in rad."""
    x = linear.reference[i, 0] - linear.reference[j, 0]
    y = linear.reference[i, 1] - linear.reference[j, 1]
    return angle_between(x, y, vector[0], vector[1])


@kernel
def product_with_reference(
    linear: Linearization, i: int, j: int, x: float, y: float
) -> tuple[float, float]:
    """Bound the inner product of g of a pair with a vector, in m^2."""
    gx = linear.reference[i, 0] - linear.reference[j, 0]
    gy = linear.reference[i, 1] - linear.reference[j, 1]
    return add(*mul(gx, gx, x, x), *mul(gy, gy, y, y))


@kernel
def norm(vector: FloatArray) -> tuple[float, float]:
    """Bound the length of a vector."""
    return sqrt(*add(*square(vector[0], vector[0]), *square(vector[1], vector[1])))


@kernel
def set_chords(
    box: FloatArray, linear: Linearization, turned: ProcrustesFrame, n_chords: int
) -> None:
    """
    Write the gradients and residuals of the measured pairs and bound the displacements.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; all its upper bounds are finite.
    linear : Linearization
        The measured pairs, i < j, each as often in a row as it has chords.
    turned : ProcrustesFrame
        The frame, with bounds of the turns.
    n_chords : int
        One, in the middle of the bounds of the turn, or three, with the tangents at their ends.

    """
    vector = np.empty(2)
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        direction = middle_of_turn(turned, i, j)
        if m % n_chords == 1:
            direction = turned.turns[i, LOWER, j]
        elif m % n_chords == 2:
            direction = turned.turns[i, UPPER, j]
        turned_pair(linear, i, j, direction, vector)
        for axis in range(2):
            linear.gradients[m, axis] = 2.0 * vector[axis]
        set_chord(box, linear, turned, m)
    _bound_displacements(box, linear, turned)


@kernel
def set_chord(box: FloatArray, linear: Linearization, turned: ProcrustesFrame, m: int) -> None:
    """Write the residual of a measured pair with the gradient it has."""
    i, j, vector = linear.edges[m, 0], linear.edges[m, 1], linear.gradients[m]
    turn = turned.turns[i, LOWER, j], turned.turns[i, UPPER, j]
    along = cosine(*sub(*turn, *angle_from(linear, i, j, vector)))
    length = mul(*norm(vector), sqrt_down(box[LOWER, i, j]), sqrt_up(box[UPPER, i, j]))
    at_reference = product_with_reference(linear, i, j, vector[0], vector[1])
    low, high = sub(*mul(*length, *along), *at_reference)
    linear.residuals[m, LOWER], linear.residuals[m, UPPER] = low, high


@kernel
def set_crossing(
    box: FloatArray, linear: Linearization, turned: ProcrustesFrame, m: int, direction: float
) -> None:
    """Write the gradient and the residual of a row for the bounds of the turn of its pair."""
    i, j, vector = linear.edges[m, 0], linear.edges[m, 1], np.empty(2)
    turned_pair(linear, i, j, direction, vector)
    turn = turned.turns[i, LOWER, j], turned.turns[i, UPPER, j]
    across = sine(*sub(*turn, *angle_from(linear, i, j, vector)))
    length = mul(*norm(vector), sqrt_down(box[LOWER, i, j]), sqrt_up(box[UPPER, i, j]))
    # w x v = v . (w turned by a quarter)
    linear.gradients[m, 0], linear.gradients[m, 1] = -vector[1], vector[0]
    at_reference = product_with_reference(linear, i, j, -vector[1], vector[0])
    low, high = sub(*mul(*length, *across), *at_reference)
    linear.residuals[m, LOWER], linear.residuals[m, UPPER] = low, high


@kernel
def _bound_displacements(box: FloatArray, linear: Linearization, turned: ProcrustesFrame) -> None:
    """
    Bound the displacements of the points: each is the mean of its displacements against all.

    With |g| = d, |v - g|^2 = (L - d)^2 + 2 L d (1 - cos t), and 1 - cos t is at most t^2 / 2
    and 2.
    """
    n_points = len(linear.reference)
    totals_m = np.zeros(n_points)
    for i in range(n_points):
        for j in range(i + 1, n_points):
            g_m2 = reference_distance_m2(linear.reference, i, j)
            distance = sqrt_down(g_m2), sqrt_up(g_m2)
            length = sqrt_down(box[LOWER, i, j]), sqrt_up(box[UPPER, i, j])
            longer_m2 = square(*sub(*length, *distance))[1]
            most_rad = max(-turned.turns[i, LOWER, j], turned.turns[i, UPPER, j])
            bent = min(4.0, up(most_rad * most_rad))
            across_m2 = up(up(length[1] * distance[1]) * bent)
            distance_m = sqrt_up(up(longer_m2 + across_m2))
            totals_m[i] = up(totals_m[i] + distance_m)
            totals_m[j] = up(totals_m[j] + distance_m)
    for i in range(n_points):
        farthest_m = up(totals_m[i] / n_points)
        for axis in range(2):
            linear.displacements[i, LOWER, axis] = -farthest_m
            linear.displacements[i, UPPER, axis] = farthest_m


@kernel
def set_gradient(i: int, j: int, x: float, y: float, target: FloatArray) -> None:
    """Write the gradient of the inner product of e_i - e_j with a vector."""
    target[i, 0], target[i, 1] = x, y
    target[j, 0], target[j, 1] = -x, -y


@kernel
def balance(
    linear: Linearization,
    turned: ProcrustesFrame,
    multipliers: FloatArray,
    target: FloatArray,
) -> float:
    """
    Add y sum_k r_k x e_k, which is zero, to a linear function: as much as its multipliers lack.

    Returns a bound of what the rounding of the gradient adds to the function.
    """
    arms, dependent = turned.arms, linear.unknowns.max()
    lacking, ratio = 0.0, 0.0
    for k in range(len(arms)):
        for axis, slope in ((0, -arms[k, 1]), (1, arms[k, 0])):
            if linear.unknowns[k, axis] == dependent:
                lacking = target[k, axis]
                for m in range(len(multipliers)):
                    if linear.edges[m, 0] == k:
                        lacking -= multipliers[m] * linear.gradients[m, axis]
                    elif linear.edges[m, 1] == k:
                        lacking += multipliers[m] * linear.gradients[m, axis]
                ratio = lacking / slope
    if not math.isfinite(ratio):
        return 0.0
    magnitude = 0.0
    for k in range(len(arms)):
        for axis, slope in ((0, -arms[k, 1]), (1, arms[k, 0])):
            farthest_m = max(
                -linear.displacements[k, LOWER, axis], linear.displacements[k, UPPER, axis]
            )
            magnitude += (abs(target[k, axis]) + abs(ratio * slope)) * farthest_m
            target[k, axis] -= ratio * slope
    return rounding_error(magnitude, 2.0 * len(arms) + ROUNDINGS)


@kernel
def narrow_turn(
    box: FloatArray,
    linear: Linearization,
    turned: ProcrustesFrame,
    i: int,
    j: int,
    vector: FloatArray,
    low: float,
    high: float,
) -> float:
    """Narrow a turn by bounds of w x e_ij; return the relative gain, negative: nothing is left."""
    offset = angle_from(linear, i, j, vector)
    angle = sub(turned.turns[i, LOWER, j], turned.turns[i, UPPER, j], *offset)
    if max(-angle[0], angle[1]) > MOST_TURNED:
        return 0.0
    length = mul(*norm(vector), sqrt_down(box[LOWER, i, j]), sqrt_up(box[UPPER, i, j]))
    if not length[0] > 0.0:
        return 0.0
    # w x g = g . (w turned by a quarter)
    at_reference = product_with_reference(linear, i, j, -vector[1], vector[0])
    least, most = div(*add(low, high, *at_reference), *length)
    return narrow_bounds(turned.turns[i], j, *add(*arcsine(least, most), *offset))
