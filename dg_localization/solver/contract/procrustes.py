# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The Procrustes frame of a placement in the plane: the one that turns least against the reference.

A placement may be turned and shifted at will. Turned so that the sum of squares of its
displacements e_i = x_i - x*_i is stationary, it satisfies two linear equations, exactly:

    sum_i e_i = 0,    sum_i r_i x e_i = 0,    r_i = n x*_i - sum_k x*_k.

In the frame of two points, the displacements of a pair far away are large, because the frame
turns. Here they are small for all pairs at once, and so are the squares that a linearization
lacks: one table of linear programs serves all pairs.

**First bound.** Let e' be the displacements in the frame of some points, and

    T = sum_i r_i x e'_i,    D = sum_i r_i . e'_i,    S = sum_i r_i . x*_i.

The turn from that frame to this one has the sine T / R and the cosine (S + D) / R, where R^2 is
T^2 + (S + D)^2. With g = x*_i - x*_j and e'_ij = e'_i - e'_j, the part of e_ij across g follows:

    R (g x e_ij) = (g x e'_ij) (S + D) - (g . g + g . e'_ij) T
                 = S h + (y S - g . g) T + (g x e'_ij) D - (g . e'_ij) T,    h = g x e'_ij - y T

for any y. With y near g . g / S, a turn of all points does not change the linear function h, so
the measured pairs bound it well, and the rest is of second order.

**Newton steps.** For the same reason they bound g x e_ij = g x e_ij - y sum_k r_k x e_k here. With
c = g x e_ij and s the squared distance, (g . g) s = (g . g + g . e_ij)^2 + c^2, which gives
the linear part g . e_ij and the square |e_ij|^2; and e_i is the mean of the e_ij over all j.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, sqrt_down, sqrt_up, up
from dg_localization.interval.scalars import add, div, intersection, mul, sqrt, square, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.frame_choice import choose_frame
from dg_localization.solver.contract.least_squares import set_inverse
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
)
from dg_localization.solver.contract.newton import narrow_bounds, narrow_displacements
from dg_localization.solver.contract.reference import reference_distance_m2

MOST_STEPS = 10
"""Interval Newton steps in the frame of points."""

ROUNDINGS_OF_GRADIENT = 16.0
"""Two of each of four coefficients, and those of their magnitude."""

EMPTY, NOT_BOUNDED, BOUNDED = -1, 0, 1
"""No placement is left; there is no bound of the displacements; there is one."""


class ProcrustesFrame(NamedTuple):
    """What is known of the displacements in the Procrustes frame, for the kernels."""

    arms: FloatArray  # (n, 2): r_i, n times the reference relative to its centroid, in m
    moment: FloatArray  # (2,): bounds of S in m^2
    across: FloatArray  # (n, 2, n): bounds of g x e_ij at [i, :, j] for i < j, in m^2
    along: FloatArray  # (n, 2, n): bounds of g . e_ij, likewise
    is_ahead: NDArray[np.bool_]  # (n, n): whether g . (g + e_ij) is proved to be positive, i < j


@kernel
def new_procrustes_frame(n_points: int) -> ProcrustesFrame:
    """Allocate the arrays of a frame."""
    return ProcrustesFrame(
        np.empty((n_points, 2)),
        np.empty(2),
        np.empty((n_points, 2, n_points)),
        np.empty((n_points, 2, n_points)),
        np.zeros((n_points, n_points), dtype=np.bool_),
    )


