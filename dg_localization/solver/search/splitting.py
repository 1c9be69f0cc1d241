# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where to split a box: at the gap that leaves least to choose from, else where it is too wide."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import GAP_LOWER, GAP_UPPER, LOWER, UPPER, FloatArray, cut_at
from dg_localization.solver.contract.fixed_point import LEAST_GAP, Pruned
from dg_localization.solver.contract.widths import excess

EXPLAINED_FACTOR = 3.0
"""How much wider a finished box may be than the first-order effect of the measurement errors."""


@kernel(borrows=True)
def choose_split(
    box: FloatArray, explained: FloatArray, resolution_m: float
) -> tuple[int, int, float, float]:
    """
    Choose where to split a contracted box: at a gap, else where it is too wide.

    Of several gaps the one is taken that leaves the least of its interval: both parts are then
    known well, and contraction decides about them. The widest gaps are those of far points, about
    which little is known yet.
    """
    n_points = box.shape[1]
    gap_i, gap_j, least_left_m = -1, -1, math.inf
    i, j, widest_m2, widest_m = -1, -1, 0.0, 0.0
    for k in range(n_points):
        for other in range(k + 1, n_points):
            low, high = box[LOWER, k, other], box[UPPER, k, other]
            width_m = math.sqrt(high) - math.sqrt(low)
            if high < np.inf:
                widest_m = max(widest_m, width_m)
            gap_m = math.sqrt(box[GAP_UPPER, k, other]) - math.sqrt(box[GAP_LOWER, k, other])
            if gap_m > LEAST_GAP * resolution_m and (gap_i < 0 or width_m - gap_m < least_left_m):
                gap_i, gap_j, least_left_m = k, other, width_m - gap_m
            times = excess(box, explained, EXPLAINED_FACTOR, resolution_m, k, other)
            if times > 1.0 and high - low > widest_m2:
                i, j, widest_m2 = k, other, high - low
    if widest_m <= resolution_m:
        return -1, -1, 0.0, 0.0
    if gap_i >= 0:
        return gap_i, gap_j, box[GAP_LOWER, gap_i, gap_j], box[GAP_UPPER, gap_i, gap_j]
    if i < 0:
        return -1, -1, 0.0, 0.0
    # Halves of the squared distance separated better than halves of the distance.
    middle = 0.5 * box[LOWER, i, j] + 0.5 * box[UPPER, i, j]
    return i, j, middle, middle


def split(pruned: Pruned, resolution_m: float, at_gaps: bool = False) -> list[FloatArray]:
    """Split a contracted box."""
    box = pruned.box
    i, j, low_end, high_start = choose_split(box, pruned.explained, resolution_m)
    if at_gaps and low_end == high_start:
        return []
    return cut_at(box, (i, j), low_end, high_start) if i >= 0 else []
