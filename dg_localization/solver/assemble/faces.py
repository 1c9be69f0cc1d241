# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which side of a face a piece lies on, and whether that is certain.

q shared points span a hyperplane, their face. A piece lies on one side of it for certain when one
of its points, its apex, is off the hyperplane in every placement of a hypothesis.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.sides import volume_product
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.decompose.rigid_components import RANK_TOLERANCE
from dg_localization.solver.result import Hypothesis

LARGE, MOST_APEXES = 40, 8
"""In a piece of more than `LARGE` points, `MOST_APEXES` about a face are looked at."""


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


def is_degenerate(corners: FloatArray, least_m: float = 0.0) -> bool:
    """
    Return whether the corners of a face, shape (q, q) in m, span no hyperplane: pieces can turn.

    A face that is less than `least_m` wide counts as one.
    """
    spans_m = np.linalg.svd(corners[1:] - corners[0], compute_uv=False)
    least_m = max(least_m, RANK_TOLERANCE * spans_m.max(initial=0.0))
    return bool((spans_m <= least_m).any())


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
