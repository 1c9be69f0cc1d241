# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The proof that a placement agrees with a problem.

Coordinates count as exact. If outward rounding cannot decide, exact rationals do.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from dg_localization.interval.arrays import Interval, determinant, squared_norm
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.pair_bounds import pairs_among
from dg_localization.solver.problem import Problem


def pairs_lie_within(
    pairs: IntArray, lower: FloatArray, upper: FloatArray, positions: FloatArray
) -> bool:
    """Prove that the squared distances of some pairs of a finite placement lie in their bounds."""
    points = Interval.point(positions)
    with np.errstate(over='ignore'):
        squared = squared_norm(points[pairs[:, 0]] - points[pairs[:, 1]])
    if ((squared.upper < lower) | (squared.lower > upper)).any():
        return False
    is_open = (squared.lower < lower) | (squared.upper > upper)
    return all(
        lower[x] <= _exact_squared(positions[pairs[x]]) <= upper[x]
        for x in np.flatnonzero(is_open)
    )


def _exact_squared(ends: FloatArray) -> Fraction:
    """Return the squared distance of two points without rounding."""
    axes = zip(*ends.tolist(), strict=True)
    return sum(((Fraction(x) - Fraction(y)) ** 2 for x, y in axes), Fraction(0))


def lies_in(box: FloatArray, positions: FloatArray) -> bool:
    """
    Prove that a placement lies in a box.

    True is a proof, as in `agrees`.
    """
    if not np.isfinite(positions).all():
        return False
    rows, columns = pairs_among(len(positions))
    ends = box[LOWER, rows, columns], box[UPPER, rows, columns]
    return pairs_lie_within(np.column_stack([rows, columns]), *ends, positions)


def chirality_signs(positions: FloatArray, simplices: IntArray) -> IntArray:
    """
    Return the exact signs of det[p2 - p1, ..., p(q+1) - p1] of simplices.

    Exact rationals decide the signs that outward rounding leaves open.
    """
    corners = Interval.point(positions)[simplices]
    with np.errstate(over='ignore'):
        volumes = determinant(corners[:, 1:] - corners[:, :1])
    signs = (volumes.lower > 0.0).astype(np.int64) - (volumes.upper < 0.0)
    for x in np.flatnonzero(signs == 0):
        exact = [
            [Fraction(value) for value in point] for point in positions[simplices[x]].tolist()
        ]
        edges = [[a - b for a, b in zip(point, exact[0], strict=True)] for point in exact[1:]]
        volume = _exact_determinant(edges)
        signs[x] = (volume > 0) - (volume < 0)
    return signs


def _exact_determinant(rows: list[list[Fraction]]) -> Fraction:
    """Expand a determinant along its first row."""
    if not rows:
        return Fraction(1)
    return sum(
        (
            (-1) ** x * value * _exact_determinant([row[:x] + row[x + 1 :] for row in rows[1:]])
            for x, value in enumerate(rows[0])
        ),
        Fraction(0),
    )


def with_known_chirality(problem: Problem, positions: FloatArray) -> FloatArray:
    """
    Return `positions` or their mirror image, whichever has the first known chirality.

    Positions that are not all finite have none and are returned unchanged.
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
    determinants, or both in exact rationals if rounding leaves them open.
    """
    known = problem.pairs
    if not np.isfinite(positions).all():
        return False
    if not pairs_lie_within(known.pairs, known.lower, known.upper, positions):
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
