# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Connected components of boxes: kernels."""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import rounding_error

LOW, HIGH = 0, 1


@kernel(borrows=True)
def _touch(first: np.ndarray, second: np.ndarray, period: float) -> bool:
    """Return whether two boxes have a point in common, or may have one in the rounded period."""
    last = first.shape[1] - 1
    for axis in range(last):
        if first[LOW, axis] > second[HIGH, axis] or second[LOW, axis] > first[HIGH, axis]:
            return False
    if period == math.inf:
        return first[LOW, last] <= second[HIGH, last] and second[LOW, last] <= first[HIGH, last]
    error = rounding_error(8.0 * period, 8.0)
    for turns in range(-1, 2):
        shift = turns * period
        above = second[HIGH, last] + shift - first[LOW, last]
        below = first[HIGH, last] - (second[LOW, last] + shift)
        if above >= -error and below >= -error:
            return True
    return False


@kernel(borrows=True)
def _first_of(parents: np.ndarray, index: int) -> int:
    """Return the first box of the component of a box (with path compression)."""
    while parents[index] != index:
        parents[index] = parents[parents[index]]
        index = parents[index]
    return index


@kernel(borrows=True)
def _join_touching(
    boxes: np.ndarray, order: np.ndarray, period: float, parents: np.ndarray
) -> None:
    """Join all boxes that touch; `order` sorts them along the first axis."""
    for place in range(len(order)):
        first = order[place]
        for later in range(place + 1, len(order)):
            second = order[later]
            if boxes[second, LOW, 0] > boxes[first, HIGH, 0]:
                break
            if _touch(boxes[first], boxes[second], period):
                one, other = _first_of(parents, first), _first_of(parents, second)
                parents[max(one, other)] = min(one, other)
    for index in range(len(order)):
        parents[index] = _first_of(parents, index)


def components(boxes: np.ndarray, period: float = math.inf) -> list[np.ndarray]:
    """
    Return the boxes of each connected component, in the order of their first boxes.

    Boxes of any coordinates, shape (k, 2, d), are connected if they have a point in common; the
    last coordinate may be an angle with a period.
    """
    parents = np.arange(len(boxes))
    if len(boxes) < 2:
        return [parents] * len(boxes)
    _join_touching(boxes, np.argsort(boxes[:, LOW, 0], kind='stable'), period, parents)
    return [np.flatnonzero(parents == first) for first in np.unique(parents)]
