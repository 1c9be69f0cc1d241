# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The reference placement about which squared distances are linearized, and its frame.

Its coordinates are rounded to a grid, so that their differences and the squares are exact.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray

GRID_BITS = 24
"""Reference coordinates keep this many bits, so that their differences and squares are exact."""

SMALLEST_EXTENT_M = 2.0**-400
LARGEST_EXTENT_M = 2.0**400
"""Between these, squares of multiples of the grid neither underflow nor overflow."""

SMALLEST_WIDTH = 1e-13
"""Exact distances count as having this relative error, so that weights stay finite."""


@kernel(inlined=True)
def _width_m(box: FloatArray, i: int, j: int) -> float:
    """Return about how wide the distance of a pair is, in m."""
    return math.sqrt(box[UPPER, i, j]) - math.sqrt(box[LOWER, i, j])


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


@kernel(inlined=True)
def _extend_basis(positions: FloatArray, frame: IntArray, basis: FloatArray, rank: int) -> None:
    """Write row `rank` of a frame's orthonormal basis, zero where its points are degenerate."""
    length = _orthogonal_part(positions, frame[0], frame[rank + 1], basis, rank, basis[rank])
    for axis in range(positions.shape[1]):
        basis[rank, axis] = basis[rank, axis] / length if length > 0.0 else 0.0


@kernel
def point_errors_m(box: FloatArray, others: IntArray) -> FloatArray:
    """Return how far the distances of each point to some others are open, none of them exact."""
    n_points = box.shape[1]
    errors = np.empty(n_points)
    extent = math.sqrt(box[UPPER].max())
    for i in range(n_points):
        errors[i] = SMALLEST_WIDTH * extent
        for j in others:
            errors[i] += _width_m(box, i, j)
    return errors


@kernel
def choose_axis(positions: FloatArray, errors: FloatArray, frame: IntArray) -> bool:
    """Choose the first two points of a frame: far apart, known well; False when all coincide."""
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
    Choose the points of a frame after its first two; False when there are too few points.

    Every choice is sound. A good one spans a large simplex and is known well.
    """
    n_points, dimension = positions.shape
    arm = np.empty(dimension)
    _extend_basis(positions, frame, basis, 0)
    for rank in range(1, dimension):
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
        _extend_basis(positions, frame, basis, rank)
    return True


@kernel
def set_reference(
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
