# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of the displacements, narrowed by interval Newton steps with more equations than unknowns.

The squares of relative displacements are what the residuals of the measured pairs lack. A relative
displacement is known far better than the displacement of either end: a fleet can be turned
further than it can be deformed.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.scalars import sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.least_squares import set_difference_of_rows, set_inverse
from dg_localization.solver.contract.linearization import (
    Linearization,
    bound_linear_function,
    set_residuals,
)

LEAST_NEWTON_GAIN = 0.1
"""A step that shortens no interval by more than this fraction is the last."""

MOST_TIMES_AS_WIDE = 1.5
"""A bound is not computed where the residuals alone make it this many times as wide as what is
known: it seldom cuts off an end."""


@kernel
def narrow_displacements(
    box: FloatArray, linear: Linearization, relative: FloatArray, most_steps: int
) -> bool:
    """
    Narrow the displacements and write the residuals of the measured pairs.

    Each step weighs the pairs by their residuals anew, so that a pair whose square is not bounded
    yet spoils no other.

    False when no placement is left.
    """
    inverse = np.empty((linear.unknowns.max() + 1, len(linear.edges)))
    relative[:, LOWER] = -np.inf
    relative[:, UPPER] = np.inf
    if not _narrow_relative(linear, relative):
        return False
    set_residuals(box, linear, relative)
    for _ in range(most_steps):
        widths = linear.residuals[:, UPPER] - linear.residuals[:, LOWER]
        if not set_inverse(widths, linear, inverse):
            break
        gain = _newton_step(linear, inverse, relative)
        if gain < 0.0 or not _narrow_relative(linear, relative):
            return False
        set_residuals(box, linear, relative)
        if gain < LEAST_NEWTON_GAIN:
            break
    return True


@kernel
def _newton_step(linear: Linearization, inverse: FloatArray, relative: FloatArray) -> float:
    """
    Narrow the displacements of all pairs and points once.

    Returns the largest relative gain of a pair; a negative number where no placement is left.
    """
    n_points, dimension = linear.reference.shape
    target = np.zeros((n_points, dimension))
    multipliers = np.empty(len(linear.edges))
    largest_gain = 0.0
    for m in range(len(linear.edges)):
        i, j = linear.edges[m, 0], linear.edges[m, 1]
        for axis in range(dimension):
            row_i, row_j = linear.unknowns[i, axis], linear.unknowns[j, axis]
            set_difference_of_rows(inverse, row_i, row_j, multipliers)
            if not _may_gain(linear, multipliers, relative[m], axis):
                continue
            target[i, axis] = 1.0
            target[j, axis] = -1.0
            low, high = bound_linear_function(linear, multipliers, target)
            target[i, axis] = 0.0
            target[j, axis] = 0.0
            gain = narrow_bounds(relative[m], axis, low, high)
            if gain < 0.0:
                return -1.0
            largest_gain = max(largest_gain, gain)
    for i in range(n_points):
        for axis in range(dimension):
            row = linear.unknowns[i, axis]
            if row < 0 or not _may_gain(linear, inverse[row], linear.displacements[i], axis):
                continue
            target[i, axis] = 1.0
            low, high = bound_linear_function(linear, inverse[row], target)
            target[i, axis] = 0.0
            if narrow_bounds(linear.displacements[i], axis, low, high) < 0.0:
                return -1.0
    return largest_gain


@kernel(borrows=True)
def _may_gain(
    linear: Linearization, multipliers: FloatArray, bounds: FloatArray, axis: int
) -> bool:
    """Return whether a combination of residuals is narrow enough to gain on bounds."""
    width = 0.0
    for m in range(len(multipliers)):
        width += abs(multipliers[m]) * (linear.residuals[m, UPPER] - linear.residuals[m, LOWER])
    # Also where nothing is bounded yet, and a width is infinite or NaN.
    return not width > MOST_TIMES_AS_WIDE * (bounds[UPPER, axis] - bounds[LOWER, axis])


@kernel(borrows=True)
def _narrow_relative(linear: Linearization, relative: FloatArray) -> bool:
    """Narrow the relative displacements of pairs to what those of their points leave."""
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
    """Narrow the bounds along one axis; return the relative gain, negative where none are left."""
    low = max(low, bounds[LOWER, axis])
    high = min(high, bounds[UPPER, axis])
    if low > high:
        return -1.0
    width = bounds[UPPER, axis] - bounds[LOWER, axis]
    bounds[LOWER, axis] = low
    bounds[UPPER, axis] = high
    return 1.0 - (high - low) / width if width > 0.0 else 0.0
