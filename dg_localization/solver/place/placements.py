"""
Placements: coordinates inside a box, and the proof that they agree with the measurements.

A first placement comes from the Cholesky factorization of the Gram matrix of the box's middle
(Section 3, Eqs. 1-3). Least squares then pulls it into the intervals. Whether it agrees is
decided afterwards and apart, with outward rounding: nothing here can turn a guess into a proof.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import (
    LARGEST,
    down,
    rounding_error,
    square_down,
    square_up,
    up,
)
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.problem import Problem

MARGIN = 0.1
"""Least squares aims this fraction of an interval's width inside its ends."""

MAX_STEPS = 40

UNSURE = 2
"""The sign of a determinant that rounding errors may have turned."""

DETERMINANT_OPERATIONS = 64.0
"""More than a determinant of order 3 takes, from coordinates on."""


@kernel
def _factor(middle: FloatArray, dimension: int) -> FloatArray:
    """
    Return the first coordinates of the Cholesky factorization of the Gram matrix.

    The pivot of each step is the point farthest from the space spanned so far, which keeps the
    factorization stable and makes points that coincide with the origin harmless.
    """
    n_points = len(middle)
    gram = np.empty((n_points, n_points))
    for i in range(n_points):
        for j in range(n_points):
            gram[i, j] = 0.5 * (middle[0, i] + middle[0, j] - middle[i, j])
    positions = np.zeros((n_points, dimension))
    for axis in range(dimension):
        pivot = 0
        for i in range(n_points):
            if gram[i, i] > gram[pivot, pivot]:
                pivot = i
        length = gram[pivot, pivot]
        if length <= 0.0:
            break
        root = math.sqrt(length)
        for i in range(n_points):
            positions[i, axis] = gram[i, pivot] / root
        for i in range(n_points):
            for j in range(n_points):
                gram[i, j] -= positions[i, axis] * positions[j, axis]
    return positions


@kernel(borrows=True)
def _assemble(
    positions: FloatArray, box: FloatArray, matrix: FloatArray, vector: FloatArray
) -> float:
    """
    Write the normal equations of the misfit of every distance; return its sum of squares.

    Of the symmetric matrix, only the lower triangle is written.
    """
    n_points, dimension = positions.shape
    matrix[:] = 0.0
    vector[:] = 0.0
    total = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            low = box[LOWER, i, j]
            high = box[UPPER, i, j]
            squared = 0.0
            for axis in range(dimension):
                squared += (positions[i, axis] - positions[j, axis]) ** 2
            if not math.isinf(high):
                margin = MARGIN * (high - low)
                low += margin
                high -= margin
            misfit = squared - min(max(squared, low), high)
            # Divided by the distance, so that metres are compared and not their squares.
            weight = 1.0 / max(squared, 0.5 * (low + min(high, squared + low)), 1e-300)
            if misfit == 0.0:
                weight *= 1e-3
            total += weight * misfit * misfit
            for axis in range(dimension):
                row = 2.0 * (positions[i, axis] - positions[j, axis])
                row_i, row_j = i * dimension + axis, j * dimension + axis
                vector[row_i] += weight * misfit * row
                vector[row_j] -= weight * misfit * row
                for other in range(dimension):
                    value = weight * row * 2.0 * (positions[i, other] - positions[j, other])
                    matrix[row_j, i * dimension + other] -= value
                    if other <= axis:
                        matrix[row_i, i * dimension + other] += value
                        matrix[row_j, j * dimension + other] += value
    return total


@kernel(borrows=True)
def _solve_damped(matrix: FloatArray, vector: FloatArray, damping: float) -> bool:
    """
    Solve (matrix + damping) x = vector in place by Cholesky; False when it breaks down.

    Only the lower triangle of the matrix is used. It is factored column by column: the entries
    of a column do not wait for each other.
    """
    size = len(vector)
    for j in range(size):
        pivot = matrix[j, j] + damping
        for k in range(j):
            pivot -= matrix[j, k] * matrix[j, k]
        if pivot <= 0.0:
            return False
        matrix[j, j] = math.sqrt(pivot)
        for i in range(j + 1, size):
            value = matrix[i, j]
            for k in range(j):
                value -= matrix[i, k] * matrix[j, k]
            matrix[i, j] = value / matrix[j, j]
    for i in range(size):
        for k in range(i):
            vector[i] -= matrix[i, k] * vector[k]
        vector[i] /= matrix[i, i]
    for i in range(size - 1, -1, -1):
        for k in range(i + 1, size):
            vector[i] -= matrix[k, i] * vector[k]
        vector[i] /= matrix[i, i]
    return True


