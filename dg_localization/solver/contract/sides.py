# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Known sides of points in the arrays of the kernels.

One camera that sees q others fixes the chirality of q + 1 points; two chiralities that share a
face F fix a side, sigma_{F;i,k} = -chi(F, i) chi(F, k) (Section 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.interval.scalars import add, mul, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.line import BOTH
from dg_localization.solver.problem import Chirality, Problem

_CHIRALITY_GROUP = 0


class Sides(NamedTuple):
    """
    The known sides of points, sorted by face, for the kernels.

    The rows ``start[f0, f1]`` to ``stop[f0, f1]`` belong to the faces whose two smallest points
    are f0 < f1 (f0 = f1 in one dimension). Each row is (third point or -1, group, apex, sign).
    Two apexes of one face and group lie on the same side if their signs agree.
    """

    start: IntArray
    stop: IntArray
    rows: IntArray


def known_apexes(problem: Problem) -> list[tuple[tuple[int, ...], int, int, int]]:
    """List (sorted face, group, apex, sign) of every known apex."""
    rows = []
    for group, constraint in enumerate(problem.sides, start=_CHIRALITY_GROUP + 1):
        if constraint.side:
            face = tuple(sorted(constraint.face))
            rows.append((face, group, constraint.first, 1))
            rows.append((face, group, constraint.second, -int(constraint.side)))
    known = set()
    for chirality in problem.chiralities:
        points = tuple(sorted(chirality.points))
        sign = chirality.sign_of(points)
        for position, apex in enumerate(points):
            face = points[:position] + points[position + 1 :]
            # Moving the apex behind the face takes this many transpositions.
            apex_sign = sign * (-1) ** (len(points) - 1 - position)
            known.add((face, _CHIRALITY_GROUP, apex, apex_sign))
    return sorted(rows) + sorted(known)


def sides_of(problem: Problem) -> Sides:
    """Return the sides that a problem's side constraints and chiralities fix, sorted by face."""
    n_points = problem.n_points
    start = np.zeros((n_points, n_points), dtype=np.int64)
    stop = np.zeros((n_points, n_points), dtype=np.int64)
    table: list[tuple[int, int, int, int]] = []
    for face, group, apex, sign in sorted(known_apexes(problem)):
        index = (face[0], face[-1] if len(face) < 3 else face[1])
        if stop[index] == 0:
            start[index] = len(table)
        table.append((face[2] if len(face) == 3 else -1, group, apex, sign))
        stop[index] = len(table)
    return Sides(start, stop, np.array(table, dtype=np.int64).reshape(-1, 4))


@kernel(borrows=True)
def set_sigma(
    sigma: NDArray[np.int8], sides: Sides, f0: int, f1: int, third: int, known_sides: bool
) -> bool:
    """
    Write the side of all pairs of apexes of a face, or clear it; return whether any is known.

    Two contradicting constraints give `BOTH`: such points lie on the face.
    """
    known = False
    stop = sides.stop[f0, f1]
    for x in range(sides.start[f0, f1], stop):
        if sides.rows[x, 0] != third:
            continue
        for y in range(x + 1, stop):
            if sides.rows[y, 0] == third and sides.rows[y, 1] == sides.rows[x, 1]:
                i = sides.rows[x, 2]
                k = sides.rows[y, 2]
                side = -sides.rows[x, 3] * sides.rows[y, 3] if known_sides else 0
                if side != 0 and sigma[i, k] != 0 and sigma[i, k] != side:
                    side = BOTH
                sigma[i, k] = sigma[k, i] = side
                known = True
    return known


@kernel(borrows=True)
def _inner_product(
    box: FloatArray, p_base: int, p: int, q_base: int, q: int
) -> tuple[float, float]:
    """Bound (x_p - x_pbase) . (x_q - x_qbase) from four squared distances (Eq. 3)."""
    low, high = sub(
        *add(
            box[LOWER, p, q_base],
            box[UPPER, p, q_base],
            box[LOWER, p_base, q],
            box[UPPER, p_base, q],
        ),
        *add(
            box[LOWER, p, q],
            box[UPPER, p, q],
            box[LOWER, p_base, q_base],
            box[UPPER, p_base, q_base],
        ),
    )
    return 0.5 * low, 0.5 * high


@kernel(borrows=True)
def _minor(gram: FloatArray, r: int, s: int, c: int, e: int) -> tuple[float, float]:
    """Bound the 2 x 2 minor of rows r, s and columns c, e."""
    return sub(
        *mul(gram[0, r, c], gram[1, r, c], gram[0, s, e], gram[1, s, e]),
        *mul(gram[0, r, e], gram[1, r, e], gram[0, s, c], gram[1, s, c]),
    )


@kernel
def volume_product(box: FloatArray, p: IntArray, q: IntArray) -> tuple[float, float]:
    """
    Bound det[p2 - p1, ...] det[q2 - q1, ...] over a box.

    The product of the two determinants is the determinant of the inner products
    (p_i - p_1) . (q_j - q_1), each a sum of four squared distances (Eq. 3).
    """
    size = len(p) - 1
    gram = np.empty((2, size, size))
    for r in range(size):
        for c in range(size):
            low, high = _inner_product(box, p[0], p[r + 1], q[0], q[c + 1])
            if np.isinf(low) or np.isinf(high):
                return -np.inf, np.inf
            gram[0, r, c] = low
            gram[1, r, c] = high
    if size == 1:
        return gram[0, 0, 0], gram[1, 0, 0]
    if size == 2:
        return _minor(gram, 0, 1, 0, 1)
    low = 0.0
    high = 0.0
    for c in range(3):
        minor_low, minor_high = _minor(gram, 1, 2, (c + 1) % 3, (c + 2) % 3)
        term = mul(gram[0, 0, c], gram[1, 0, c], minor_low, minor_high)
        low, high = add(low, high, *term)
    return low, high


@kernel
def _least_volume(box: FloatArray, simplex: IntArray) -> float:
    """
    Return a lower bound of det[p2 - p1, ...]^2 of a simplex over a box.

    The square is a Cayley-Menger determinant, concave in every squared distance: the coefficient
    of its square is minus that of a smaller one. So it is least at a corner of the box.
    """
    size = len(simplex)
    points = np.arange(size)
    corner = np.zeros((2, size, size))
    n_pairs = size * (size - 1) // 2
    least = np.inf
    for number in range(1 << n_pairs):
        pair = 0
        for x in range(size):
            for y in range(x + 1, size):
                end = UPPER if number >> pair & 1 else LOWER
                value = box[end, simplex[x], simplex[y]]
                if np.isinf(value):
                    return -np.inf
                corner[:, x, y] = value
                corner[:, y, x] = value
                pair += 1
        least = min(least, volume_product(corner, points, points)[0])
    return least


@kernel
def farthest_apex(box: FloatArray, face: IntArray, others: IntArray) -> int:
    """Return the point of `others` with the greatest proved distance from a face, or -1."""
    best = -1
    farthest = 0.0
    simplex = np.empty(len(face) + 1, dtype=np.int64)
    simplex[:-1] = face
    for point in others:
        simplex[-1] = point
        volume = _least_volume(box, simplex)
        if volume > farthest:
            best, farthest = point, volume
    return best


def chiralities_are_possible(box: FloatArray, chiralities: Sequence[Chirality]) -> bool:
    """
    Return whether chiralities may hold together in a box; False proves that they do not.

    Every simplex is compared with the first one.
    """
    for known in chiralities[1:]:
        first, second = np.array([chiralities[0].points, known.points], dtype=np.int64)
        low, high = volume_product(box, first, second)
        if (high < 0.0) if known.sign == chiralities[0].sign else (low > 0.0):
            return False
    return True
