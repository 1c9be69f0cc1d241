# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Triangle-inequality smoothing of a distance box, from D1 to D2 (Section 5.1)."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import (
    down,
    rounding_error,
    sqrt_down,
    sqrt_up,
    square_down,
    square_up,
    up,
)
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow


@kernel(borrows=True)
def smooth_triangles(box: FloatArray, distance: FloatArray, points: IntArray) -> bool:
    """
    Enforce d_ij - d_jk <= d_ik <= d_ij + d_jk over all triangles, in place.

    Upper bounds come first, as shortest paths (Floyd and Warshall); then lower bounds, which need
    the final upper bounds and one pass in the same order (Dress and Havel, 1988).

    Return False if the triangle inequalities contradict each other.
    """
    count = len(points)
    for x in range(count):
        i = points[x]
        for y in range(count):
            j = points[y]
            distance[LOWER, i, j] = sqrt_down(box[LOWER, i, j]) if i != j else 0.0
            distance[UPPER, i, j] = sqrt_up(box[UPPER, i, j]) if i != j else 0.0
    for z in range(count):
        j = points[z]
        for x in range(count):
            i = points[x]
            ij_high = distance[UPPER, i, j]
            if i == j or ij_high == np.inf:
                continue
            for y in range(count):
                k = points[y]
                through = up(ij_high + distance[UPPER, j, k])
                if k != j and through < distance[UPPER, i, k]:
                    distance[UPPER, i, k] = through
    for z in range(count):
        j = points[z]
        for x in range(count):
            i = points[x]
            if i == j:
                continue
            for y in range(x + 1, count):
                k = points[y]
                if k == j:
                    continue
                low = max(
                    down(distance[LOWER, i, j] - distance[UPPER, j, k]),
                    down(distance[LOWER, j, k] - distance[UPPER, i, j]),
                )
                if low > distance[LOWER, i, k]:
                    distance[LOWER, i, k] = distance[LOWER, k, i] = low
    for x in range(count):
        i = points[x]
        for y in range(x + 1, count):
            j = points[y]
            low = square_down(distance[LOWER, i, j])
            high = square_up(distance[UPPER, i, j])
            if not narrow(box, i, j, low, high):
                return False
    return True


def smooth(box: FloatArray) -> bool:
    """Enforce the triangle inequalities on a whole box in place; return False if impossible."""
    return bool(smooth_triangles(box, np.empty_like(box), np.arange(box.shape[1])))


ANGLE_SWEEPS = 3
"""Passes over all angles: one angle may use sides that another has contracted."""


@kernel
def contract_opposite_side(
    lower: FloatArray,
    upper: FloatArray,
    a: int,
    b: int,
    c: int,
    low_cosine: float,
    high_cosine: float,
) -> None:
    """
    Contract the side of a triangle opposite to a known angle, in place.

    The law of cosines, s_bc = x^2 + y^2 - 2 x y cosine, is convex in the two other sides. Its
    maximum over a box is at a corner. It is zero only where both sides are, or on the diagonal
    for cosine 1, so that its minimum is on an edge, where it is a parabola.
    """
    if lower[a, b] > upper[a, b] or lower[a, c] > upper[a, c]:
        return
    sides = np.empty((2, 2))
    sides[0, 0], sides[0, 1] = sqrt_down(lower[a, b]), sqrt_up(upper[a, b])
    sides[1, 0], sides[1, 1] = sqrt_down(lower[a, c]), sqrt_up(upper[a, c])
    least = math.inf
    greatest = 0.0
    for fixed in range(2):
        free = 1 - fixed
        for end in range(2):
            x = sides[fixed, end]
            if math.isinf(x):
                greatest = math.inf
                continue
            y = min(max(x * high_cosine, sides[free, 0]), sides[free, 1])
            # No part exceeds (x + y)^2; if that overflows there is no bound.
            margin = rounding_error((x + y) * (x + y), 8.0)
            if math.isinf(margin):
                return
            least = min(least, x * x + y * y - 2.0 * x * y * high_cosine - margin)
    if not math.isinf(greatest):
        for i in range(2):
            for j in range(2):
                x, y = sides[0, i], sides[1, j]
                margin = rounding_error((x + y) * (x + y), 8.0)
                if math.isinf(margin):
                    return
                greatest = max(greatest, x * x + y * y - 2.0 * x * y * low_cosine + margin)
    lower[b, c] = lower[c, b] = max(lower[b, c], least)
    upper[b, c] = upper[c, b] = min(upper[b, c], greatest)


@kernel
def contract_adjacent_side(
    lower: FloatArray,
    upper: FloatArray,
    a: int,
    b: int,
    c: int,
    low_cosine: float,
    high_cosine: float,
) -> None:
    """
    Contract the side ab of a triangle with a known angle at a, in place.

    The law of cosines solved for x = d_ab, with y = d_ac: x = y cosine +- sqrt(s_bc - y^2 sine^2).
    """
    if math.isinf(upper[b, c]) or lower[a, c] > upper[a, c]:
        return
    d_lower_m, d_upper_m = sqrt_down(lower[a, c]), sqrt_up(upper[a, c])
    largest_cosine = max(abs(low_cosine), abs(high_cosine))
    squared_sine = max(0.0, down(1.0 - square_up(largest_cosine)))
    room = up(upper[b, c] - max(0.0, down(lower[a, c] * squared_sine)))
    if room < 0.0:
        upper[a, b] = upper[b, a] = -1.0
        return
    root = sqrt_up(room)
    if high_cosine <= 0.0 or not math.isinf(d_upper_m):
        longest = up(up((d_upper_m if high_cosine > 0.0 else d_lower_m) * high_cosine) + root)
        reach = square_up(longest) if longest >= 0.0 else -1.0
        upper[a, b] = upper[b, a] = min(upper[a, b], reach)
    if low_cosine >= 0.0 or not math.isinf(d_upper_m):
        shortest = down(down((d_lower_m if low_cosine >= 0.0 else d_upper_m) * low_cosine) - root)
        if shortest > 0.0:
            lower[a, b] = lower[b, a] = max(lower[a, b], square_down(shortest))


@kernel
def contract_by_angles(
    lower: FloatArray, upper: FloatArray, corners: IntArray, cosines: FloatArray
) -> None:
    """Contract the sides of triangles with known angles, in place."""
    for _ in range(ANGLE_SWEEPS):
        for row in range(len(corners)):
            a, b, c = corners[row]
            low, high = cosines[row, 0], cosines[row, 1]
            contract_opposite_side(lower, upper, a, b, c, low, high)
            if lower[b, c] <= upper[b, c]:
                contract_adjacent_side(lower, upper, a, b, c, low, high)
                contract_adjacent_side(lower, upper, a, c, b, low, high)
