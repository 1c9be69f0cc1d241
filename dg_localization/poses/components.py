# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which boxes of a cover touch each other: kernels."""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.poses.half_spaces import HIGH, LOW, YAW, X, with_error
from dg_localization.poses.turns import TURN


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
