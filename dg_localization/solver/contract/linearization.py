# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Linearization of squared distances about a reference placement, with its exact remainder.

Around any reference placement x*, with displacements e_i = x_i - x*_i,

    s_ij(x) = s_ij(x*) + 2 (x*_i - x*_j) . (e_i - e_j) + |e_i - e_j|^2

holds exactly for all displacements. Let g_kl be the gradient of the wanted pair and g_m the
gradients of the measured pairs m. For any multipliers y_m,

    s_kl = s_kl(x*) + |e_kl|^2 + sum_m y_m (s_m - s_m(x*) - |e_m|^2) + (g_kl - sum_m y_m g_m) . e

so any y gives a bound, and a y that makes the last term vanish gives a good bound. The squares are
bounded by enclosures of the displacements in the frame of a few points. The terms in brackets are
the linearization residuals.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, up
from dg_localization.interval.scalars import add, square, sub
from dg_localization.interval.simplex import SMALLEST_WIDTH
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow
from dg_localization.solver.contract.coordinates import enclose_in_frame

GRID_BITS = 24
"""Reference coordinates keep this many bits, so that their differences and squares are exact."""

SMALLEST_EXTENT_M = 2.0**-400
LARGEST_EXTENT_M = 2.0**400
"""Between these, squares of multiples of the grid neither underflow nor overflow."""


@kernel(inlined=True)
def _orthogonal_part(
    positions: FloatArray, origin: int, point: int, basis: FloatArray, rank: int, arm: FloatArray
) -> float:
    """Write the part of a point's arm that is orthogonal to a basis; return its length."""
    dimension = positions.shape[1]
    for axis in range(dimension):
        arm[axis] = positions[point, axis] - positions[origin, axis]
    for row in range(rank):
        along = 0.0
        for axis in range(dimension):
            along += arm[axis] * basis[row, axis]
        for axis in range(dimension):
            arm[axis] -= along * basis[row, axis]
    total = 0.0
    for axis in range(dimension):
        total += arm[axis] * arm[axis]
    return math.sqrt(total)


@kernel
def point_errors_m(box: FloatArray, others: IntArray) -> FloatArray:
    """Return the widths of the distances of each point to other points, all above zero."""
    n_points = box.shape[1]
    errors = np.empty(n_points)
    extent = math.sqrt(box[UPPER].max())
    for i in range(n_points):
        errors[i] = SMALLEST_WIDTH * extent
        for j in others:
            errors[i] += math.sqrt(box[UPPER, i, j]) - math.sqrt(box[LOWER, i, j])
    return errors


@kernel
def choose_axis(positions: FloatArray, errors: FloatArray, frame: IntArray) -> bool:
    """Choose two far, well known first points of a frame; return False if all coincide."""
    n_points, dimension = positions.shape
    arm = np.empty(dimension)
    basis = np.empty((0, dimension))
    best = 0.0
    for a in range(n_points):
        for b in range(a + 1, n_points):
            length = _orthogonal_part(positions, a, b, basis, 0, arm)
            if length / (errors[a] + errors[b]) > best:
                best = length / (errors[a] + errors[b])
                frame[0], frame[1] = a, b
    return best > 0.0


@kernel
def complete_frame(
    positions: FloatArray, errors: FloatArray, frame: IntArray, basis: FloatArray
) -> bool:
    """
    Choose the points of a frame after its first two; return False if there are too few.

    Every choice is sound. A good one spans a large simplex and is known well. The rows of its
    orthonormal basis are written, zero where its points are degenerate.
    """
    n_points, dimension = positions.shape
    arm = np.empty(dimension)
    for rank in range(dimension):
        if rank > 0:
            best = -1.0
            for c in range(n_points):
                used = False
                for corner in range(rank + 1):
                    used = used or frame[corner] == c
                if used:
                    continue
                height = _orthogonal_part(positions, frame[0], c, basis, rank, arm)
                if height / errors[c] > best:
                    best = height / errors[c]
                    frame[rank + 1] = c
            if best < 0.0:
                return False
        length = _orthogonal_part(positions, frame[0], frame[rank + 1], basis, rank, arm)
        for axis in range(dimension):
            basis[rank, axis] = arm[axis] / length if length > 0.0 else 0.0
    return True