@kernel
def refine(positions: FloatArray, box: FloatArray) -> FloatArray:
    """Pull a placement into the intervals of a box by damped least squares."""
    n_points, dimension = positions.shape
    size = n_points * dimension
    matrix, trial_matrix = np.empty((size, size)), np.empty((size, size))
    vector, trial_vector = np.empty(size), np.empty(size)
    factor = np.empty((size, size))
    best = positions.copy()
    damping = 1e-6
    misfit = _assemble(best, box, matrix, vector)
    for _ in range(MAX_STEPS):
        if misfit == 0.0:
            break
        scale = 0.0
        for i in range(size):
            scale = max(scale, matrix[i, i])
        factor[:] = matrix
        step = vector.copy()
        if not _solve_damped(factor, step, damping * scale + 1e-300):
            break
        trial = best - step.reshape((n_points, dimension))
        trial_misfit = _assemble(trial, box, trial_matrix, trial_vector)
        if trial_misfit < misfit:
            if trial_misfit > 0.999999 * misfit:
                break
            best = trial
            misfit = trial_misfit
            matrix, trial_matrix = trial_matrix, matrix
            vector, trial_vector = trial_vector, vector
            damping = max(0.1 * damping, 1e-12)
        else:
            damping *= 10.0
            if damping > 1e3:
                break
    return best


@kernel
def place(box: FloatArray, dimension: int) -> FloatArray:
    """
    Return the coordinates of a placement near or in a box, with no claim that it is inside.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; its upper bounds are finite, or overflowed.
    dimension : int
        The dimension q of the space.

    Returns
    -------
    ndarray, shape (n, q)
        Coordinates in m, of either handedness.

    """
    # The squares of squared distances must not overflow; a power of two changes no digit.
    finite = np.minimum(box, LARGEST)
    _, exponent = math.frexp(finite[UPPER].max())
    half = max(0, exponent) // 2
    scaled = finite * math.ldexp(1.0, -2 * half)
    middle = 0.5 * (scaled[LOWER] + scaled[UPPER])
    return refine(_factor(middle, dimension), scaled) * math.ldexp(1.0, half)


@kernel(borrows=True)
def _compare_distances(positions: FloatArray, lower: FloatArray, upper: FloatArray) -> int:
    """
    Compare every squared distance, with all rounding, with its interval.

    Returns 1 when all lie inside, -1 when one lies outside or a coordinate is not finite, 0
    when it is too close to call.
    """
    n_points, dimension = positions.shape
    answer = 1
    for i in range(n_points):
        for axis in range(dimension):
            if not math.isfinite(positions[i, axis]):
                return -1
    for i in range(n_points):
        for j in range(i + 1, n_points):
            low = 0.0
            high = 0.0
            for axis in range(dimension):
                difference = abs(positions[i, axis] - positions[j, axis])
                low = down(low + square_down(max(0.0, down(difference))))
                high = up(high + square_up(up(difference)))
            if high < lower[i, j] or low > upper[i, j]:
                return -1
            if low < lower[i, j] or high > upper[i, j]:
                answer = 0
    return answer


def _distances_agree(problem: Problem, positions: FloatArray) -> bool:
    """Tell whether every squared distance of a placement lies in its interval, exactly."""
    answer = _compare_distances(positions, problem.lower, problem.upper)
    if answer != 0:
        return bool(answer > 0)
    exact = [[Fraction(x) for x in point] for point in positions.tolist()]
    # A fraction compares exactly with a float of Python, infinity included.
    lower, upper = problem.lower.tolist(), problem.upper.tolist()
    for i, j in combinations(range(problem.n_points), 2):
        squared = sum((x - y) ** 2 for x, y in zip(exact[i], exact[j], strict=True))
        if not lower[i][j] <= squared <= upper[i][j]:
            return False
    return True


