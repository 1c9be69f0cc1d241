# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction of coordinate boxes: the coordinates of points whose distances are bounded.

Unlike `coordinates`, which makes coordinates from distances alone, this starts from boxes in a
frame that is already fixed.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.interval.scalars import add, square, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, component_hulls, narrow

WORTH_A_SWEEP = 0.99
"""Another sweep follows when some side shrinks below this share of its width."""


@kernel
def contract_coordinate_boxes(
    low: FloatArray, high: FloatArray, lower: FloatArray, upper: FloatArray, sweeps: int
) -> bool:
    """
    Contract boxes of coordinates by the distances between their points, in place.

    False when some box is left without any point.
    """
    n_points, dimension = low.shape
    for _ in range(sweeps):
        gained = False
        for i in range(n_points):
            for j in range(n_points):
                if i == j or (math.isinf(upper[i, j]) and lower[i, j] <= 0.0):
                    continue
                for axis in range(dimension):
                    new_low, new_high = contracted_side(
                        low, high, i, j, axis, lower[i, j], upper[i, j]
                    )
                    if new_low > new_high:
                        return False
                    width = high[i, axis] - low[i, axis]
                    if new_high - new_low < WORTH_A_SWEEP * width:
                        gained = True
                    low[i, axis] = new_low
                    high[i, axis] = new_high
        if not gained:
            break
    return True


@kernel
def contracted_side(
    low: FloatArray,
    high: FloatArray,
    i: int,
    j: int,
    axis: int,
    s_lower_m2: float,
    s_upper_m2: float,
) -> tuple[float, float]:
    """
    Bound one coordinate of point i by its distance to point j; reversed when there is none.

    The squared difference of the two coordinates lies between ``s_lower_m2 - most`` and
    ``s_upper_m2 - least``, where `least` and `most` bound what the other axes contribute.
    """
    least, most = _squares_of_other_axes(low, high, i, j, axis)
    remainder = up(s_upper_m2 - least)
    if remainder < 0.0:
        return math.inf, -math.inf
    farthest = sqrt_up(remainder)
    new_low = max(low[i, axis], down(low[j, axis] - farthest))
    new_high = min(high[i, axis], up(high[j, axis] + farthest))
    nearest = sqrt_down(down(s_lower_m2 - most))
    if nearest > 0.0:
        # The coordinate is either below `left` or above `right`.
        left = up(high[j, axis] - nearest)
        right = down(low[j, axis] + nearest)
        if left < new_low and new_low < right:
            new_low = right
        if left < new_high and new_high < right:
            new_high = left
    return new_low, new_high


@kernel
def _squares_of_other_axes(
    low: FloatArray, high: FloatArray, i: int, j: int, axis: int
) -> tuple[float, float]:
    """Bound the sum of the squared differences of two points along all axes but one."""
    least = 0.0
    most = 0.0
    for other in range(low.shape[1]):
        if other != axis:
            difference_low = down(low[i, other] - high[j, other])
            difference_high = up(high[i, other] - low[j, other])
            nearest = max(0.0, max(difference_low, -difference_high))
            least = max(0.0, down(least + square_down(nearest)))
            most = up(most + square_up(max(abs(difference_low), abs(difference_high))))
    return least, most


LEAST_SHRINK = 0.9
"""A box is contracted again while some side shrinks below this share of its length,"""

MOST_CONTRACTIONS = 8
"""at most so often before it is bisected."""

MOST_LEAVES = 512
"""Boxes are bisected no more when there are this many."""


@kernel
def _contract(low: FloatArray, high: FloatArray, lower: FloatArray, upper: FloatArray) -> bool:
    """Contract the box in row 0 by the distances to the others; False when nothing is left."""
    n_rows, dimension = low.shape
    for _ in range(MOST_CONTRACTIONS):
        gained = False
        for j in range(1, n_rows):
            for axis in range(dimension):
                new_low, new_high = contracted_side(low, high, 0, j, axis, lower[j], upper[j])
                if new_low > new_high:
                    return False
                if new_high - new_low < LEAST_SHRINK * (high[0, axis] - low[0, axis]):
                    gained = True
                low[0, axis] = new_low
                high[0, axis] = new_high
        if not gained:
            break
    return True


@kernel
def _leaves(
    low: FloatArray, high: FloatArray, lower: FloatArray, upper: FloatArray, side_m: float
) -> FloatArray:
    """
    Return boxes that hold all places of the point in row 0, shape (k, 2, q).

    They are bisected until no side is longer than `side_m`, or there are too many.
    """
    dimension = low.shape[1]
    stack = np.empty((MOST_LEAVES, 2, dimension))
    n_leaves, first = 0, MOST_LEAVES - 1
    # Leaves grow from the start, boxes to examine from the end.
    stack[first, LOWER] = low[0]
    stack[first, UPPER] = high[0]
    while first < MOST_LEAVES:
        low[0] = stack[first, LOWER]
        high[0] = stack[first, UPPER]
        first += 1
        if not _contract(low, high, lower, upper):
            continue
        widest = 0
        for axis in range(1, dimension):
            if high[0, axis] - low[0, axis] > high[0, widest] - low[0, widest]:
                widest = axis
        width = high[0, widest] - low[0, widest]
        middle = 0.5 * (low[0, widest] + high[0, widest]) if width < np.inf else np.inf
        is_divisible = low[0, widest] < middle < high[0, widest]
        if width <= side_m or not is_divisible or first - n_leaves < 2:
            stack[n_leaves, LOWER] = low[0]
            stack[n_leaves, UPPER] = high[0]
            n_leaves += 1
            continue
        for part in range(2):
            first -= 1
            stack[first, LOWER] = low[0]
            stack[first, UPPER] = high[0]
            stack[first, UPPER if part == 0 else LOWER, widest] = middle
    return stack[:n_leaves].copy()


def regions_of_point(
    enclosure: FloatArray, lower: FloatArray, upper: FloatArray, least_ratio: float
) -> FloatArray:
    """Return the regions in which a point can be, by its distances to some others."""
    count, _, dimension = enclosure.shape
    low, high = np.empty((count + 1, dimension)), np.empty((count + 1, dimension))
    low[0], high[0] = -np.inf, np.inf
    low[1:], high[1:] = enclosure[:, LOWER], enclosure[:, UPPER]
    all_lower, all_upper = np.zeros(count + 1), np.zeros(count + 1)
    all_lower[1:], all_upper[1:] = lower, upper
    long_m = np.sqrt(upper)
    side_m = max(
        (least_ratio * long_m).max(initial=0.0), (long_m - np.sqrt(lower)).max(initial=0.0)
    )
    return component_hulls(_leaves(low, high, all_lower, all_upper, side_m))[0]


@kernel
def distances_to_region(
    region: FloatArray, enclosure: FloatArray, box: FloatArray, point: int
) -> bool:
    """
    Narrow the distances of one point to the first others by the region it is in.

    False when nothing is left.
    """
    for x in range(len(enclosure)):
        low, high = 0.0, 0.0
        for axis in range(region.shape[1]):
            difference = sub(
                region[LOWER, axis],
                region[UPPER, axis],
                enclosure[x, LOWER, axis],
                enclosure[x, UPPER, axis],
            )
            low, high = add(low, high, *square(*difference))
        if not narrow(box, point, x, max(low, 0.0), high):
            return False
    return True
