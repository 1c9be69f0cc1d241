# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of the displacements, narrowed by interval Newton steps with more equations than unknowns.

The residuals of the measured pairs need bounds of squared relative displacements. A relative
displacement is known far better than the displacement of either end: a fleet can rotate further
than it can deform. The measured pairs are combined with the multipliers of weighted least squares;
any multipliers give bounds (`linearization`), so these are not rounded outward.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.pave import LEAST_GAIN
from dg_localization.interval.scalars import sub
from dg_localization.interval.simplex import SMALLEST_WIDTH
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    reference_distance_m2,
    set_residuals,
)

LEAST_WIDTH_RATIO = 1e-3
"""Least width as a fraction of the largest width, since the normal equations square it."""


@kernel(borrows=True)
def _invert(matrix: FloatArray) -> bool:
    """Replace a symmetric positive definite matrix by its inverse; return False if singular."""
    size = len(matrix)
    for i in range(size):
        diagonal = matrix[i, i]
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not value > SMALLEST_WIDTH * diagonal:
                    return False
                matrix[i, i] = math.sqrt(value)
            else:
                matrix[i, j] = value / matrix[j, j]
    # The inverse of the factor, below the diagonal; then its product with its transpose.
    for i in range(size):
        matrix[i, i] = 1.0 / matrix[i, i]
        for j in range(i):
            value = 0.0
            for k in range(j, i):
                value -= matrix[i, k] * matrix[k, j]
            matrix[i, j] = value * matrix[i, i]
    for i in range(size):
        for j in range(i + 1):
            value = 0.0
            for k in range(i, size):
                value += matrix[k, i] * matrix[k, j]
            matrix[i, j] = value
    for i in range(size):
        for j in range(i):
            matrix[j, i] = matrix[i, j]
    return True


@kernel
def set_inverse(widths: FloatArray, linear: Linearization, inverse: FloatArray) -> bool:
    """
    Write the least-squares inverse of the gradients, weighted by widths; False if singular.

    Each row, of shape (m,), holds the multipliers that estimate one unknown displacement.
    """
    n_unknowns, n_edges = inverse.shape
    dimension = linear.reference.shape[1]
    # The unknown displacements of both ends of each pair, and the entries of its gradient.
    columns = np.empty((n_edges, 2 * dimension), dtype=np.int64)
    slopes = np.empty((n_edges, 2 * dimension))
    for m in range(n_edges):
        for axis in range(dimension):
            columns[m, axis] = linear.unknowns[linear.edges[m, 0], axis]
            columns[m, dimension + axis] = linear.unknowns[linear.edges[m, 1], axis]
            slopes[m, axis] = linear.gradients[m, axis]
            slopes[m, dimension + axis] = -linear.gradients[m, axis]
    normal = np.zeros((n_unknowns, n_unknowns))
    weights = np.empty(n_edges)
    _set_weights(widths, linear, weights)
    for m in range(n_edges):
        for x in range(2 * dimension):
            for y in range(2 * dimension):
                row, column = columns[m, x], columns[m, y]
                if row >= 0 and column >= 0:
                    normal[row, column] += weights[m] * slopes[m, x] * slopes[m, y]
    if not _invert(normal):
        return False
    for row in range(n_unknowns):
        for m in range(n_edges):
            value = 0.0
            for x in range(2 * dimension):
                if columns[m, x] >= 0:
                    value += slopes[m, x] * normal[row, columns[m, x]]
            inverse[row, m] = weights[m] * value
    return True