@kernel
def _determinant_and_error(
    positions: FloatArray, simplices: IntArray, x: int
) -> tuple[float, float]:
    """
    Return the determinant of a simplex's edges and a bound of its forward error.

    The error grows with the permanent of the absolute values. What products that underflow lose
    is multiplied by an edge afterwards.
    """
    dimension = positions.shape[1]
    edges = np.empty((dimension, dimension))
    for row in range(dimension):
        for axis in range(dimension):
            edges[row, axis] = (
                positions[simplices[x, row + 1], axis] - positions[simplices[x, 0], axis]
            )
    if dimension == 1:
        return edges[0, 0], rounding_error(abs(edges[0, 0]), DETERMINANT_OPERATIONS)
    if dimension == 2:
        first, second = edges[0, 0] * edges[1, 1], edges[0, 1] * edges[1, 0]
        error = rounding_error(abs(first) + abs(second), DETERMINANT_OPERATIONS)
        return first - second, error
    determinant = 0.0
    permanent = 0.0
    longest = 1.0
    for a in range(3):
        b, c = (a + 1) % 3, (a + 2) % 3
        first, second = edges[1, b] * edges[2, c], edges[1, c] * edges[2, b]
        determinant += edges[0, a] * (first - second)
        permanent += abs(edges[0, a]) * (abs(first) + abs(second))
        longest = max(longest, abs(edges[0, a]))
    error = rounding_error(permanent, DETERMINANT_OPERATIONS)
    return determinant, error + longest * rounding_error(0.0, DETERMINANT_OPERATIONS)


@kernel
def _set_orientations(positions: FloatArray, simplices: IntArray, signs: IntArray) -> bool:
    """Write the sign of every simplex, or UNSURE; tell whether rounding may have turned none."""
    sure = True
    for x in range(len(simplices)):
        determinant, error = _determinant_and_error(positions, simplices, x)
        if abs(determinant) > error:
            signs[x] = 1 if determinant > 0.0 else -1
        else:
            signs[x] = UNSURE
            sure = False
    return sure


def orientations(positions: FloatArray, simplices: IntArray) -> IntArray:
    """
    Return the exact signs of det[p2 - p1, ..., p(q+1) - p1] of simplices.

    The floating-point determinant decides where it exceeds its forward error; exact rationals
    decide otherwise.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        Coordinates in m, taken as exact.
    simplices : ndarray of int, shape (k, q + 1)
        The corners of each simplex.

    Returns
    -------
    ndarray of int, shape (k,)
        -1, 0 or +1 each; 0 when the points lie in one hyperplane.

    """
    signs = np.zeros(len(simplices), dtype=np.int64)
    if _set_orientations(positions, simplices, signs):
        return signs
    for x in np.flatnonzero(signs == UNSURE):
        corners = positions[simplices[x]].tolist()
        exact = [[Fraction(value) for value in corner] for corner in corners]
        edges = [[a - b for a, b in zip(point, exact[0], strict=True)] for point in exact[1:]]
        determinant = _exact_determinant(edges)
        signs[x] = (determinant > 0) - (determinant < 0)
    return signs


def _exact_determinant(rows: list[list[Fraction]]) -> Fraction:
    """Expand a determinant of size 1, 2 or 3."""
    if len(rows) == 1:
        return rows[0][0]
    if len(rows) == 2:
        return rows[0][0] * rows[1][1] - rows[0][1] * rows[1][0]
    (a, b, c), (d, e, f), (g, h, i) = rows
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def with_handedness(problem: Problem, positions: FloatArray) -> FloatArray:
    """Return `positions` or their mirror image, whichever has the problem's first chirality."""
    for chirality in problem.chiralities:
        sign = orientations(positions, np.array([chirality.points], dtype=np.int64))[0]
        if sign:
            if sign != chirality.sign:
                positions = positions.copy()
                positions[:, -1] = -positions[:, -1]
            break
    return positions


def agrees(problem: Problem, positions: FloatArray) -> bool:
    """
    Prove that a placement meets every constraint of a problem.

    Parameters
    ----------
    problem : Problem
        The problem.
    positions : ndarray, shape (n, q)
        Coordinates in m, taken as exact.

    Returns
    -------
    bool
        True is a proof: distances are compared after outward rounding and orientations by their
        signs, or both in exact rationals where that is too close to call.

    """
    if not _distances_agree(problem, positions):
        return False
    simplices = [
        (*side.face, apex) for side in problem.sides for apex in (side.first, side.second)
    ]
    simplices.extend(chirality.points for chirality in problem.chiralities)
    if not simplices:
        return True
    signs = orientations(positions, np.array(simplices, dtype=np.int64)).tolist()
    for x, side in enumerate(problem.sides):
        # Opposite orientations of the two simplices mean opposite sides.
        if signs[2 * x] * signs[2 * x + 1] * side.side > 0:
            return False
    of_chiralities = signs[2 * len(problem.sides) :]
    return all(
        sign != -chirality.sign
        for sign, chirality in zip(of_chiralities, problem.chiralities, strict=True)
    )