@kernel
def bound_displacements(
    box: FloatArray, positions: FloatArray, linear: Linearization, turned: ProcrustesFrame
) -> int:
    """
    Bound the displacements in the Procrustes frame and the residuals of the measured pairs.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; all its upper bounds are finite.
    positions : ndarray, shape (n, 2)
        A placement in or near the box, in m; any placement is sound.
    linear : Linearization
        As it was allocated, with the measured pairs; all else is written.
    turned : ProcrustesFrame
        As it was allocated; it is written.

    Returns
    -------
    int
        ``EMPTY`` when the box is proved to hold no placement, ``NOT_BOUNDED`` or ``BOUNDED``.

    """
    n_unknowns = choose_frame(box, positions, linear)
    if n_unknowns == -1:
        return EMPTY
    if n_unknowns < 1 or len(linear.edges) < n_unknowns:
        return NOT_BOUNDED
    if not narrow_displacements(box, linear, MOST_STEPS):
        return EMPTY
    inverse = np.empty((n_unknowns, len(linear.edges)))
    _set_arms(linear.reference, turned)
    if not set_inverse(linear.residuals[:, UPPER] - linear.residuals[:, LOWER], linear, inverse):
        return NOT_BOUNDED
    if not _turn(box, linear, inverse, turned) or not complete_bounds(box, linear, turned):
        return EMPTY
    return BOUNDED if np.isfinite(linear.displacements).all() else NOT_BOUNDED


@kernel
def _set_arms(reference: FloatArray, turned: ProcrustesFrame) -> None:
    """Write the r_i, which the grid of the reference makes exact, and bound S."""
    n_points = len(reference)
    low, high = 0.0, 0.0
    for axis in range(2):
        total = 0.0
        for i in range(n_points):
            total += reference[i, axis]
        for i in range(n_points):
            turned.arms[i, axis] = n_points * reference[i, axis] - total
            product = turned.arms[i, axis] * reference[i, axis]
            low, high = add(low, high, down(product), up(product))
    turned.moment[LOWER], turned.moment[UPPER] = low, high


@kernel
def _by_displacements(linear: Linearization, target: FloatArray) -> tuple[float, float]:
    """Bound a linear function by the bounds of the displacements alone."""
    n_points, dimension = target.shape
    low, high = 0.0, 0.0
    for i in range(n_points):
        for axis in range(dimension):
            slope = target[i, axis]
            if slope != 0.0:
                ends = linear.displacements[i, LOWER, axis], linear.displacements[i, UPPER, axis]
                low, high = add(low, high, *mul(slope, slope, ends[0], ends[1]))
    return low, high


@kernel
def _by_least_squares(
    linear: Linearization, inverse: FloatArray, target: FloatArray
) -> tuple[float, float]:
    """Bound a linear function by the measured pairs."""
    n_points, dimension = target.shape
    multipliers = np.zeros(len(linear.edges))
    for i in range(n_points):
        for axis in range(dimension):
            row = linear.unknowns[i, axis]
            if row >= 0 and target[i, axis] != 0.0:
                for m in range(len(multipliers)):
                    multipliers[m] += target[i, axis] * inverse[row, m]
    return bound_linear_function(linear, multipliers, target)


@kernel
def _by_both(
    linear: Linearization, inverse: FloatArray, target: FloatArray
) -> tuple[float, float]:
    """Bound a linear function by the displacements and by the measured pairs."""
    return intersection(
        *_by_displacements(linear, target), *_by_least_squares(linear, inverse, target)
    )


@kernel
def set_free_across(
    linear: Linearization, turned: ProcrustesFrame, i: int, j: int, target: FloatArray
) -> tuple[float, float]:
    """
    Write the gradient of g x e_ij - y sum_k r_k x e_k.

    Returns y, and a bound of what the rounding of the gradient adds to the function.
    """
    n_points = len(target)
    gradient = np.zeros((2, 2))
    gradient[0, 0] = -(linear.reference[i, 1] - linear.reference[j, 1])
    gradient[0, 1] = linear.reference[i, 0] - linear.reference[j, 0]
    gradient[1] = -gradient[0]
    ratio = reference_distance_m2(linear.reference, i, j) / turned.moment[UPPER]
    for k in range(n_points):
        target[k, 0] = ratio * turned.arms[k, 1]
        target[k, 1] = -ratio * turned.arms[k, 0]
    magnitude = 0.0
    for end, k in ((0, i), (1, j)):
        for axis in range(2):
            farthest_m = max(
                -linear.displacements[k, LOWER, axis], linear.displacements[k, UPPER, axis]
            )
            magnitude += (abs(target[k, axis]) + abs(gradient[end, axis])) * farthest_m
            target[k, axis] += gradient[end, axis]
    # Those of the other points are rounded once, which the bound of the function allows for.
    return ratio, rounding_error(magnitude, ROUNDINGS_OF_GRADIENT)


