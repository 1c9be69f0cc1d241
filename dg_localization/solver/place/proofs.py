# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The proof that a placement agrees with a problem.

Coordinates are taken as exact. What outward rounding cannot decide is decided in integers or
rationals.
"""

from __future__ import annotations

from fractions import Fraction
import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, square_down, square_up, up
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.pair_bounds import PairBounds, pairs_among
from dg_localization.solver.problem import Problem

UNSURE = 2
"""The sign of a determinant that rounding errors may have turned."""

DETERMINANT_OPERATIONS = 64.0
"""More than a determinant of order 3 takes, from coordinates on."""


@kernel(borrows=True)
def _compare_distances(
    positions: FloatArray, pairs: IntArray, lower: FloatArray, upper: FloatArray
) -> int:
    """
    Compare the squared distances of pairs, with all rounding, with their intervals.

    Returns 1 when all lie inside, -1 when one lies outside, 0 when it is too close to call.
    """
    answer = 1
    for x in range(len(pairs)):
        compared = _compare_distance(positions, pairs[x, 0], pairs[x, 1], lower[x], upper[x])
        if compared < 0:
            return -1
        answer = min(answer, compared)
    return answer


@kernel(inlined=True)
def _compare_distance(positions: FloatArray, i: int, j: int, lower: float, upper: float) -> int:
    """Compare the squared distance of one pair with its interval."""
    low = 0.0
    high = 0.0
    for axis in range(positions.shape[1]):
        difference = abs(positions[i, axis] - positions[j, axis])
        low = down(low + square_down(max(0.0, down(difference))))
        high = up(high + square_up(up(difference)))
    if high < lower or low > upper:
        return -1
    return 0 if low < lower or high > upper else 1


def pairs_lie_within(bounded: PairBounds, positions: FloatArray) -> bool:
    """Prove that the squared distances of some pairs of a finite placement lie in their bounds."""
    answer = _compare_distances(positions, bounded.pairs, bounded.lower, bounded.upper)
    return answer > 0 if answer else _agree_exactly(positions, bounded)


def _agree_exactly(positions: FloatArray, bounded: PairBounds) -> bool:
    """Return whether the squared distances of some pairs lie in their intervals, in integers."""
    ratios = [[x.as_integer_ratio() for x in point] for point in positions.tolist()]
    # Doubles are over powers of two: coordinates are whole numbers of the finest part.
    parts = max((over for point in ratios for _, over in point), default=1)
    whole = [[number * (parts // over) for number, over in point] for point in ratios]
    square = parts * parts
    ends = zip(bounded.pairs.tolist(), bounded.lower.tolist(), bounded.upper.tolist(), strict=True)
    for (i, j), lower, upper in ends:
        squared = sum((x - y) ** 2 for x, y in zip(whole[i], whole[j], strict=True))
        least, over = lower.as_integer_ratio()
        if squared * over < least * square:
            return False
        if upper < math.inf:
            most, over = upper.as_integer_ratio()
            if squared * over > most * square:
                return False
    return True


def lies_in(box: FloatArray, positions: FloatArray) -> bool:
    """
    Prove that a placement lies in a box.

    True is a proof, as that of `agrees`.
    """
    if not np.isfinite(positions).all():
        return False
    n_points = len(positions)
    rows, columns = pairs_among(n_points)
    ends = box[LOWER][rows, columns], box[UPPER][rows, columns]
    return pairs_lie_within(PairBounds(n_points, rows * n_points + columns, *ends), positions)


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
def _set_signs(positions: FloatArray, simplices: IntArray, signs: IntArray) -> bool:
    """Write the sign of every simplex, or UNSURE; return whether all are certain."""
    sure = True
    for x in range(len(simplices)):
        determinant, error = _determinant_and_error(positions, simplices, x)
        if abs(determinant) > error:
            signs[x] = 1 if determinant > 0.0 else -1
        else:
            signs[x] = UNSURE
            sure = False
    return sure


def chirality_signs(positions: FloatArray, simplices: IntArray) -> IntArray:
    """
    Return the exact signs of det[p2 - p1, ..., p(q+1) - p1] of simplices.

    The floating-point determinant decides where it exceeds its forward error; exact rationals
    decide otherwise.
    """
    signs = np.zeros(len(simplices), dtype=np.int64)
    if _set_signs(positions, simplices, signs):
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


def with_known_chirality(problem: Problem, positions: FloatArray) -> FloatArray:
    """
    Return `positions` or their mirror image, whichever has the first known chirality.

    Where some are not finite, they have none and are returned as they are.
    """
    if not np.isfinite(positions).all():
        return positions
    for chirality in problem.chiralities:
        sign = chirality_signs(positions, np.array([chirality.points], dtype=np.int64))[0]
        if sign:
            if sign != chirality.sign:
                positions = positions.copy()
                positions[:, -1] = -positions[:, -1]
            break
    return positions


def agrees(problem: Problem, positions: FloatArray) -> bool:
    """
    Prove that a placement meets every constraint of a problem.

    True is a proof: distances are compared after outward rounding and chiralities by the signs of
    determinants, or both in exact rationals where rounding leaves it open.
    """
    if not (np.isfinite(positions).all() and pairs_lie_within(problem.pairs, positions)):
        return False
    simplices = [
        (*side.face, apex) for side in problem.sides for apex in (side.first, side.second)
    ]
    simplices.extend(chirality.points for chirality in problem.chiralities)
    if not simplices:
        return True
    signs = chirality_signs(positions, np.array(simplices, dtype=np.int64)).tolist()
    for x, side in enumerate(problem.sides):
        # Opposite chiralities of the two simplices mean opposite sides.
        if signs[2 * x] * signs[2 * x + 1] * side.side > 0:
            return False
    of_chiralities = signs[2 * len(problem.sides) :]
    return all(
        sign != -chirality.sign
        for sign, chirality in zip(of_chiralities, problem.chiralities, strict=True)
    )
