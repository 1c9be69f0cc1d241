# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Cartesian enclosures of a box in distance space, by the Cholesky route of Section 3.

The coordinates of a point in the frame of a few others are its coordinates along one projection
axis after the other, so the formulas of the projection bound them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import sqrt_down, sqrt_up
from dg_localization.interval.scalars import reverse_square
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
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
            # Nothing is known of the points that the projection leaves out.
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