@kernel
def _set_gradients(
    reference: FloatArray, i: int, j: int, along: FloatArray, across: FloatArray
) -> None:
    """Write the gradients of g . e_ij and of g x e_ij, which the grid makes exact."""
    along[:] = 0.0
    across[:] = 0.0
    for k, sign in ((i, 1.0), (j, -1.0)):
        along[k, 0] = sign * (reference[i, 0] - reference[j, 0])
        along[k, 1] = sign * (reference[i, 1] - reference[j, 1])
        across[k, 0], across[k, 1] = -along[k, 1], along[k, 0]


@kernel
def _turn(
    box: FloatArray, linear: Linearization, inverse: FloatArray, turned: ProcrustesFrame
) -> bool:
    """Turn the displacements from a frame of points into this one; False: nothing is left."""
    reference = linear.reference
    n_points = len(reference)
    gradient_along, gradient_across = np.empty((n_points, 2)), np.empty((n_points, 2))
    gradient_across[:, 0], gradient_across[:, 1] = -turned.arms[:, 1], turned.arms[:, 0]
    turning, multipliers = np.empty(len(linear.edges)), np.empty(len(linear.edges))
    _set_turning(linear, inverse, turned, turning)
    turn = _by_both(linear, inverse, gradient_across)
    stretch = _by_both(linear, inverse, turned.arms)
    moment = turned.moment[LOWER], turned.moment[UPPER]
    whole = add(*moment, *stretch)
    radius = sqrt(*add(*square(*turn), *square(*whole)))
    if turn[0] > turn[1] or stretch[0] > stretch[1]:
        return False
    for i in range(n_points):
        for j in range(i + 1, n_points):
            s_m2 = reference_distance_m2(reference, i, j)
            ratio, slack = set_free_across(linear, turned, i, j, gradient_across)
            _set_multipliers(linear, inverse, turning, ratio, i, j, multipliers)
            low, high = bound_linear_function(linear, multipliers, gradient_across)
            free = down(low - slack), up(high + slack)
            _set_gradients(reference, i, j, gradient_along, gradient_across)
            along = _by_both(linear, inverse, gradient_along)
            across = _by_both(linear, inverse, gradient_across)
            if along[0] > along[1] or across[0] > across[1]:
                return False
            length = add(s_m2, s_m2, *along)
            ahead = add(*mul(*length, *whole), *mul(*across, *turn))
            turned.is_ahead[i, j] = ahead[0] > 0.0
            most_m2 = sqrt_up(up(s_m2 * box[UPPER, i, j]))
            turned.across[i, LOWER, j], turned.across[i, UPPER, j] = -most_m2, most_m2
            turned.along[i, LOWER, j], turned.along[i, UPPER, j] = -math.inf, math.inf
            if not radius[0] > 0.0:
                continue
            offset = sub(*mul(ratio, ratio, *moment), s_m2, s_m2)
            first_order = add(*mul(*moment, *free), *mul(*offset, *turn))
            rest = sub(*mul(*across, *stretch), *mul(*along, *turn))
            plain = sub(*mul(*across, *whole), *mul(*length, *turn))
            both = intersection(*add(*first_order, *rest), *plain)
            if both[0] > both[1]:
                return False
            low, high = div(*both, *radius)
            if narrow_bounds(turned.across[i], j, low, high) < 0.0:
                return False
    return True


