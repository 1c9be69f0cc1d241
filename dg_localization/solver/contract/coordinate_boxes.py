# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Contraction of coordinate boxes: the coordinates of points whose distances are bounded.

Unlike `coordinates`, which makes coordinates from distances alone, this starts from boxes in a
frame that is already fixed.
"""

from __future__ import annotations

import math

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.solver.box import FloatArray

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
