# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Reduction on the line (Section 4.2, Algorithm 1).

The distances of three points on a line obey d_ik = |d_ij - d_jk| or d_ik = d_ij + d_jk. If j is
the image of a face with a known side, only one of the two is left. Algorithm 1 takes the hull of
the two branches after each j. Here their union is kept, the unions over all j are intersected, and
the hull is taken last; the space between the branches becomes a gap.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    exclude,
    narrow,
)
from dg_localization.solver.contract.projection import lanes_of

BOTH = 2
"""The side of two points with constraints for both the same and opposite sides."""


@kernel(inlined=True)
def _restrict(
    distance: FloatArray,
    i: int,
    k: int,
    near_low: float,
    near_high: float,
    far_low: float,
    far_high: float,
) -> bool:
    """
    Intersect the two parts of pair (i, k) with a near and a far branch; return False if empty.

    The branches must not overlap: the caller joins overlapping ones.
    """
    low = distance[LOWER, i, k]
    high = distance[UPPER, i, k]
    gap_low = distance[GAP_LOWER, i, k]
    gap_high = distance[GAP_UPPER, i, k]
    if gap_low >= gap_high:
        gap_low, gap_high = high, math.inf

    # Parts in ascending order. The middle one is the far branch of the first part or the near
    # branch of the second; both cannot be there, since the far branch lies above the near one.
    first_low, first_high = max(low, near_low), min(gap_low, near_high)
    middle_low, middle_high = max(low, far_low), min(gap_low, far_high)
    if middle_low > middle_high:
        middle_low, middle_high = max(gap_high, near_low), min(high, near_high)
    last_low, last_high = max(gap_high, far_low), min(high, far_high)

    new_low = math.inf
    new_high = -math.inf
    new_gap_low = 0.0
    new_gap_high = 0.0
    for part_low, part_high in (
        (first_low, first_high),
        (middle_low, middle_high),
        (last_low, last_high),
    ):
        if part_low <= part_high:
            if new_high < part_low and new_low <= new_high:
                if part_low - new_high > new_gap_high - new_gap_low:
                    new_gap_low = new_high
                    new_gap_high = part_low
            new_low = min(new_low, part_low)
            new_high = max(new_high, part_high)
    distance[LOWER, i, k] = distance[LOWER, k, i] = new_low
    distance[UPPER, i, k] = distance[UPPER, k, i] = new_high
    distance[GAP_LOWER, i, k] = distance[GAP_LOWER, k, i] = new_gap_low
    distance[GAP_UPPER, i, k] = distance[GAP_UPPER, k, i] = new_gap_high
    return new_low <= new_high


@kernel(inlined=True)
def _set_roots(box: FloatArray, distance: FloatArray, count: int) -> None:
    """Write the distances of the squared distances in `box`; a gap is rounded inward."""
    stop = lanes_of(count)
    for x in range(count):
        squared_lower, squared_upper = box[LOWER, x], box[UPPER, x]
        lower, upper = distance[LOWER, x], distance[UPPER, x]
        for y in range(stop):
            lower[y] = sqrt_down(squared_lower[y])
        for y in range(stop):
            upper[y] = sqrt_up(squared_upper[y])
        lower[x] = upper[x] = 0.0
        for y in range(x):
            gap_low = 0.0
            gap_high = 0.0
            if box[GAP_LOWER, x, y] < box[GAP_UPPER, x, y]:
                gap_low = sqrt_up(box[GAP_LOWER, x, y])
                gap_high = sqrt_down(box[GAP_UPPER, x, y])
            distance[GAP_LOWER, x, y] = distance[GAP_LOWER, y, x] = gap_low
            distance[GAP_UPPER, x, y] = distance[GAP_UPPER, y, x] = gap_high


@kernel
def _from_merged(
    j_low: float, j_high: float, jk_low: float, jk_high: float, side: int
) -> tuple[float, float]:
    """
    Bound the near branch of the merged point's distance from k, seen from j on a known side.

    With j and k on the same side it is d_j - d_jk, on opposite sides d_jk - d_j; never |...|.
    """
    if side < 0:
        return max(0.0, down(j_low - jk_high)), up(j_high - jk_low)
    return max(0.0, down(jk_low - j_high)), up(jk_high - j_low)


@kernel(inlined=True)
def _known_branches(
    near: tuple[float, float],
    far: tuple[float, float],
    ij: tuple[float, float],
    jk: tuple[float, float],
    triple: tuple[int, int, int],
    merged: int,
    sigma: NDArray[np.int8],
) -> tuple[float, float, float, float]:
    """Return what is left of |d_ij - d_jk| and d_ij + d_jk if i, j or k is the merged point."""
    (near_low, near_high), (far_low, far_high) = near, far
    i, j, k = triple
    if j == merged:
        side = sigma[i, k]
        if side == BOTH:
            near_low, near_high = max(near_low, far_low), min(near_high, far_high)
        elif side > 0:
            near_low, near_high = math.inf, -math.inf
        if side < 0 or side == BOTH:
            far_low, far_high = math.inf, -math.inf
    elif i == merged and sigma[j, k] != 0:
        near_low, near_high = _from_merged(ij[0], ij[1], jk[0], jk[1], sigma[j, k])
        if sigma[j, k] > 0:
            far_low, far_high = math.inf, -math.inf
    elif k == merged and sigma[i, j] != 0:
        near_low, near_high = _from_merged(jk[0], jk[1], ij[0], ij[1], sigma[i, j])
        if sigma[i, j] > 0:
            far_low, far_high = math.inf, -math.inf
    return near_low, near_high, far_low, far_high