@kernel
def _set_weights(widths: FloatArray, linear: Linearization, weights: FloatArray) -> None:
    """Write the weight of each measured pair, which is greater for narrower pairs."""
    scale_m2 = 0.0
    for m in range(len(widths)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        scale_m2 = max(scale_m2, reference_distance_m2(linear.reference, i, j))
    widest = widths.max()
    for m in range(len(widths)):
        width = max(widths[m], LEAST_WIDTH_RATIO * widest)
        width = width / scale_m2 + SMALLEST_WIDTH
        weights[m] = 1.0 / (width * width)


@kernel(inlined=True)
def set_multipliers(
    linear: Linearization,
    inverse: FloatArray,
    i: int,
    j: int,
    target: FloatArray,
    multipliers: FloatArray,
) -> None:
    """Write the multipliers that estimate a function of the displacements of two points."""
    for m in range(len(multipliers)):
        multipliers[m] = 0.0
    for point in (i, j):
        for axis in range(target.shape[1]):
            row = linear.unknowns[point, axis]
            if row >= 0 and target[point, axis] != 0.0:
                for m in range(len(multipliers)):
                    multipliers[m] += target[point, axis] * inverse[row, m]


@kernel(inlined=True)
def leave_out(multipliers: FloatArray, own: int) -> bool:
    """
    Estimate a measured pair by the others alone; return whether they suffice.

    The estimate contains a share of the pair itself, which is removed.
    """
    share = 1.0 - multipliers[own]
    if not share > 0.0:
        return False
    multipliers[own] = 0.0
    for m in range(len(multipliers)):
        multipliers[m] /= share
    return True


NEWTON_STEPS = 3
"""Most interval Newton steps."""


@kernel
def narrow_displacements(box: FloatArray, linear: Linearization, relative: FloatArray) -> bool:
    """
    Narrow the displacements and write the residuals of the measured pairs.

    Each step weighs the pairs by their residuals again, so that a pair with an unbounded square
    spoils no other pair.

    Return False if no placement is left.
    """
    inverse = np.empty((linear.unknowns.max() + 1, len(linear.edges)))
    relative[:, LOWER] = -np.inf
    relative[:, UPPER] = np.inf
    if not _narrow_relative(linear, relative):
        return False
    set_residuals(box, linear, relative)
    for _ in range(NEWTON_STEPS):
        widths = linear.residuals[:, UPPER] - linear.residuals[:, LOWER]
        if not set_inverse(widths, linear, inverse):
            break
        gain = _newton_step(linear, inverse, relative)
        if gain < 0.0 or not _narrow_relative(linear, relative):
            return False
        set_residuals(box, linear, relative)
        if gain < LEAST_GAIN:
            break
    return True


@kernel
def _newton_step(linear: Linearization, inverse: FloatArray, relative: FloatArray) -> float:
    """
    Narrow the displacements of all pairs and points once.

    Return the largest relative gain of a pair; a negative number if no placement is left.
    """
    n_points, dimension = linear.reference.shape
    target = np.zeros((n_points, dimension))
    multipliers = np.empty(len(linear.edges))
    largest_gain = 0.0
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(dimension):
            target[i, axis], target[j, axis] = 1.0, -1.0
            set_multipliers(linear, inverse, i, j, target, multipliers)
            low, high = bound_linear_function(linear, multipliers, target)
            gain = narrow_bounds(relative[m], axis, low, high)
            target[i, axis], target[j, axis] = 0.0, 0.0
            if gain < 0.0:
                return -1.0
            largest_gain = max(largest_gain, gain)
    for i in range(n_points):
        for axis in range(dimension):
            row = linear.unknowns[i, axis]
            if row < 0:
                continue
            target[i, axis] = 1.0
            low, high = bound_linear_function(linear, inverse[row], target)
            target[i, axis] = 0.0
            if narrow_bounds(linear.displacements[i], axis, low, high) < 0.0:
                return -1.0
    return largest_gain


@kernel(borrows=True)
def _narrow_relative(linear: Linearization, relative: FloatArray) -> bool:
    """Narrow the relative displacements of pairs by the displacements of their points."""
    displacements = linear.displacements
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(displacements.shape[2]):
            low, high = sub(
                displacements[i, LOWER, axis],
                displacements[i, UPPER, axis],
                displacements[j, LOWER, axis],
                displacements[j, UPPER, axis],
            )
            if narrow_bounds(relative[m], axis, low, high) < 0.0:
                return False
    return True


@kernel(borrows=True)
def narrow_bounds(bounds: FloatArray, axis: int, low: float, high: float) -> float:
    """Narrow the bounds along one axis; return the relative gain, negative if empty."""
    low = max(low, bounds[LOWER, axis])
    high = min(high, bounds[UPPER, axis])
    if low > high:
        return -1.0
    width = bounds[UPPER, axis] - bounds[LOWER, axis]
    bounds[LOWER, axis] = low
    bounds[UPPER, axis] = high
    return 1.0 - (high - low) / width if width > 0.0 else 0.0
