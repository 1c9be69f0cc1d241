# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Coordinates of points whose distances are bounded.

Cartesian enclosures of a box in distance space are made by the Cholesky route of Section 3. The
coordinates of a point in the frame of a few others are its coordinates along successive projection
axes, so the formulas of the projection bound them. Boxes in a fixed frame are contracted by the
distances.
"""

from __future__ import annotations

from collections.abc import Sequence
import math

import numpy as np

from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, sqrt_down, sqrt_up, square_down, square_up, up
from dg_localization.interval.scalars import reverse_square
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, component_hulls
from dg_localization.solver.contract.axis_bounds import axis_coordinate
from dg_localization.solver.contract.projection import new_rows, project


def enclose_coordinates(
    lower: FloatArray, upper: FloatArray, frame: Sequence[int]
) -> FloatArray | None:
    """Bound the coordinates of all points in the frame of some of them."""
    if not 2 <= len(frame) <= 4 or len(set(frame)) < len(frame):
        raise ValueError(f'frame is {tuple(frame)}, it must name 2 to 4 different points')
    box = np.zeros((4, len(lower), len(lower)))
    box[LOWER] = lower
    box[UPPER] = upper
    enclosure = enclose_in_frame(box, np.array(frame, dtype=np.int64))
    if np.any(enclosure[:, LOWER] > enclosure[:, UPPER]):
        return None
    return enclosure


@kernel
def enclose_in_frame(box: FloatArray, frame: IntArray) -> FloatArray:
    """Bound all coordinates in a frame; see `enclose_coordinates`."""
    n_points = box.shape[1]
    dimension = len(frame) - 1
    enclosure = np.empty((n_points, 2, dimension))
    enclosure[:, LOWER] = -np.inf
    enclosure[:, UPPER] = np.inf
    origin = frame[0]
    enclosure[origin] = 0.0
    points = np.arange(n_points)
    for axis in range(dimension):
        end = frame[axis + 1]
        if np.isinf(box[UPPER, origin, end]):
            break
        for earlier in range(1, axis + 1):
            enclosure[frame[earlier], :, axis] = 0.0
        enclosure[end, LOWER, axis] = sqrt_down(box[LOWER, origin, end])
        enclosure[end, UPPER, axis] = sqrt_up(box[UPPER, origin, end])
        on_line = axis == dimension - 1
        for x in range(len(points)):
            point = points[x]
            if point != origin and point != end:
                low, high = _coordinate(box, origin, end, point, on_line)
                enclosure[point, LOWER, axis] = low
                enclosure[point, UPPER, axis] = high
        if not on_line:
            projected = np.zeros_like(box)
            # Points that the projection leaves out are unbounded.
            projected[UPPER] = np.inf
            for i in range(n_points):
                projected[UPPER, i, i] = 0.0
            rows = new_rows(n_points)
            count = project(box, rows, points, origin, end)
            if count < 0:
                enclosure[:, LOWER] = np.inf
                enclosure[:, UPPER] = -np.inf
                break
            points = rows.points[:count]
            for x in range(count):
                for y in range(count):
                    if x != y:
                        for plane in range(4):
                            projected[plane, points[x], points[y]] = rows.across[plane, x, y]
            box = projected
    return enclosure


@kernel
def _coordinate(
    box: FloatArray, origin: int, end: int, point: int, on_line: bool
) -> tuple[float, float]:
    """Bound the coordinate of a point along one axis of the frame."""
    a_lower, a_upper = box[LOWER, origin, point], box[UPPER, origin, point]
    b_lower, b_upper = box[LOWER, end, point], box[UPPER, end, point]
    if np.isinf(a_upper) or np.isinf(b_upper):
        return -np.inf, np.inf
    low, high = axis_coordinate(
        a_lower,
        a_upper,
        b_lower,
        b_upper,
        sqrt_down(box[LOWER, origin, end]),
        sqrt_up(box[UPPER, origin, end]),
    )
    if on_line:
        low, high = reverse_square(low, high, a_lower, a_upper)
    return low, high


WORTH_A_SWEEP, SWEEPS = 0.99, 20
"""Another sweep follows when some side shrinks below this share of its width, but no more than
this many."""


@kernel
def contract_coordinate_boxes(
    low: FloatArray, high: FloatArray, lower: FloatArray, upper: FloatArray
) -> bool:
    """
    Contract boxes of coordinates by the distances between their points, in place.

    Return False if some box becomes empty.
    """
    n_points, dimension = low.shape
    for _ in range(SWEEPS):
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
    Bound one coordinate of point i by its distance to point j; reversed if there is none.

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


MOST_LEAVES = 512
"""Number of boxes from which on none is bisected."""


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
        if not contract_coordinate_boxes(low, high, lower, upper):
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
    enclosure: FloatArray, lower: FloatArray, upper: FloatArray, resolution_m: float
) -> FloatArray:
    """
    Return the regions that a point can be in, by its distances to other points.

    Each is the hull of connected boxes, which are not halved below the resolution or the width of
    the widest distance.
    """
    count, _, dimension = enclosure.shape
    low, high = np.empty((count + 1, dimension)), np.empty((count + 1, dimension))
    low[0], high[0] = -np.inf, np.inf
    low[1:], high[1:] = enclosure[:, LOWER], enclosure[:, UPPER]
    # No other point is contracted by this one.
    all_lower = np.zeros((count + 1, count + 1))
    all_upper = np.full_like(all_lower, np.inf)
    all_lower[0, 1:], all_upper[0, 1:] = lower, upper
    side_m = float((np.sqrt(upper) - np.sqrt(lower)).max(initial=resolution_m))
    return component_hulls(_leaves(low, high, all_lower, all_upper, side_m))[0]


def distances_to_region(
    region: FloatArray, enclosure: FloatArray, box: FloatArray, point: int
) -> bool:
    """
    Narrow the distances from one point to the first others by its region.

    The box has no gaps. Return False if a distance becomes empty.
    """
    count = len(enclosure)
    with np.errstate(over='ignore'):
        squared = squared_norm(Interval(*region) - Interval(*enclosure.swapaxes(0, 1)))
    low = np.maximum(box[LOWER, point, :count], squared.lower)
    high = np.minimum(box[UPPER, point, :count], squared.upper)
    box[LOWER, point, :count] = box[LOWER, :count, point] = low
    box[UPPER, point, :count] = box[UPPER, :count, point] = high
    return bool((low <= high).all())