@kernel(inlined=True)
def _restrict_through(
    distance: FloatArray,
    points: IntArray,
    x: int,
    z: int,
    y: int,
    merged: int,
    sigma: NDArray[np.int8],
) -> bool:
    """Restrict the pair in rows (x, y) by its distances from the point in row `z`."""
    ij = distance[LOWER, x, z], distance[UPPER, x, z]
    jk = distance[LOWER, z, y], distance[UPPER, z, y]
    near = (
        max(0.0, down(ij[0] - jk[1]), down(jk[0] - ij[1])),
        up(max(ij[1] - jk[0], jk[1] - ij[0])),
    )
    far = down(ij[0] + jk[0]), up(ij[1] + jk[1])
    triple = points[x], points[z], points[y]
    near_low, near_high, far_low, far_high = _known_branches(
        near, far, ij, jk, triple, merged, sigma
    )
    if near_high >= far_low:
        # The branches overlap: together they are one interval.
        near_high = max(near_high, far_high)
        far_low, far_high = math.inf, -math.inf
    low, high = distance[LOWER, x, y], distance[UPPER, x, y]
    # `&` and `|`, not `and` and `or`: one branch is predicted better than four.
    if ((near_low <= low) & (high <= near_high)) | ((far_low <= low) & (high <= far_high)):
        # The whole interval lies in one branch, and its gap stays too.
        return True
    return _restrict(distance, x, y, near_low, near_high, far_low, far_high)


@kernel(inlined=True)
def _narrow_to_distances(box: FloatArray, distance: FloatArray, count: int) -> bool:
    """Narrow the squared distances by the distances; return whether anything is left."""
    stop = lanes_of(count)
    for x in range(count):
        squared_lower, squared_upper = box[LOWER, x], box[UPPER, x]
        lower, upper = distance[LOWER, x], distance[UPPER, x]
        for y in range(stop):
            squared_lower[y] = max(square_down(lower[y]), squared_lower[y])
        for y in range(stop):
            squared_upper[y] = min(square_up(upper[y]), squared_upper[y])
    for x in range(count):
        for y in range(x + 1, count):
            if box[LOWER, x, y] > box[UPPER, x, y]:
                return False
            if box[GAP_LOWER, x, y] < box[GAP_UPPER, x, y]:
                if not narrow(box, x, y, box[LOWER, x, y], box[UPPER, x, y]):
                    return False
            if distance[GAP_LOWER, x, y] < distance[GAP_UPPER, x, y]:
                gap_low = square_up(distance[GAP_LOWER, x, y])
                gap_high = square_down(distance[GAP_UPPER, x, y])
                if not exclude(box, x, y, gap_low, gap_high):
                    return False
    return True


@kernel(inlined=True)
def _find_open(
    distance: FloatArray, z: int, count: int, is_open: NDArray[np.bool_], n_open: IntArray
) -> None:
    """
    Mark the pairs that may have to be restricted by their distances from the point in row `z`.

    A pair that lies in one branch before the branches are rounded outward needs no restriction.
    This only selects the pairs to examine. Values in spare lanes are meaningless.
    """
    z_lower, z_upper = distance[LOWER, z], distance[UPPER, z]
    for x in range(count):
        ij_low, ij_high = z_lower[x], z_upper[x]
        lower, upper, row = distance[LOWER, x], distance[UPPER, x], is_open[x]
        n_found = 0
        for y in range(lanes_of(x)):
            jk_low, jk_high = z_lower[y], z_upper[y]
            near_low = max(ij_low - jk_high, jk_low - ij_high)
            near_high = max(ij_high - jk_low, jk_high - ij_low)
            far_low, far_high = ij_low + jk_low, ij_high + jk_high
            low, high = lower[y], upper[y]
            # Either the pair is in the near branch, or in the far one, or these overlap.
            is_inside = ((near_low <= low) & (high <= far_high)) & (
                (high <= near_high) | (far_low <= max(low, near_high))
            )
            row[y] = not is_inside
            n_found += 0 if is_inside else 1
        n_open[x] = n_found


@kernel(inlined=True)
def _open_known(at: int, z: int, count: int, is_open: NDArray[np.bool_], n_open: IntArray) -> None:
    """Mark pairs whose branches through `z` are decided by known sides of the row `at`."""
    for x in range(count):
        if z == at or x == at:
            for y in range(x):
                is_open[x, y] = True
            n_open[x] += x
        elif x > at:
            is_open[x, at] = True
            n_open[x] += 1


@kernel(borrows=True)
def reduce_line(
    box: FloatArray,
    distance: FloatArray,
    is_open: NDArray[np.bool_],
    n_open: IntArray,
    points: IntArray,
    n_through: int,
    merged: int,
    sigma: NDArray[np.int8],
) -> bool:
    """
    Reduce the squared distances of points on a line, in place (Algorithm 1).

    Return False if no arrangement on a line is left.
    """
    count = len(points)
    at = -1
    for x in range(count):
        if points[x] == merged:
            at = x
    _set_roots(box, distance, count)
    for turn in range(min(count, n_through)):
        # The last row, the image of an axis, comes first: it is known best.
        z = turn - 1 if turn > 0 else count - 1
        _find_open(distance, z, count, is_open, n_open)
        if at >= 0:
            _open_known(at, z, count, is_open, n_open)
        for x in range(count):
            if x == z or n_open[x] == 0:
                continue
            for y in range(x):
                if y != z and is_open[x, y]:
                    if not _restrict_through(distance, points, y, z, x, merged, sigma):
                        return False
    return _narrow_to_distances(box, distance, count)
