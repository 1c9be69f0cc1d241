# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Multipliers of the measured pairs, by weighted least squares.

Any multipliers give bounds (`linearization`), so nothing here is rounded outward.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray
from dg_localization.solver.contract.linearization import (
    SMALLEST_WIDTH,
    Linearization,
    reference_distance_m2,
)

LEAST_WIDTH_RATIO = 1e-3
"""No width counts as less than this fraction of the largest: the normal equations square it."""

LEAST_PIVOT = 1e-13
"""A pivot that keeps less than this fraction of its diagonal entry counts as zero."""

LEAST_SHARE = 1e-6
"""A measured pair is bounded by the others when they make up at least this share of it."""


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
def set_inverse(widths: FloatArray, linear: Linearization, inverse: FloatArray) -> bool:
    """
    Write the least-squares inverse of the gradients, weighted by the widths; False: singular.

    Each row, of shape (m,), holds the multipliers that estimate one unknown displacement.
    """
    reference, edges, unknowns = linear.reference, linear.edges, linear.unknowns
    n_unknowns, n_edges = inverse.shape
    dimension = reference.shape[1]
    normal = np.zeros((n_unknowns, n_unknowns))
    weights = np.empty(n_edges)
    _set_weights(widths, linear, weights)
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(dimension):
            slope = 2.0 * (reference[i, axis] - reference[j, axis])
            row_i, row_j = unknowns[i, axis], unknowns[j, axis]
            for other in range(dimension):
                value = weights[m] * slope * 2.0 * (reference[i, other] - reference[j, other])
                column_i, column_j = unknowns[i, other], unknowns[j, other]
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
    for row in range(n_unknowns):
        for m in range(n_edges):
            i, j = edges[m, 0], edges[m, 1]
            value = 0.0
            for axis in range(dimension):
                slope = 2.0 * (reference[i, axis] - reference[j, axis])
                if unknowns[i, axis] >= 0:
                    value += slope * normal[row, unknowns[i, axis]]
                if unknowns[j, axis] >= 0:
                    value -= slope * normal[row, unknowns[j, axis]]
            inverse[row, m] = weights[m] * value
    return True


@kernel
def _set_weights(widths: FloatArray, linear: Linearization, weights: FloatArray) -> None:
    """Write the weight of each measured pair: the narrower it is, the greater."""
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
def set_difference_of_rows(
    inverse: FloatArray, plus: int, minus: int, multipliers: FloatArray
) -> None:
    """Write the multipliers of the difference of two displacements; -1 stands for a known one."""
    for m in range(len(multipliers)):
        multipliers[m] = 0.0
        if plus >= 0:
            multipliers[m] += inverse[plus, m]
        if minus >= 0:
            multipliers[m] -= inverse[minus, m]


@kernel(inlined=True)
def set_multipliers(
    linear: Linearization,
    inverse: FloatArray,
    i: int,
    j: int,
    target: FloatArray,
    multipliers: FloatArray,
) -> None:
    """Write the gradient of a pair and the multipliers that estimate it."""
    for m in range(len(multipliers)):
        multipliers[m] = 0.0
    for axis in range(target.shape[1]):
        slope = 2.0 * (linear.reference[i, axis] - linear.reference[j, axis])
        target[i, axis] = slope
        target[j, axis] = -slope
        for point, coefficient in ((i, slope), (j, -slope)):
            row = linear.unknowns[point, axis]
            if row >= 0:
                for m in range(len(multipliers)):
                    multipliers[m] += coefficient * inverse[row, m]


@kernel(inlined=True)
def leave_out(multipliers: FloatArray, own: int) -> bool:
    """
    Estimate a measured pair by the others alone; return whether they are enough.

    The estimate contains the pair itself with some share, which is taken out.
    """
    share = 1.0 - multipliers[own]
    if not share > LEAST_SHARE:
        return False
    multipliers[own] = 0.0
    for m in range(len(multipliers)):
        multipliers[m] /= share
    return True
