# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which side of a face a piece lies on, and whether that is certain.

q shared points span a hyperplane, their face. A piece lies on one side of it for certain when one
of its points, its apex, is off the hyperplane in every placement of a hypothesis.
"""

from __future__ import annotations

from itertools import combinations
import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.chiralities import volume_product
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.result import Hypothesis

LARGE, MOST_APEXES = 40, 8
"""Of a piece of more points so many about a face are looked at."""


@kernel
def least_volume(box: FloatArray, simplex: IntArray) -> float:
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
def _best_apex(box: FloatArray, face: IntArray, others: IntArray) -> int:
    """Return the point of `others` farthest from a hyperplane for certain, -1 without one."""
    best = -1
    farthest = 0.0
    simplex = np.empty(len(face) + 1, dtype=np.int64)
    simplex[:-1] = face
    for point in others:
        simplex[-1] = point
        volume = least_volume(box, simplex)
        if volume > farthest:
            best, farthest = point, volume
    return best


def best_apex(bounds: Bounds, points: Points, face: Points, others: list[int]) -> int | None:
    """Return which of some points is farthest off the hyperplane of a face, None where none is."""
    place = {point: x for x, point in enumerate(points)}
    corners, apexes = ([place[point] for point in some] for some in (face, others))
    best = int(_best_apex(np.array(bounds), np.array(corners), np.array(apexes, dtype=np.int64)))
    return points[best] if best >= 0 else None


def apex_of(
    points: Points, hypothesis: Hypothesis, face: Points, guide: Hypothesis | None = None
) -> int | None:
    """Return a point of a piece that is off the hyperplane of a face in every placement."""
    others = [point for point in points if point not in face]
    if len(points) > LARGE:
        positions = (guide or hypothesis).positions
        if positions is None:
            return None
        place = {point: x for x, point in enumerate(points)}
        center = positions[[place[point] for point in face]].mean(axis=0)
        away = ((positions[[place[point] for point in others]] - center) ** 2).sum(axis=1)
        others = [others[x] for x in np.argsort(away)[:MOST_APEXES]]
        points = (*face, *others)
        bounds = hypothesis.bounds_among([place[point] for point in points])
    else:
        bounds = hypothesis.lower, hypothesis.upper
    return best_apex(bounds, points, face, others)


def _width_m(corners: list[list[float]]) -> float:
    """Return the length of a segment or the least height of a triangle, infinite where unknown."""
    sides = sorted(math.dist(first, second) for first, second in combinations(corners, 2))
    if not all(map(math.isfinite, sides)):
        return math.inf
    if len(sides) == 1:
        return sides[0]
    a, b, c = sides
    # Heron's formula as Kahan orders it, for triangles that are nearly flat.
    squared = (c + (b + a)) * (a - (c - b)) * (a + (c - b)) * (c + (b - a))
    return 0.5 * math.sqrt(max(squared, 0.0)) / c if c > 0.0 else 0.0


def is_degenerate(points: Points, hypothesis: Hypothesis, face: Points, width_m: float) -> bool:
    """Tell whether a face spans no hyperplane to speak of, so that a piece can turn about it."""
    if len(face) < 2:
        return False
    if len(face) == 2:
        least_m2, _ = hypothesis.bounds_of_pair(*(points.index(point) for point in face))
        if least_m2 > width_m**2:
            # A placement may have to be sought first, and that takes long.
            return False
    if hypothesis.positions is None:
        return False
    corners = hypothesis.positions[[points.index(point) for point in face]]
    return _width_m(corners.tolist()) <= width_m