@kernel
def newton_step(box: FloatArray, linear: Linearization, turned: ProcrustesFrame) -> float:
    """
    Narrow the displacements of all pairs once by the measured ones.

    Returns the largest relative gain; -1 when the box is proved to hold no placement.
    """
    n_points = len(linear.reference)
    widths = linear.residuals[:, UPPER] - linear.residuals[:, LOWER]
    inverse = np.empty((linear.unknowns.max() + 1, len(linear.edges)))
    if not np.isfinite(widths).all() or not set_inverse(widths, linear, inverse):
        return 0.0
    target = np.empty((n_points, 2))
    turning, multipliers = np.empty(len(linear.edges)), np.empty(len(linear.edges))
    _set_turning(linear, inverse, turned, turning)
    largest_gain = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            ratio, slack = set_free_across(linear, turned, i, j, target)
            _set_multipliers(linear, inverse, turning, ratio, i, j, multipliers)
            low, high = bound_linear_function(linear, multipliers, target)
            gain = narrow_bounds(turned.across[i], j, down(low - slack), up(high + slack))
            if gain < 0.0:
                return -1.0
            largest_gain = max(largest_gain, gain)
    return largest_gain if complete_bounds(box, linear, turned) else -1.0


@kernel
def _set_turning(
    linear: Linearization, inverse: FloatArray, turned: ProcrustesFrame, turning: FloatArray
) -> None:
    """Write the multipliers that estimate sum_k r_k x e_k."""
    turning[:] = 0.0
    for k in range(len(turned.arms)):
        for axis, slope in ((0, -turned.arms[k, 1]), (1, turned.arms[k, 0])):
            row = linear.unknowns[k, axis]
            if row >= 0:
                for m in range(len(turning)):
                    turning[m] += slope * inverse[row, m]


@kernel
def _set_multipliers(
    linear: Linearization,
    inverse: FloatArray,
    turning: FloatArray,
    ratio: float,
    i: int,
    j: int,
    multipliers: FloatArray,
) -> None:
    """Write the multipliers that estimate g x e_ij - y sum_k r_k x e_k."""
    for m in range(len(multipliers)):
        multipliers[m] = -ratio * turning[m]
    for k, sign in ((i, 1.0), (j, -1.0)):
        for axis in range(2):
            slope = linear.reference[i, 1 - axis] - linear.reference[j, 1 - axis]
            row = linear.unknowns[k, axis]
            if row >= 0:
                for m in range(len(multipliers)):
                    multipliers[m] += sign * (slope if axis == 1 else -slope) * inverse[row, m]


@kernel
def complete_bounds(box: FloatArray, linear: Linearization, turned: ProcrustesFrame) -> bool:
    """
    Bound all else by the distances of the pairs and g x e_ij; False when nothing is left.

    All else is g . e_ij, the displacements of the points and the residuals of the measured pairs.
    """
    reference, displacements = linear.reference, linear.displacements
    n_points = len(reference)
    totals_m = np.zeros(n_points)
    for i in range(n_points):
        for j in range(i + 1, n_points):
            s_m2 = reference_distance_m2(reference, i, j)
            square_m2 = box[UPPER, i, j]
            if s_m2 > 0.0:
                across = square(turned.across[i, LOWER, j], turned.across[i, UPPER, j])
                product = mul(s_m2, s_m2, box[LOWER, i, j], box[UPPER, i, j])
                low, high = sub(*product, *across)
                if high < 0.0:
                    return False
                low, high = sqrt_down(low), sqrt_up(high)
                if not turned.is_ahead[i, j]:
                    low = -high
                if narrow_bounds(turned.along[i], j, down(low - s_m2), up(high - s_m2)) < 0.0:
                    return False
                along = square(turned.along[i, LOWER, j], turned.along[i, UPPER, j])
                square_m2 = div(*add(*along, *across), s_m2, s_m2)[1]
            distance_m = sqrt_up(square_m2)
            totals_m[i] = up(totals_m[i] + distance_m)
            totals_m[j] = up(totals_m[j] + distance_m)
    for i in range(n_points):
        farthest_m = up(totals_m[i] / n_points)
        for axis in range(2):
            displacements[i, LOWER, axis], displacements[i, UPPER, axis] = -farthest_m, farthest_m
    for m in range(len(linear.edges)):
        i, j = min(linear.edges[m]), max(linear.edges[m])
        at_reference = reference_distance_m2(reference, i, j) == 0.0
        for end in range(2):
            along_m2 = 0.0 if at_reference else turned.along[i, end, j]
            linear.residuals[m, end] = 2.0 * along_m2
    return True
