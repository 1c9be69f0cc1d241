"""The graph of the bounded distances: connected points, and points that hold on too few."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


def connected_to(joined: BoolArray, start: int) -> set[int]:
    """
    Return the points that a chain of joined pairs connects to one of them.

    Parameters
    ----------
    joined : numpy.ndarray of bool, shape (n, n)
        Which pairs are joined.
    start : int

    Returns
    -------
    set of int
        `start` included.

    """
    reached = {start}
    pending = [start]
    while pending:
        new = set(np.flatnonzero(joined[pending.pop()]).tolist()) - reached
        reached |= new
        pending.extend(new)
    return reached


def pendant_points(
    joined: BoolArray, component: Sequence[int], kept: set[int], dimension: int
) -> list[int]:
    """
    Return the points of a connected part that fewer than q distances hold.

    Parameters
    ----------
    joined : numpy.ndarray of bool, shape (n, n)
        Which distances are bounded; the diagonal does not count.
    component : sequence of int
        The connected part.
    kept : set of int
        Points that do not count as pendant.
    dimension : int

    Returns
    -------
    list of int
        Each has at least one and fewer than q distances to the points not listed before it.

    """
    joined = joined & ~np.eye(len(joined), dtype=bool)
    remaining = list(component)
    pendant: list[int] = []
    while True:
        # One at a time, the last in the list first: one pendant point may hold another.
        for point in reversed(remaining):
            rest = [other for other in remaining if other != point]
            if point in kept or joined[point, rest].sum() >= dimension:
                continue
            # What joins two parts of the fleet is not pendant.
            if len(connected_to(joined[np.ix_(rest, rest)], 0)) == len(rest):
                break
        else:
            return pendant
        pendant.append(point)
        remaining = rest
