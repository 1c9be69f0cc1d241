# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The pebble game: which points of a fleet in the plane are rigid together.

Every point has two pebbles, its degrees of freedom in the plane. A pair that is independent of
those before it takes one of them, and three that stay free on a pair are the motions of a rigid
body (Jacobs, Hendrickson, J. Comput. Phys. 137(2), 1997). What holds is generic: it is true of
almost all placements with this graph.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import BoolArray

FREE = -1


@kernel(borrows=True)
def _n_free(pebbles: IntArray, point: int) -> int:
    """Return how many pebbles lie on a point."""
    return int(pebbles[point, 0] == FREE) + int(pebbles[point, 1] == FREE)


@kernel(borrows=True)
def _fetch_pebble(
    pebbles: IntArray, point: int, other: int, parent: IntArray, stack: IntArray
) -> bool:
    """Bring a free pebble to `point` from any point but `other`; tell whether there was one."""
    parent[:] = FREE
    parent[point] = point
    parent[other] = other
    stack[0] = point
    height = 1
    while height:
        height -= 1
        here = stack[height]
        for slot in range(2):
            there = pebbles[here, slot]
            if there == FREE or parent[there] != FREE:
                continue
            parent[there] = here
            if _n_free(pebbles, there) == 0:
                stack[height] = there
                height += 1
                continue
            # The pairs along the way are held from their other ends.
            taken = 0 if pebbles[there, 0] == FREE else 1
            while there != point:
                above = parent[there]
                pebbles[there, taken] = above
                taken = 0 if pebbles[above, 0] == there else 1
                there = above
            pebbles[point, taken] = FREE
            return True
    return False


@kernel(borrows=True)
def _gather(
    pebbles: IntArray, i: int, j: int, wanted: int, parent: IntArray, stack: IntArray
) -> bool:
    """Bring so many pebbles to two points; tell whether that is possible."""
    while _n_free(pebbles, i) + _n_free(pebbles, j) < wanted:
        if _n_free(pebbles, i) < 2 and _fetch_pebble(pebbles, i, j, parent, stack):
            continue
        if _n_free(pebbles, j) < 2 and _fetch_pebble(pebbles, j, i, parent, stack):
            continue
        return False
    return True


@kernel
def play(n_points: int, pairs: IntArray) -> tuple[IntArray, int]:
    """
    Play the game over all pairs.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    pebbles : ndarray of int, shape (n, 2)
        The pair that each pebble holds, by the point at its other end; FREE for none.
    rank : int
        The number of independent pairs; 2 n - 3 when all points are rigid together.

    """
    pebbles = np.full((n_points, 2), FREE)
    parent = np.empty(n_points, dtype=np.int64)
    stack = np.empty(n_points, dtype=np.int64)
    rank = 0
    for x in range(len(pairs)):
        i, j = pairs[x, 0], pairs[x, 1]
        if _gather(pebbles, i, j, 4, parent, stack):
            pebbles[i, 0 if pebbles[i, 0] == FREE else 1] = j
            rank += 1
    return pebbles, rank


@kernel
def _rigid_with(pebbles: IntArray, i: int, j: int, rigid: BoolArray, stack: IntArray) -> None:
    """Write which points are rigid with a measured pair: those that no free pebble can reach."""
    n_points = len(pebbles)
    parent = np.empty(n_points, dtype=np.int64)
    _gather(pebbles, i, j, 3, parent, stack)
    first = np.full(n_points, FREE)
    following = np.full(2 * n_points, FREE)
    for point in range(n_points):
        for slot in range(2):
            held = pebbles[point, slot]
            if held != FREE:
                following[2 * point + slot] = first[held]
                first[held] = 2 * point + slot
    rigid[:] = True
    height = 0
    for point in range(n_points):
        if point != i and point != j and _n_free(pebbles, point):
            rigid[point] = False
            stack[height] = point
            height += 1
    while height:
        height -= 1
        arc = first[stack[height]]
        while arc != FREE:
            point = arc // 2
            if rigid[point]:
                rigid[point] = False
                stack[height] = point
                height += 1
            arc = following[arc]


@kernel
def rigid_components_2d(n_points: int, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """
    Return the maximal sets of points in the plane that are rigid together.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    offsets, members : ndarray of int
        Component k has the points ``members[offsets[k]:offsets[k + 1]]``, ascending. Two
        components share one point at most; every pair lies in one.

    """
    pebbles, _ = play(n_points, pairs)
    stack = np.empty(n_points, dtype=np.int64)
    rigid = np.empty(n_points, dtype=np.bool_)
    assigned = np.zeros(len(pairs), dtype=np.bool_)
    offsets = np.zeros(len(pairs) + 1, dtype=np.int64)
    # Components share points but no pairs, of which each has at least one less than points.
    members = np.empty(2 * len(pairs) + 1, dtype=np.int64)
    count = 0
    for x in range(len(pairs)):
        if assigned[x]:
            continue
        _rigid_with(pebbles, pairs[x, 0], pairs[x, 1], rigid, stack)
        end = offsets[count]
        for point in range(n_points):
            if rigid[point]:
                members[end] = point
                end += 1
        for y in range(x, len(pairs)):
            if rigid[pairs[y, 0]] and rigid[pairs[y, 1]]:
                assigned[y] = True
        count += 1
        offsets[count] = end
    return offsets[: count + 1].copy(), members[: offsets[count]].copy()
