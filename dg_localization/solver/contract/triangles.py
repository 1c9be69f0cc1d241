# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Triangle-inequality smoothing of a distance box, from D1 to D2 (Section 5.1)."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, narrow


@kernel(borrows=True)
def smooth_triangles(box: FloatArray, distance: FloatArray, points: IntArray) -> bool:
    """
    Enforce d_ij - d_jk <= d_ik <= d_ij + d_jk over all triangles, in place.

    Upper bounds first, as shortest paths (Floyd and Warshall); then lower bounds, which need the
    final upper bounds and one pass in the same order (Dress and Havel, 1988).

    False when the triangle inequalities contradict each other.
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
