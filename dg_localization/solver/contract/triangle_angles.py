# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The triangles of a placement in the plane: their angles, and their chiralities.

**Angles.** The law of cosines bounds the angle at each corner of each triangle.

**Chiralities.** Two triangles with a common side ij lie on the same side of it or not. At i, the
angle from k to l is the difference of those from j in the first case and their sum, or what that
leaves of a whole turn, in the second. Where the bounds of the three angles exclude one of the
two, one chirality follows from the other. That of one triangle is chosen, because every placement
may be mirrored; the others follow along chains, or stay unknown.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, sqrt_down, up
from dg_localization.interval.scalars import add, mul, sub
from dg_localization.interval.trigonometry import SMALLEST_PRODUCT, arccosine
from dg_localization.solver.box import LOWER, UPPER, FloatArray

SAME, OPPOSITE, EITHER = 1, -1, 0
"""Whether two triangles lie on the same side of their common side."""


@kernel
def _bound_cosine(a_m2: float, b_m2: float, c_m2: float) -> tuple[float, float]:
    """Bound the cosine of the angle opposite to the third side of a triangle."""
    twice_m2 = 2.0 * (math.sqrt(a_m2) * math.sqrt(b_m2))
    # The product of the roots loses bits where it underflows.
    magnitude = (a_m2 + b_m2 + c_m2) / twice_m2 if twice_m2 > SMALLEST_PRODUCT else math.inf
    if not math.isfinite(magnitude):
        return -1.0, 1.0
    cosine_nearby = ((a_m2 + b_m2) - c_m2) / twice_m2
    error = rounding_error(magnitude, 8.0)
    return cosine_nearby - error, cosine_nearby + error


@kernel
def bound_angle(box: FloatArray, i: int, j: int, k: int) -> tuple[float, float]:
    """
    Bound the angle at point i between j and k, in [0, pi].

    Its cosine is least with the longest opposite side c and greatest with the shortest. In one of
    the other sides, a, it is convex or increasing, so that its maximum is at a corner of their
    box, and its minimum at a corner or where a^2 = b^2 - c^2, with the value a / b, on an edge.
    """
    least, greatest = 1.0, -1.0
    for end in range(2):
        for other in range(2):
            a_m2, b_m2 = box[end, i, j], box[other, i, k]
            greatest = max(greatest, _bound_cosine(a_m2, b_m2, box[LOWER, j, k])[1])
            least = min(least, _bound_cosine(a_m2, b_m2, box[UPPER, j, k])[0])
    for adjacent, free in ((k, j), (j, k)):
        for end in range(2):
            b_m2 = box[end, i, adjacent]
            below, above = down(b_m2 - box[UPPER, j, k]), up(b_m2 - box[UPPER, j, k])
            if below > 0.0 and above >= box[LOWER, i, free] and below <= box[UPPER, i, free]:
                least = min(least, sqrt_down(down(below / b_m2)))
    return arccosine(least, greatest)


@kernel
def set_angles(box: FloatArray, angles: FloatArray) -> None:
    """Write the bounds of the angles at i between j and k, (n, n, n, 2)."""
    n_points = box.shape[1]
    for i in range(n_points):
        for j in range(n_points):
            for k in range(j + 1, n_points):
                if i not in (j, k):
                    low, high = bound_angle(box, i, j, k)
                    angles[i, j, k, LOWER] = angles[i, k, j, LOWER] = low
                    angles[i, j, k, UPPER] = angles[i, k, j, UPPER] = high


@kernel
def _first_triangle(angles: FloatArray) -> tuple[int, int, int]:
    """Return the triangle that is farthest from flat for certain."""
    n_points = len(angles)
    best, first = -1.0, (0, 1, 2)
    for i in range(n_points):
        for j in range(i + 1, n_points):
            for k in range(j + 1, n_points):
                least = math.pi
                for a, b, c in ((i, j, k), (j, i, k), (k, i, j)):
                    least = min(least, angles[a, b, c, LOWER], math.pi - angles[a, b, c, UPPER])
                if least > best:
                    best, first = least, (i, j, k)
    return first


@kernel
def _sides_of(angles: FloatArray, i: int, j: int, k: int, other: int) -> int:
    """Return on which sides of ij the points k and the other lie: SAME, OPPOSITE or EITHER."""
    same, opposite = True, True
    for a, b in ((i, j), (j, i)):
        first = angles[a, b, k, LOWER], angles[a, b, k, UPPER]
        second = angles[a, b, other, LOWER], angles[a, b, other, UPPER]
        low, high = angles[a, k, other, LOWER], angles[a, k, other, UPPER]
        from_low, from_high = sub(*first, *second)
        if low > max(-from_low, from_high) or high < max(from_low, -from_high):
            same = False
        from_low, from_high = add(*first, *second)
        # What the sum leaves of a whole turn is shorter where the sum exceeds half a turn.
        rest_low, rest_high = sub(*mul(2.0, 2.0, math.pi, up(math.pi)), from_low, from_high)
        if low > from_high or low > rest_high or high < min(from_low, rest_low):
            opposite = False
    if same == opposite:
        return EITHER
    return SAME if same else OPPOSITE


@kernel
def ascending(i: int, j: int, k: int) -> tuple[int, int, int]:
    """Return three points in ascending order."""
    low, high = min(i, j, k), max(i, j, k)
    return low, i + j + k - low - high, high


@kernel
def permutation_sign(i: int, j: int, k: int) -> int:
    """Return 1 when three points are in cyclic order, -1 otherwise."""
    return 1 if (i < j < k) or (j < k < i) or (k < i < j) else -1


@kernel
def set_chiralities(
    angles: FloatArray, reference: FloatArray, chiralities: NDArray[np.int8]
) -> None:
    """Write the chiralities of the triangles i < j < k as far as they follow; 0: unknown."""
    n_points = len(reference)
    chiralities[:] = 0
    queue = np.empty((n_points * n_points * n_points, 3), dtype=np.int64)
    i, j, k = _first_triangle(angles)
    chiralities[i, j, k] = -1 if cross(reference, i, j, k) < 0.0 else 1
    queue[0, 0], queue[0, 1], queue[0, 2] = i, j, k
    head, tail = 0, 1
    while head < tail:
        a, b, c = queue[head]
        head += 1
        for i, j, k in ((a, b, c), (b, c, a), (c, a, b)):
            for other in range(n_points):
                u, v, w = ascending(i, j, other)
                if other in (i, j, k) or chiralities[u, v, w] != 0:
                    continue
                sides = _sides_of(angles, i, j, k, other) * permutation_sign(i, j, other)
                if sides != EITHER:
                    chiralities[u, v, w] = chiralities[a, b, c] * sides
                    queue[tail, 0], queue[tail, 1], queue[tail, 2] = u, v, w
                    tail += 1


@kernel
def cross(reference: FloatArray, i: int, j: int, k: int) -> float:
    """Return twice the signed area of a triangle of the reference, exactly."""
    ax, ay = reference[j, 0] - reference[i, 0], reference[j, 1] - reference[i, 1]
    bx, by = reference[k, 0] - reference[i, 0], reference[k, 1] - reference[i, 1]
    return ax * by - ay * bx
