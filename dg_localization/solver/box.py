# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A box in distance space: one interval per pair of points, with at most one gap in it.

A box is an array of shape (4, n, n), symmetric in its last two axes, in m^2: the planes LOWER and
UPPER bound every squared distance, and the open interval (GAP_LOWER, GAP_UPPER) holds no solution
either. ``GAP_LOWER >= GAP_UPPER`` means that no gap is known. The same layout serves the projected
problems and, in m, the distances on the line.
"""

from __future__ import annotations

from enum import Enum

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.components import components
from dg_localization.interval.kernels import kernel


class Status(Enum):
    """The result of a contraction."""

    EMPTY = 0
    """The box is proved to hold no placement."""

    CONTRACTED = 1
    """The box was narrowed as far as possible, perhaps not at all."""

    UNFINISHED = 2
    """The clock or the caller stopped the contraction; the box is still sound."""


LOWER, UPPER, GAP_LOWER, GAP_UPPER = range(4)

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


def sub_box(box: FloatArray, points: IntArray) -> FloatArray:
    """Return the box of some of the points, in the order they are named."""
    return np.ascontiguousarray(box[:, points[:, None], points])


@kernel(borrows=True)
def narrow(box: FloatArray, i: int, j: int, low: float, high: float) -> bool:
    """Intersect pair (i, j) with [low, high], its gap left out; return whether it is not empty."""
    low = max(low, box[LOWER, i, j])
    high = min(high, box[UPPER, i, j])
    gap_low = box[GAP_LOWER, i, j]
    gap_high = box[GAP_UPPER, i, j]
    if gap_low < gap_high:
        if low > gap_low:
            low = max(low, gap_high)
        if high < gap_high:
            high = min(high, gap_low)
        if low > gap_low or high < gap_high:
            box[GAP_LOWER, i, j] = box[GAP_LOWER, j, i] = 0.0
            box[GAP_UPPER, i, j] = box[GAP_UPPER, j, i] = 0.0
    box[LOWER, i, j] = box[LOWER, j, i] = low
    box[UPPER, i, j] = box[UPPER, j, i] = high
    return low <= high


@kernel(borrows=True)
def exclude(box: FloatArray, i: int, j: int, gap_low: float, gap_high: float) -> bool:
    """
    Remove an open interval from pair (i, j); return whether anything is left.

    An interval at an end of the bounds moves that end. An inner one becomes the gap of the pair:
    it is joined with the known gap if they overlap, else the wider one is kept.
    """
    if gap_low >= gap_high:
        return True
    low = box[LOWER, i, j]
    high = box[UPPER, i, j]
    if gap_low < low:
        return narrow(box, i, j, gap_high, high) if gap_high > low else True
    if gap_high > high:
        return narrow(box, i, j, low, gap_low) if gap_low < high else True
    known_low = box[GAP_LOWER, i, j]
    known_high = box[GAP_UPPER, i, j]
    if known_low < known_high:
        if gap_low < known_high and known_low < gap_high:
            gap_low = min(gap_low, known_low)
            gap_high = max(gap_high, known_high)
        elif known_high - known_low >= gap_high - gap_low:
            return True
    box[GAP_LOWER, i, j] = box[GAP_LOWER, j, i] = gap_low
    box[GAP_UPPER, i, j] = box[GAP_UPPER, j, i] = gap_high
    return True


def cut_at(
    box: FloatArray, pair: tuple[int, int], low_end: float, high_start: float
) -> list[FloatArray]:
    """Return the parts of a box below `low_end` and above `high_start` of one pair."""
    i, j = pair
    below, above = box.copy(), box.copy()
    for part in (below, above):
        part[[[GAP_LOWER], [GAP_UPPER]], [i, j], [j, i]] = 0.0
    below[UPPER, [i, j], [j, i]] = low_end
    above[LOWER, [i, j], [j, i]] = high_start
    return [below, above]


def component_hulls(boxes: FloatArray) -> tuple[FloatArray, list[IntArray]]:
    """Return the hulls of the components of some boxes, (k, 2, ...), and the boxes of each."""
    members = components(boxes.reshape(len(boxes), 2, -1)) if len(boxes) else []
    hulls = np.empty((len(members), *boxes.shape[1:]))
    for hull, some in zip(hulls, members, strict=True):
        hull[LOWER], hull[UPPER] = boxes[some, LOWER].min(axis=0), boxes[some, UPPER].max(axis=0)
    return hulls, members
