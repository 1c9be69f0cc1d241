"""
Contraction by linear combinations of all measured distances at once.

Projections see a few points at a time; where errors run through a chain of them, the bounds they
give are wider than the measurements deserve. Around any reference placement x*, with displacements
e_i = x_i - x*_i,

    s_ij(x) = s_ij(x*) + 2 (x*_i - x*_j) . (e_i - e_j) + |e_i - e_j|^2

holds exactly, whatever the displacements. Let g_kl be the gradient of the pair that is sought
and g_m those of the measured pairs m. For any multipliers y_m,

    s_kl = s_kl(x*) + |e_kl|^2 + sum_m y_m (s_m - s_m(x*) - |e_m|^2) + (g_kl - sum_m y_m g_m) . e

so any y gives a bound, and a y that makes the last term vanish a good one: least squares, weighted
by the errors, and no rigour is asked of it. The squares are bounded with enclosures of the
displacements in the frame of a few points, which the same identity narrows (an interval Newton
step for more equations than unknowns). The paper has no such step; it projects only.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, up
from dg_localization.interval.scalars import add, square, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow
from dg_localization.solver.contract.coordinates import enclose_in_frame
from dg_localization.solver.contract.status import Status

GRID_BITS = 24
"""Reference coordinates keep this many bits, so that their differences and squares are exact."""

SMALLEST_EXTENT_M = 2.0**-400
LARGEST_EXTENT_M = 2.0**400
"""Between these, squares of multiples of the grid neither underflow nor overflow."""

NEWTON_STEPS = 3
LEAST_NEWTON_GAIN = 0.1

SMALLEST_WIDTH = 1e-13
"""Exact distances count as having this relative error, so that weights stay finite."""

LEAST_WIDTH_RATIO = 1e-3
"""No width counts as less than this fraction of the largest: the normal equations square it."""

LEAST_PIVOT = 1e-13
"""A pivot that keeps less than this fraction of its diagonal entry counts as zero."""

LEAST_FREEDOM = 1e-6
"""A pair is bounded by the others when they contribute at least this share to its estimate."""


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
def _choose_frame(
    box: FloatArray, positions: FloatArray, frame: IntArray, basis: FloatArray
) -> bool:
    """
    Choose q + 1 points that span a large simplex and whose distances to all are well known.

    Every choice is sound; this one is good. False when all points coincide.
    """
    n_points, dimension = positions.shape
    error = np.zeros(n_points)
    extent = 0.0
    for i in range(n_points):
        for j in range(n_points):
            if j != i:
                error[i] += _width_m(box, i, j)
                extent = max(extent, math.sqrt(box[UPPER, i, j]))
    for i in range(n_points):
        error[i] += SMALLEST_WIDTH * extent
    arm = np.empty(dimension)
    best = 0.0
    for a in range(n_points):
        for b in range(a + 1, n_points):
            length = _components(positions, a, b, basis, 0, arm)
            if length / (error[a] + error[b]) > best:
                best = length / (error[a] + error[b])
                frame[0], frame[1] = a, b
    if best == 0.0:
        return False
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
            if height / error[c] > best:
                best = height / error[c]
                frame[rank + 1] = c
        if best < 0.0:
            return False
        _extend_basis(positions, frame, basis, rank)
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


@kernel(inlined=True)
def _square_of_difference(first: FloatArray, second: FloatArray) -> tuple[float, float]:
    """Bound |e_i - e_j|^2 from the bounds of both displacements, shape (2, q) each."""
    low = 0.0
    high = 0.0
    for axis in range(first.shape[1]):
        bend = sub(
            first[LOWER, axis], first[UPPER, axis], second[LOWER, axis], second[UPPER, axis]
        )
        low, high = add(low, high, *square(*bend))
    return max(low, 0.0), high


@kernel(inlined=True)
def _squared_length(reference: FloatArray, i: int, j: int) -> float:
    """Return s_ij(x*), which the grid makes exact."""
    total = 0.0
    for axis in range(reference.shape[1]):
        difference = reference[i, axis] - reference[j, axis]
        total += difference * difference
    return total


@kernel(inlined=True)
def _set_surplus(
    box: FloatArray, reference: FloatArray, bends: FloatArray, edges: IntArray, surplus: FloatArray
) -> None:
    """Write the bounds of s_m - s_m(x*) - |e_m|^2, which is linear in the displacements."""
    for m in range(len(edges)):
        i, j = edges[m, 0], edges[m, 1]
        low = 0.0
        high = 0.0
        for axis in range(reference.shape[1]):
            low, high = add(low, high, *square(bends[m, LOWER, axis], bends[m, UPPER, axis]))
        length = _squared_length(reference, i, j)
        surplus[m, LOWER] = down(down(box[LOWER, i, j] - length) - high)
        surplus[m, UPPER] = up(up(box[UPPER, i, j] - length) - max(low, 0.0))


@kernel(borrows=True, watched=True)
def _combine(
    weights: FloatArray,
    surplus: FloatArray,
    target: FloatArray,
    reference: FloatArray,
    moves: FloatArray,
    edges: IntArray,
    residual: FloatArray,
) -> tuple[float, float]:
    """
    Bound a linear function of the displacements by the measured pairs.

    Parameters
    ----------
    weights : ndarray, shape (m,)
        The multipliers y; any numbers, though infinite ones and NaN bound nothing.
    surplus : ndarray, shape (m, 2)
        Bounds of what each measured gradient gives for the displacements.
    target : ndarray, shape (n, q)
        The linear function.
    reference, moves, edges
        The reference placement, the bounds of the displacements and the measured pairs.
    residual : ndarray, shape (2, n, q)
        Scratch space.

    Returns
    -------
    tuple of float
        Lower and upper bound of ``(target * e).sum()``.

    """
    n_points, dimension = reference.shape
    for i in range(n_points):
        for axis in range(dimension):
            residual[LOWER, i, axis] = target[i, axis]
            residual[UPPER, i, axis] = target[i, axis]
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
            residual[LOWER, i, axis] = down(residual[LOWER, i, axis] - term_high)
            residual[UPPER, i, axis] = up(residual[UPPER, i, axis] - term_low)
            residual[LOWER, j, axis] = down(residual[LOWER, j, axis] + term_low)
            residual[UPPER, j, axis] = up(residual[UPPER, j, axis] + term_high)
        if weight > 0.0:
            low = down(low + down(weight * surplus[m, LOWER]))
            high = up(high + up(weight * surplus[m, UPPER]))
        else:
            low = down(low + down(weight * surplus[m, UPPER]))
            high = up(high + up(weight * surplus[m, LOWER]))
    slack = 0.0
    for i in range(n_points):
        for axis in range(dimension):
            reach = max(-moves[i, LOWER, axis], moves[i, UPPER, axis])
            if reach > 0.0:
                left = max(-residual[LOWER, i, axis], residual[UPPER, i, axis])
                slack = up(slack + up(left * reach))
    return down(low - slack), up(high + slack)


@kernel
def _set_moves(
    box: FloatArray, frame: IntArray, reference: FloatArray, moves: FloatArray, index: IntArray
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
            moves[i, LOWER, axis] = down(low - reference[i, axis])
            moves[i, UPPER, axis] = up(high - reference[i, axis])
            index[i, axis] = 0
    for corner in range(dimension + 1):
        for axis in range(corner, dimension):
            index[frame[corner], axis] = -1
            moves[frame[corner], LOWER, axis] = 0.0
            moves[frame[corner], UPPER, axis] = 0.0
    n_free = 0
    for i in range(n_points):
        for axis in range(dimension):
            if index[i, axis] == 0:
                index[i, axis] = n_free
                n_free += 1
    return n_free


@kernel
def _set_inverse(
    box: FloatArray, reference: FloatArray, edges: IntArray, index: IntArray, inverse: FloatArray
) -> bool:
    """Write the error-weighted least-squares inverse of the gradients; False: singular."""
    n_free, n_edges = inverse.shape
    dimension = reference.shape[1]
    normal = np.zeros((n_free, n_free))
    weights = np.empty(n_edges)
    scale = 0.0
    widest = 0.0
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        scale = max(scale, _squared_length(reference, i, j))
        widest = max(widest, box[UPPER, i, j] - box[LOWER, i, j])
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        width = max(box[UPPER, i, j] - box[LOWER, i, j], LEAST_WIDTH_RATIO * widest)
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


@kernel
def _narrow_moves(
    box: FloatArray,
    reference: FloatArray,
    moves: FloatArray,
    edges: IntArray,
    index: IntArray,
    inverse: FloatArray,
    surplus: FloatArray,
) -> bool:
    """
    Narrow the displacements by interval Newton steps and write what they leave to combine.

    The displacement of one end of a measured pair against the other is what the squares need, and
    is known far better than that of either end: a fleet turns more than it bends.
    """
    n_points, dimension = reference.shape
    n_edges = len(edges)
    target = np.zeros((n_points, dimension))
    residual = np.empty((2, n_points, dimension))
    weights = np.empty(n_edges)
    bends = np.empty((n_edges, 2, dimension))
    for m in range(n_edges):
        i, j = edges[m, 0], edges[m, 1]
        for axis in range(dimension):
            bends[m, LOWER, axis], bends[m, UPPER, axis] = sub(
                moves[i, LOWER, axis],
                moves[i, UPPER, axis],
                moves[j, LOWER, axis],
                moves[j, UPPER, axis],
            )
    for _ in range(NEWTON_STEPS):
        _set_surplus(box, reference, bends, edges, surplus)
        gain = 0.0
        for m in range(n_edges):
            i, j = edges[m, 0], edges[m, 1]
            for axis in range(dimension):
                _difference(inverse, index[i, axis], index[j, axis], weights)
                target[i, axis] = 1.0
                target[j, axis] = -1.0
                low, high = _combine(weights, surplus, target, reference, moves, edges, residual)
                target[i, axis] = 0.0
                target[j, axis] = 0.0
                low = max(low, bends[m, LOWER, axis])
                high = min(high, bends[m, UPPER, axis])
                if low > high:
                    return False
                width = bends[m, UPPER, axis] - bends[m, LOWER, axis]
                if width > 0.0:
                    gain = max(gain, 1.0 - (high - low) / width)
                bends[m, LOWER, axis] = low
                bends[m, UPPER, axis] = high
        if gain < LEAST_NEWTON_GAIN:
            break
    _set_surplus(box, reference, bends, edges, surplus)
    for i in range(n_points):
        for axis in range(dimension):
            row = index[i, axis]
            if row < 0:
                continue
            target[i, axis] = 1.0
            low, high = _combine(inverse[row], surplus, target, reference, moves, edges, residual)
            target[i, axis] = 0.0
            moves[i, LOWER, axis] = max(low, moves[i, LOWER, axis])
            moves[i, UPPER, axis] = min(high, moves[i, UPPER, axis])
            if moves[i, LOWER, axis] > moves[i, UPPER, axis]:
                return False
    return True


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
    if not _choose_frame(box, positions, frame, basis):
        return Status.NOT_RIGID
    if not _set_reference(positions, frame, basis, reference):
        return Status.NOT_RIGID
    moves = np.empty((n_points, 2, dimension))
    index = np.empty((n_points, dimension), dtype=np.int64)
    n_free = _set_moves(box, frame, reference, moves, index)
    if n_free == -1:
        return Status.EMPTY
    if n_free < 0 or n_edges < n_free:
        return Status.NOT_RIGID
    inverse = np.empty((n_free, n_edges))
    if not _set_inverse(box, reference, edges, index, inverse):
        return Status.NOT_RIGID
    surplus = np.empty((n_edges, 2))
    if not _narrow_moves(box, reference, moves, edges, index, inverse, surplus):
        return Status.EMPTY

    target = np.zeros((n_points, dimension))
    residual = np.empty((2, n_points, dimension))
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
                promise += abs(weights[m]) * (surplus[m, UPPER] - surplus[m, LOWER])
            if estimable and promise < box[UPPER, k, other] - box[LOWER, k, other]:
                low, high = _combine(weights, surplus, target, reference, moves, edges, residual)
                square_low, square_high = _square_of_difference(moves[k], moves[other])
                length = _squared_length(reference, k, other)
                low = down(down(low + square_low) + length)
                high = up(up(high + square_high) + length)
                if not narrow(box, k, other, low, high):
                    return Status.EMPTY
            for axis in range(dimension):
                target[k, axis] = 0.0
                target[other, axis] = 0.0
    return Status.CONTRACTED
