"""
Linearization of squared distances about a reference placement, exact with its remainder.

Around any reference placement x*, with displacements e_i = x_i - x*_i,

    s_ij(x) = s_ij(x*) + 2 (x*_i - x*_j) . (e_i - e_j) + |e_i - e_j|^2

holds exactly, whatever the displacements. Let g_kl be the gradient of the pair that is sought
and g_m those of the measured pairs m. For any multipliers y_m,

    s_kl = s_kl(x*) + |e_kl|^2 + sum_m y_m (s_m - s_m(x*) - |e_m|^2) + (g_kl - sum_m y_m g_m) . e

so any y gives a bound, and a y that makes the last term vanish a good one. The squares are bounded
with enclosures of the displacements in the frame of a few points. The terms in brackets are the
linearization residuals.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.interval.scalars import add, square, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.coordinates import enclose_in_frame

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
def _components(
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
    length = _components(positions, frame[0], frame[rank + 1], basis, rank, basis[rank])
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
            height = _components(positions, frame[0], c, basis, rank, arm)
            if height / errors[c] > best:
                best = height / errors[c]
                frame[rank + 1] = c
        if best < 0.0:
            return False
        _extend_basis(positions, frame, basis, rank)
    return True


@kernel
def choose_axis(positions: FloatArray, errors: FloatArray, frame: IntArray) -> bool:
    """Choose the first two points of a frame: far apart, known well; False when all coincide."""
    n_points, dimension = positions.shape
    arm = np.empty(dimension)
    basis = np.empty((0, dimension))
    best = 0.0
    for a in range(n_points):
        for b in range(a + 1, n_points):
            length = _components(positions, a, b, basis, 0, arm)
            if length / (errors[a] + errors[b]) > best:
                best = length / (errors[a] + errors[b])
                frame[0], frame[1] = a, b
    return best > 0.0


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
def squared_length(reference: FloatArray, i: int, j: int) -> float:
    """Return s_ij(x*), which the grid makes exact."""
    total = 0.0
    for axis in range(reference.shape[1]):
        difference = reference[i, axis] - reference[j, axis]
        total += difference * difference
    return total


@kernel(inlined=True)
def square_of_difference(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    """Bound |e_i - e_j|^2 from the bounds of both displacements, shape (2, q) each."""
    low = 0.0
    high = 0.0
    for axis in range(first.shape[1]):
        difference = sub(
            first[LOWER, axis], first[UPPER, axis], second[LOWER, axis], second[UPPER, axis]
        )
        low, high = add(low, high, *square(*difference))
    return max(low, 0.0), high


@kernel(inlined=True)
def set_residuals(
    box: FloatArray,
    reference: FloatArray,
    relative: FloatArray,
    edges: IntArray,
    residuals: FloatArray,
) -> None:
    """Write the bounds of s_m - s_m(x*) - |e_m|^2, which is linear in the displacements."""
    for m in range(len(edges)):
        i, j = edges[m, 0], edges[m, 1]
        low = 0.0
        high = 0.0
        for axis in range(reference.shape[1]):
            low, high = add(low, high, *square(relative[m, LOWER, axis], relative[m, UPPER, axis]))
        length = squared_length(reference, i, j)
        residuals[m, LOWER] = down(down(box[LOWER, i, j] - length) - high)
        residuals[m, UPPER] = up(up(box[UPPER, i, j] - length) - max(low, 0.0))


@kernel(borrows=True, watched=True)
def bound_linear_function(
    weights: FloatArray,
    residuals: FloatArray,
    target: FloatArray,
    reference: FloatArray,
    displacements: FloatArray,
    edges: IntArray,
    remainder: FloatArray,
) -> tuple[float, float]:
    """
    Bound a linear function of the displacements by the measured pairs.

    Parameters
    ----------
    weights : ndarray, shape (m,)
        The multipliers y; any numbers, though infinite ones and NaN bound nothing.
    residuals : ndarray, shape (m, 2)
        Bounds of what each measured gradient gives for the displacements.
    target : ndarray, shape (n, q)
        The linear function.
    reference, displacements, edges
        The reference placement, the bounds of the displacements and the measured pairs.
    remainder : ndarray, shape (2, n, q)
        Scratch space.

    Returns
    -------
    tuple of float
        Lower and upper bound of ``(target * e).sum()``.

    """
    n_points, dimension = reference.shape
    for i in range(n_points):
        for axis in range(dimension):
            remainder[LOWER, i, axis] = target[i, axis]
            remainder[UPPER, i, axis] = target[i, axis]
    low = 0.0
    high = 0.0
    for m in range(len(edges)):
        weight = weights[m]
        if weight == 0.0:
            continue
        if not math.isfinite(weight):
            return -math.inf, math.inf
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(dimension):
            term = weight * (2.0 * (reference[i, axis] - reference[j, axis]))
            term_low, term_high = down(term), up(term)
            remainder[LOWER, i, axis] = down(remainder[LOWER, i, axis] - term_high)
            remainder[UPPER, i, axis] = up(remainder[UPPER, i, axis] - term_low)
            remainder[LOWER, j, axis] = down(remainder[LOWER, j, axis] + term_low)
            remainder[UPPER, j, axis] = up(remainder[UPPER, j, axis] + term_high)
        if weight > 0.0:
            low = down(low + down(weight * residuals[m, LOWER]))
            high = up(high + up(weight * residuals[m, UPPER]))
        else:
            low = down(low + down(weight * residuals[m, UPPER]))
            high = up(high + up(weight * residuals[m, LOWER]))
    slack = 0.0
    for i in range(n_points):
        for axis in range(dimension):
            reach = max(-displacements[i, LOWER, axis], displacements[i, UPPER, axis])
            if reach > 0.0:
                left = max(-remainder[LOWER, i, axis], remainder[UPPER, i, axis])
                slack = up(slack + up(left * reach))
    return down(low - slack), up(high + slack)


@kernel
def set_displacements(
    box: FloatArray,
    frame: IntArray,
    reference: FloatArray,
    displacements: FloatArray,
    index: IntArray,
) -> int:
    """
    Bound the displacements and number the unknown ones.

    Returns their number, -1 when no placement is left and -2 when some are unbounded.
    """
    n_points, dimension = reference.shape
    enclosure = enclose_in_frame(box, frame)
    for i in range(n_points):
        for axis in range(dimension):
            low, high = enclosure[i, LOWER, axis], enclosure[i, UPPER, axis]
            if low > high:
                return -1
            if math.isinf(low) or math.isinf(high):
                return -2
            displacements[i, LOWER, axis] = down(low - reference[i, axis])
            displacements[i, UPPER, axis] = up(high - reference[i, axis])
            index[i, axis] = 0
    for corner in range(dimension + 1):
        for axis in range(corner, dimension):
            index[frame[corner], axis] = -1
            displacements[frame[corner], LOWER, axis] = 0.0
            displacements[frame[corner], UPPER, axis] = 0.0
    n_free = 0
    for i in range(n_points):
        for axis in range(dimension):
            if index[i, axis] == 0:
                index[i, axis] = n_free
                n_free += 1
    return n_free