@kernel
def _set_reference(
    positions: FloatArray, frame: IntArray, basis: FloatArray, reference: FloatArray
) -> bool:
    """Write the placement in its frame, rounded to a grid and zero where the frame demands it."""
    n_points, dimension = positions.shape
    largest = 0.0
    for i in range(n_points):
        for row in range(dimension):
            along = 0.0
            for axis in range(dimension):
                along += (positions[i, axis] - positions[frame[0], axis]) * basis[row, axis]
            if not abs(along) < LARGEST_EXTENT_M:  # NaN as well
                return False
            reference[i, row] = along
            largest = max(largest, abs(along))
    if largest <= SMALLEST_EXTENT_M:
        return False
    mantissa, exponent = math.frexp(largest)
    step = 2.0 ** (exponent - (mantissa == 0.5) - GRID_BITS)
    for i in range(n_points):
        for axis in range(dimension):
            reference[i, axis] = step * math.floor(reference[i, axis] / step + 0.5)
    for corner in range(dimension + 1):
        for axis in range(corner, dimension):
            reference[frame[corner], axis] = 0.0
    return True


@kernel(inlined=True)
def reference_distance_m2(reference: FloatArray, i: int, j: int) -> float:
    """Return s_ij(x*), which the grid makes exact."""
    total = 0.0
    for axis in range(reference.shape[1]):
        difference = reference[i, axis] - reference[j, axis]
        total += difference * difference
    return total


VALUE, MAGNITUDE = 0, 1
"""A sum, and the sum of the absolute values of its terms."""

ROUNDINGS = 4.0
"""Roundings of a term when it is computed, in addition to those of the sum."""


class Linearization(NamedTuple):
    """
    The measured squared distances as linear functions of the displacements, for the kernels.

    The residual of a measured pair, s_m - s_m(x*) - |e_m|^2, is the product of its gradient with
    the relative displacement. Other vectors may serve as gradients, with residuals of their own.
    """

    reference: FloatArray  # (n, q): the reference placement x*, in m
    edges: IntArray  # (m, 2): the measured pairs
    gradients: FloatArray  # (m, q): by the displacement of the first point, in m
    unknowns: IntArray  # (n, q): the index of each unknown displacement, -1 for a known one
    displacements: FloatArray  # (n, 2, q): bounds of the displacements, in m
    residuals: FloatArray  # (m, 2): bounds of the residuals, in m^2
    remainder: FloatArray  # (2, n, q): scratch space, a vector of sums and their magnitudes


@kernel
def linearize(
    box: FloatArray, positions: FloatArray, edges: IntArray, errors_m: FloatArray, frame: IntArray
) -> tuple[Linearization, int]:
    """
    Return the linearization about a placement in a frame with given first two points.

    Also return the number of unknown displacements, or -1 if no placement is left, or -2 if the
    measured pairs do not determine the displacements or a value is out of range.
    """
    n_points, dimension = positions.shape
    linear = Linearization(
        np.empty((n_points, dimension)),
        edges,
        np.empty((len(edges), dimension)),
        np.empty((n_points, dimension), dtype=np.int64),
        np.empty((n_points, 2, dimension)),
        np.empty((len(edges), 2)),
        np.empty((2, n_points, dimension)),
    )
    basis = np.zeros((dimension, dimension))
    if not complete_frame(positions, errors_m, frame, basis):
        return linear, -2
    if not _set_reference(positions, frame, basis, linear.reference):
        return linear, -2
    n_unknowns = _set_displacements(box, frame, linear)
    return linear, n_unknowns if n_unknowns <= len(edges) else -2


@kernel
def _set_displacements(box: FloatArray, frame: IntArray, linear: Linearization) -> int:
    """
    Bound the displacements and index the unknown ones.

    Return their number, -1 if no placement is left, or -2 if some are unbounded.
    """
    reference, unknowns, displacements = linear.reference, linear.unknowns, linear.displacements
    n_points, dimension = reference.shape
    enclosure = enclose_in_frame(box, frame)
    unknowns[:] = 0
    for corner in range(dimension + 1):
        unknowns[frame[corner], corner:] = -1
    n_unknowns = 0
    for i in range(n_points):
        for axis in range(dimension):
            low, high = enclosure[i, LOWER, axis], enclosure[i, UPPER, axis]
            if low > high:
                return -1
            if math.isinf(low) or math.isinf(high):
                return -2
            displacements[i, LOWER, axis] = down(low - reference[i, axis])
            displacements[i, UPPER, axis] = up(high - reference[i, axis])
            if unknowns[i, axis] < 0:
                displacements[i, :, axis] = 0.0
            else:
                unknowns[i, axis] = n_unknowns
                n_unknowns += 1
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(dimension):
            linear.gradients[m, axis] = 2.0 * (reference[i, axis] - reference[j, axis])
    return n_unknowns


