# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which boxes of a cover touch each other, and the ground they cover: kernels."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.pairs.half_spaces import HIGH, LOW, YAW, X, with_error
from dg_localization.pairs.turns import TURN


@kernel(borrows=True)
def _yaws_touch(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two arcs have an angle in common, or may have one."""
    for turns in range(-1, 2):
        shift = turns * TURN
        if first[LOW, YAW] <= with_error(second[HIGH, YAW] + shift, 4.0 * TURN) and second[
            LOW, YAW
        ] + shift <= with_error(first[HIGH, YAW], 4.0 * TURN):
            return True
    return False


@kernel(borrows=True)
def _touch(first: np.ndarray, second: np.ndarray) -> bool:
    """Return whether two boxes have a pose in common."""
    for axis in range(YAW):
        if first[LOW, axis] > second[HIGH, axis] or second[LOW, axis] > first[HIGH, axis]:
            return False
    return _yaws_touch(first, second)


@kernel(borrows=True)
def _root(parents: np.ndarray, index: int) -> int:
    """Return the representative of a box, and shorten the way to it."""
    while parents[index] != index:
        parents[index] = parents[parents[index]]
        index = parents[index]
    return index


@kernel(borrows=True)
def _join_touching(boxes: np.ndarray, order: np.ndarray, parents: np.ndarray) -> None:
    """Join all boxes that touch; `order` sorts them by their lower x."""
    for place in range(order.shape[0]):
        first = order[place]
        for later in range(place + 1, order.shape[0]):
            second = order[later]
            if boxes[second, LOW, X] > boxes[first, HIGH, X]:
                break
            if _touch(boxes[first], boxes[second]):
                parents[_root(parents, second)] = _root(parents, first)
    for index in range(order.shape[0]):
        parents[index] = _root(parents, index)


def label_boxes(boxes: np.ndarray) -> np.ndarray:
    """
    Return the component of each box: equal for boxes that are connected by touching ones.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (n, 2, 4)

    Returns
    -------
    numpy.ndarray of int, shape (n,)

    """
    parents = np.arange(len(boxes))
    _join_touching(boxes, np.argsort(boxes[:, LOW, X], kind='stable'), parents)
    return parents


@kernel(borrows=True)
def _covered_length(rectangles: np.ndarray, order: np.ndarray, x: float) -> float:
    """Return the length of y covered at `x`; `order` sorts the rectangles by their lower y."""
    length, top = 0.0, -np.inf
    for place in range(order.shape[0]):
        low_x, low_y = rectangles[order[place], LOW, 0], rectangles[order[place], LOW, 1]
        high_x, high_y = rectangles[order[place], HIGH, 0], rectangles[order[place], HIGH, 1]
        if low_x <= x <= high_x and high_y > top:
            length += high_y - max(low_y, top)
            top = high_y
    return length


@kernel(borrows=True)
def _strips(rectangles: np.ndarray, order: np.ndarray, edges: np.ndarray) -> float:
    """Add the strips between neighboring edges of x."""
    area = 0.0
    for place in range(edges.shape[0] - 1):
        width = edges[place + 1] - edges[place]
        if width > 0.0:
            middle = edges[place] + 0.5 * width
            area += width * _covered_length(rectangles, order, middle)
    return area


def covered_area(rectangles: np.ndarray) -> float:
    """
    Return the area that rectangles cover together, in plain arithmetic.

    Parameters
    ----------
    rectangles : numpy.ndarray, shape (n, 2, 2)
        Lower and upper x and y.

    """
    edges = np.unique(rectangles[:, :, 0])
    order = np.argsort(rectangles[:, LOW, 1], kind='stable')
    return float(_strips(rectangles, order, edges))
