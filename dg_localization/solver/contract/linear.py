"""
Contraction by linear combinations of all measured distances at once.

Projections see a few points at a time; where errors run through a chain of them, the bounds they
give are wider than the measurements deserve. Here all measured pairs bound a pair together
(`linearization`). The multipliers are those of least squares, weighted by the errors; they need no
care for rounding. The same identity narrows the displacements first (an interval Newton step for
more equations than unknowns). The paper has no such step; it projects only.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.interval.scalars import sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow
from dg_localization.solver.contract.linearization import (
    SMALLEST_WIDTH,
    bound_linear_function,
    choose_axis,
    complete_frame,
    point_errors_m,
    set_displacements,
    set_reference,
    set_residuals,
    square_of_difference,
    squared_length,
)
from dg_localization.solver.contract.status import Status

NEWTON_STEPS = 3
LEAST_NEWTON_GAIN = 0.1

LEAST_WIDTH_RATIO = 1e-3
"""No width counts as less than this fraction of the largest: the normal equations square it."""

LEAST_PIVOT = 1e-13
"""A pivot that keeps less than this fraction of its diagonal entry counts as zero."""

LEAST_FREEDOM = 1e-6
"""A pair is bounded by the others when they contribute at least this share to its estimate."""


@kernel(borrows=True)
def _invert(matrix: FloatArray) -> bool:
    """Replace a symmetric positive definite matrix by its inverse; False when it is singular."""
    size = len(matrix)
    for i in range(size):
        diagonal = matrix[i, i]
        for j in range(i + 1):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not value > LEAST_PIVOT * diagonal:
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
def set_inverse(
    widths: FloatArray,
    reference: FloatArray,
    edges: IntArray,
    index: IntArray,
    inverse: FloatArray,
) -> bool:
    """
    Write the least-squares inverse of the gradients, weighted by the widths; False: singular.

    Each row holds the multipliers that estimate one free coordinate.
    """
    n_free, n_edges = inverse.shape
    dimension = reference.shape[1]
    normal = np.zeros((n_free, n_free))
    weights = np.empty(n_edges)
    scale = 0.0
    for m in range(n_edges):
        scale = max(scale, squared_length(reference, edges[m, 0], edges[m, 1]))
    widest = widths.max()
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        width = max(widths[m], LEAST_WIDTH_RATIO * widest)
        width = width / scale + SMALLEST_WIDTH
        weights[m] = 1.0 / (width * width)
        for axis in range(dimension):
            slope = 2.0 * (reference[i, axis] - reference[j, axis])
            row_i, row_j = index[i, axis], index[j, axis]
            for other in range(dimension):
                value = weights[m] * slope * 2.0 * (reference[i, other] - reference[j, other])
                column_i, column_j = index[i, other], index[j, other]
                if row_i >= 0 and column_i >= 0:
                    normal[row_i, column_i] += value
                if row_j >= 0 and column_j >= 0:
                    normal[row_j, column_j] += value
                if row_i >= 0 and column_j >= 0:
                    normal[row_i, column_j] -= value
                if row_j >= 0 and column_i >= 0:
                    normal[row_j, column_i] -= value
    if not _invert(normal):
        return False
    for row in range(n_free):
        for m in range(n_edges):
            i, j = edges[m, 0], edges[m, 1]
            value = 0.0
            for axis in range(dimension):
                slope = 2.0 * (reference[i, axis] - reference[j, axis])
                if index[i, axis] >= 0:
                    value += slope * normal[row, index[i, axis]]
                if index[j, axis] >= 0:
                    value -= slope * normal[row, index[j, axis]]
            inverse[row, m] = weights[m] * value
    return True


@kernel(inlined=True)
def _difference(inverse: FloatArray, plus: int, minus: int, weights: FloatArray) -> None:
    """Write the difference of two rows, of which -1 stands for zero."""
    for m in range(len(weights)):
        weights[m] = 0.0
        if plus >= 0:
            weights[m] += inverse[plus, m]
        if minus >= 0:
            weights[m] -= inverse[minus, m]


@kernel(borrows=True)
def _narrow_bounds(bounds: FloatArray, axis: int, low: float, high: float) -> float:
    """Narrow the bounds of a coordinate; return the relative gain, negative where none is left."""
    low = max(low, bounds[LOWER, axis])
    high = min(high, bounds[UPPER, axis])
    if low > high:
        return -1.0
    width = bounds[UPPER, axis] - bounds[LOWER, axis]
    bounds[LOWER, axis] = low
    bounds[UPPER, axis] = high
    return 1.0 - (high - low) / width if width > 0.0 else 0.0


@kernel(borrows=True)
def _narrow_relative(displacements: FloatArray, edges: IntArray, relative: FloatArray) -> bool:
    """Narrow the relative displacements of pairs to what those of their points leave."""
    for m in range(len(edges)):
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(displacements.shape[2]):
            low, high = sub(
                displacements[i, LOWER, axis],
                displacements[i, UPPER, axis],
                displacements[j, LOWER, axis],
                displacements[j, UPPER, axis],
            )
            if _narrow_bounds(relative[m], axis, low, high) < 0.0:
                return False
    return True


@kernel
def narrow_displacements(
    box: FloatArray,
    reference: FloatArray,
    displacements: FloatArray,
    edges: IntArray,
    index: IntArray,
    residuals: FloatArray,
    most_steps: int,
) -> bool:
    """
    Narrow the displacements by interval Newton steps and write what they leave to combine.

    The displacement of one end of a measured pair against the other is what the squares need, and
    is known far better than that of either end: a fleet turns more than it bends. Each step weighs
    the pairs by their residuals anew, so that a pair whose square is not bounded yet spoils no
    other.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2.
    reference : ndarray, shape (n, q)
        The reference placement in m.
    displacements : ndarray, shape (n, 2, q)
        Bounds of the displacements in m; narrowed in place.
    edges : ndarray of int, shape (m, 2)
        The measured pairs.
    index : ndarray of int, shape (n, q)
        The numbers of the free coordinates, -1 for those that the frame holds.
    residuals : ndarray, shape (m, 2)
        Where the bounds of the linearization residuals are written, in m^2.
    most_steps : int
        Most steps; they end when one gains little.

    Returns
    -------
    bool
        False when no placement is left.

    """
    n_edges, dimension = len(edges), reference.shape[1]
    inverse = np.empty((index.max() + 1, n_edges))
    relative = np.empty((n_edges, 2, dimension))
    relative[:, LOWER] = -np.inf
    relative[:, UPPER] = np.inf
    if not _narrow_relative(displacements, edges, relative):
        return False
    set_residuals(box, reference, relative, edges, residuals)
    for _ in range(most_steps):
        widths = residuals[:, UPPER] - residuals[:, LOWER]
        if not set_inverse(widths, reference, edges, index, inverse):
            break
        gain = _newton_step(reference, displacements, edges, index, inverse, residuals, relative)
        if gain < 0.0 or not _narrow_relative(displacements, edges, relative):
            return False
        set_residuals(box, reference, relative, edges, residuals)
        if gain < LEAST_NEWTON_GAIN:
            break
    return True


@kernel
def _newton_step(
    reference: FloatArray,
    displacements: FloatArray,
    edges: IntArray,
    index: IntArray,
    inverse: FloatArray,
    residuals: FloatArray,
    relative: FloatArray,
) -> float:
    """
    Narrow the displacements of all pairs and points once.

    Returns the largest relative gain of a pair; a negative number where no placement is left.
    """
    n_points, dimension = reference.shape
    n_edges = len(edges)
    target = np.zeros((n_points, dimension))
    remainder = np.empty((2, n_points, dimension))
    weights = np.empty(n_edges)
    largest_gain = 0.0
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(dimension):
            _difference(inverse, index[i, axis], index[j, axis], weights)
            target[i, axis] = 1.0
            target[j, axis] = -1.0
            low, high = bound_linear_function(
                weights, residuals, target, reference, displacements, edges, remainder
            )
            target[i, axis] = 0.0
            target[j, axis] = 0.0
            gain = _narrow_bounds(relative[m], axis, low, high)
            if gain < 0.0:
                return -1.0
            largest_gain = max(largest_gain, gain)
    for i in range(n_points):
        for axis in range(dimension):
            row = index[i, axis]
            if row < 0:
                continue
            target[i, axis] = 1.0
            low, high = bound_linear_function(
                inverse[row], residuals, target, reference, displacements, edges, remainder
            )
            target[i, axis] = 0.0
            if _narrow_bounds(displacements[i], axis, low, high) < 0.0:
                return -1.0
    return largest_gain


@kernel(inlined=True)
def _set_weights(
    inverse: FloatArray,
    reference: FloatArray,
    index: IntArray,
    k: int,
    other: int,
    target: FloatArray,
    weights: FloatArray,
) -> None:
    """Write the gradient of a pair and the multipliers that estimate it."""
    for m in range(len(weights)):
        weights[m] = 0.0
    for axis in range(reference.shape[1]):
        slope = 2.0 * (reference[k, axis] - reference[other, axis])
        target[k, axis] = slope
        target[other, axis] = -slope
        for point, sign in ((k, slope), (other, -slope)):
            row = index[point, axis]
            if row >= 0:
                for m in range(len(weights)):
                    weights[m] += sign * inverse[row, m]


@kernel
def contract_linear(
    box: FloatArray,
    positions: FloatArray,
    edges: IntArray,
    errors: FloatArray,
    explained: FloatArray,
) -> Status:
    """
    Narrow all pairs of a box by linear combinations of the measured ones, in place.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; all its upper bounds are finite.
    positions : ndarray, shape (n, q)
        A placement in or near the box, in m; any placement is sound.
    edges : ndarray of int, shape (m, 2)
        The measured pairs.
    errors : ndarray, shape (m,)
        Width of the measured intervals of the problem in m^2.
    explained : ndarray, shape (n, n)
        Where the width that the errors explain to first order is written, in m^2.

    Returns
    -------
    Status
        ``EMPTY`` when the box is proved to hold no placement, ``CONTRACTED``, or ``NOT_RIGID``
        where the measured pairs do not make the placement rigid.

    """
    n_points, dimension = positions.shape
    n_edges = len(edges)
    frame = np.full(dimension + 1, -1)
    basis = np.zeros((dimension, dimension))
    reference = np.empty((n_points, dimension))
    errors_m = point_errors_m(box, np.arange(n_points))
    if not choose_axis(positions, errors_m, frame):
        return Status.NOT_RIGID
    if not complete_frame(positions, errors_m, frame, basis):
        return Status.NOT_RIGID
    if not set_reference(positions, frame, basis, reference):
        return Status.NOT_RIGID
    displacements = np.empty((n_points, 2, dimension))
    index = np.empty((n_points, dimension), dtype=np.int64)
    n_free = set_displacements(box, frame, reference, displacements, index)
    if n_free == -1:
        return Status.EMPTY
    if n_free < 0 or n_edges < n_free:
        return Status.NOT_RIGID
    inverse = np.empty((n_free, n_edges))
    widths = np.empty(n_edges)
    for m in range(n_edges):
        widths[m] = box[UPPER, edges[m, 0], edges[m, 1]] - box[LOWER, edges[m, 0], edges[m, 1]]
    if not set_inverse(widths, reference, edges, index, inverse):
        return Status.NOT_RIGID
    residuals = np.empty((n_edges, 2))
    if not narrow_displacements(
        box, reference, displacements, edges, index, residuals, NEWTON_STEPS
    ):
        return Status.EMPTY

    target = np.zeros((n_points, dimension))
    remainder = np.empty((2, n_points, dimension))
    weights = np.empty(n_edges)
    edge_of = np.full((n_points, n_points), -1)
    for m in range(n_edges):
        edge_of[edges[m, 0], edges[m, 1]] = edge_of[edges[m, 1], edges[m, 0]] = m
    for k in range(n_points):
        for other in range(k + 1, n_points):
            _set_weights(inverse, reference, index, k, other, target, weights)
            width = 0.0
            for m in range(n_edges):
                width += abs(weights[m]) * errors[m]
            explained[k, other] = explained[other, k] = width
            own = edge_of[k, other]
            estimable = True
            if own >= 0:
                # What the other pairs say of a measured one: its own share is taken out.
                freedom = 1.0 - weights[own]
                estimable = freedom > LEAST_FREEDOM
                if estimable:
                    weights[own] = 0.0
                    for m in range(n_edges):
                        weights[m] /= freedom
            # Rounding apart, what the combination can give; most often no gain in a wide box.
            promise = 0.0
            for m in range(n_edges):
                promise += abs(weights[m]) * (residuals[m, UPPER] - residuals[m, LOWER])
            if estimable and promise < box[UPPER, k, other] - box[LOWER, k, other]:
                low, high = bound_linear_function(
                    weights, residuals, target, reference, displacements, edges, remainder
                )
                square_low, square_high = square_of_difference(
                    displacements[k], displacements[other]
                )
                length = squared_length(reference, k, other)
                low = down(down(low + square_low) + length)
                high = up(up(high + square_high) + length)
                if not narrow(box, k, other, low, high):
                    return Status.EMPTY
            for axis in range(dimension):
                target[k, axis] = 0.0
                target[other, axis] = 0.0
    return Status.CONTRACTED
