"""
Cartesian enclosures of a box in distance space, by the Cholesky route of Section 3.

The coordinates of a point in the frame of a few others are its coordinates along one projection
axis after the other, so the exact ranges of the projection bound them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.solver.back_projection import reverse_square
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.projection import axis_coordinate, project
from dg_localization.solver.rounding import sqrt_down, sqrt_up


def enclose_coordinates(lower: FloatArray, upper: FloatArray, frame: Sequence[int]) -> FloatArray:
    """
    Bound the coordinates of all points in the frame of some of them.

    Parameters
    ----------
    lower, upper : ndarray, shape (n, n)
        Bounds of the squared distances in m^2.
    frame : sequence of int
        The q + 1 points that make the frame: the first is the origin, the second lies on the
        positive x axis, the third where y >= 0, the fourth where z >= 0.

    Returns
    -------
    ndarray, shape (n, 2, q)
        Lower and upper bound of every coordinate in m, rounded outward; infinite where the
        distances bound nothing.

    Raises
    ------
    ValueError
        If the frame has fewer than two points or names a point twice, or if no placement has
        these distances.

    """
    dimension = len(frame) - 1
    if dimension < 1 or len(set(frame)) < len(frame):
        raise ValueError(f'frame is {tuple(frame)}, it must name 2 to 4 different points')
    n_points = len(lower)
    box = np.zeros((4, n_points, n_points))
    box[LOWER] = lower
    box[UPPER] = upper
    enclosure = np.empty((n_points, 2, dimension))
    enclosure[:, LOWER] = -np.inf
    enclosure[:, UPPER] = np.inf
    points = np.arange(n_points, dtype=np.int64)
    origin = frame[0]
    enclosure[origin] = 0.0
    for axis in range(dimension):
        end = frame[axis + 1]
        if np.isinf(box[UPPER, origin, end]):
            break
        for earlier in frame[1 : axis + 1]:
            enclosure[earlier, :, axis] = 0.0
        enclosure[end, LOWER, axis] = sqrt_down(box[LOWER, origin, end])
        enclosure[end, UPPER, axis] = sqrt_up(box[UPPER, origin, end])
        last = axis == dimension - 1
        for point in points[(points != origin) & (points != end)]:
            enclosure[point, :, axis] = _coordinate(box, origin, end, point, last)
        if not last:
            shadow = np.zeros_like(box)
            coordinates = np.zeros((2, n_points))
            next_points = np.zeros(n_points, dtype=np.int64)
            next_count = project(
                box, shadow, coordinates, points, len(points), next_points, origin, end
            )
            if next_count < 0:
                raise ValueError('no placement has these distances')
            box, points = shadow, next_points[:next_count]
    return enclosure


def _coordinate(
    box: FloatArray, origin: int, end: int, point: int, on_line: bool
) -> tuple[float, float]:
    """Bound the coordinate of a point along one axis of the frame."""
    near_lower, near_upper = box[:2, origin, point]
    far_lower, far_upper = box[:2, end, point]
    if np.isinf(near_upper) or np.isinf(far_upper):
        return -np.inf, np.inf
    low, high = axis_coordinate(
        near_lower,
        near_upper,
        far_lower,
        far_upper,
        sqrt_down(box[LOWER, origin, end]),
        sqrt_up(box[UPPER, origin, end]),
    )
    if on_line:
        low, high = reverse_square(low, high, near_lower, near_upper)
    if low > high:
        raise ValueError('no placement has these distances')
    return low, high