@kernel(inlined=True)
def set_residuals(box: FloatArray, linear: Linearization, relative: FloatArray) -> None:
    """Write the residuals, with the relative displacements of the measured pairs, (m, 2, q)."""
    reference, residuals = linear.reference, linear.residuals
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        low = 0.0
        high = 0.0
        for axis in range(reference.shape[1]):
            low, high = add(low, high, *square(relative[m, LOWER, axis], relative[m, UPPER, axis]))
        at_reference_m2 = reference_distance_m2(reference, i, j)
        residuals[m, LOWER] = down(down(box[LOWER, i, j] - at_reference_m2) - high)
        residuals[m, UPPER] = up(up(box[UPPER, i, j] - at_reference_m2) - max(low, 0.0))


@kernel(borrows=True, watched=True)
def bound_linear_function(
    linear: Linearization, multipliers: FloatArray, target: FloatArray
) -> tuple[float, float]:
    """Bound a linear function of the displacements by the measured pairs."""
    residuals, remainder = linear.residuals, linear.remainder
    n_points, dimension = target.shape
    for i in range(n_points):
        for axis in range(dimension):
            remainder[VALUE, i, axis] = target[i, axis]
            remainder[MAGNITUDE, i, axis] = abs(target[i, axis])
    low = 0.0
    high = 0.0
    magnitude = 0.0
    for m in range(len(linear.edges)):
        y = multipliers[m]
        if y == 0.0:
            continue
        if not math.isfinite(y):
            return -math.inf, math.inf
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(dimension):
            term = y * linear.gradients[m, axis]
            remainder[VALUE, i, axis] -= term
            remainder[VALUE, j, axis] += term
            remainder[MAGNITUDE, i, axis] += abs(term)
            remainder[MAGNITUDE, j, axis] += abs(term)
        at_lower, at_upper = y * residuals[m, LOWER], y * residuals[m, UPPER]
        low += min(at_lower, at_upper)
        high += max(at_lower, at_upper)
        magnitude += max(abs(at_lower), abs(at_upper))
    operations = len(linear.edges) + ROUNDINGS
    slack = rounding_error(magnitude, operations)
    for i in range(n_points):
        for axis in range(dimension):
            largest_m = max(
                -linear.displacements[i, LOWER, axis], linear.displacements[i, UPPER, axis]
            )
            if largest_m > 0.0:
                if math.isinf(remainder[MAGNITUDE, i, axis]):
                    return -math.inf, math.inf
                error = rounding_error(remainder[MAGNITUDE, i, axis], operations)
                coefficient = up(abs(remainder[VALUE, i, axis]) + error)
                slack = up(slack + up(coefficient * largest_m))
    if math.isinf(slack):
        return -math.inf, math.inf
    return down(low - slack), up(high + slack)


@kernel(inlined=True)
def narrow_to_linear(
    box: FloatArray, linear: Linearization, i: int, j: int, low: float, high: float
) -> bool:
    """
    Narrow a pair whose linear part lies in [low, high]; return whether anything is left.

    Its value in the reference placement and the square of its relative displacement are added.
    """
    square_low = 0.0
    square_high = 0.0
    for axis in range(linear.reference.shape[1]):
        relative = sub(
            linear.displacements[i, LOWER, axis],
            linear.displacements[i, UPPER, axis],
            linear.displacements[j, LOWER, axis],
            linear.displacements[j, UPPER, axis],
        )
        square_low, square_high = add(square_low, square_high, *square(*relative))
    at_reference_m2 = reference_distance_m2(linear.reference, i, j)
    low = down(down(low + max(square_low, 0.0)) + at_reference_m2)
    high = up(up(high + square_high) + at_reference_m2)
    return narrow(box, i, j, low, high)
