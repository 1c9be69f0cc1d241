# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Separating pairs, from neighborhoods: pairs of points whose removal disconnects a graph.

Where no single point disconnects a graph, a pair {i, j} does when and only when it leaves the
neighbors of i in several parts. Mostly the points around i show whether there is such a j. They
are searched depth first (Tarjan, 1972): where the search does not come back past j from below, j
parts what is below it from the rest. If neighbors of i are on both sides, and on one side no point
has a link to points that are farther away, {i, j} separates the whole graph. Where both sides have
such links, they may meet there, and more points are searched, up to all. What holds the neighbors
of i together without j does so in the whole graph, too.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import Graph

FIRST_POINTS, LARGER = 32, 4
"""About so many points are searched around each point first, and this factor more where they do
not decide."""

OUTSIDE, CENTER = -1, -2
NOTHING, PARTS, SEPARATES = 0, 1, 2


class _Around(NamedTuple):
    """
    The points around a center, by their places in the order in which they were reached.

    Attributes
    ----------
    point : ndarray of int, shape (n,)
        The point at each place; the neighbors of the center come first.
    place : ndarray of int, shape (n,)
        The place of each point of the graph, OUTSIDE for those farther away.
    is_open : ndarray of int, shape (n,)
        1 where a point has links to points farther away.
    n_near, n_open : ndarray of int, shape (n,)
        How many neighbors of the center, and how many open points, the search found from a place
        on, itself among them.
    number, lowest : ndarray of int, shape (n,)
        When the search came to a place, and the earliest place that it comes back to from there.
    above, following : ndarray of int, shape (n,)
        The place it came from, and the next link to follow.
    verdict : ndarray of int, shape (n,)
        Whether a place parts the neighbors of the center as far as is seen, or certainly.

    """

    point: IntArray
    place: IntArray
    is_open: IntArray
    n_near: IntArray
    n_open: IntArray
    number: IntArray
    lowest: IntArray
    above: IntArray
    following: IntArray
    verdict: IntArray


@kernel
def _nothing_around(n_points: int) -> _Around:
    """Return room for all points."""
    place = np.full(n_points, OUTSIDE)
    room = np.empty((9, n_points), dtype=np.int64)
    return _Around(
        room[0], place, room[1], room[2], room[3], room[4], room[5], room[6], room[7], room[8]
    )


@kernel(borrows=True)
def _gather(graph: Graph, center: int, around: _Around, most: int) -> int:
    """Write the points around a center, about so many; return their number."""
    point, place = around.point, around.place
    place[center] = CENTER
    here = center
    size, n_done = 0, 0
    while True:
        for x in range(graph.start[here], graph.start[here + 1]):
            other = graph.neighbors[x]
            if place[other] == OUTSIDE:
                place[other] = size
                point[size] = other
                size += 1
        if n_done == size or size >= most:
            break
        here = point[n_done]
        n_done += 1
    n_neighbors = graph.start[center + 1] - graph.start[center]
    for x in range(size):
        around.is_open[x] = 0
        for y in range(graph.start[point[x]], graph.start[point[x] + 1]):
            if place[graph.neighbors[y]] == OUTSIDE:
                around.is_open[x] = 1
                break
        around.n_near[x] = 1 if x < n_neighbors else 0
        around.n_open[x] = around.is_open[x]
        around.number[x] = OUTSIDE
        around.following[x] = graph.start[point[x]]
        around.verdict[x] = NOTHING
    return size


@kernel(borrows=True)
def _judge(around: _Around, here: int, below: int, n_neighbors: int, n_open: int) -> None:
    """Write what it means that the search does not come back past a place from below."""
    n_near_else = n_neighbors - around.n_near[below] - (1 if here < n_neighbors else 0)
    if around.n_near[below] == 0 or n_near_else == 0:
        return
    n_open_else = n_open - around.n_open[below] - around.is_open[here]
    is_certain = around.n_open[below] == 0 or n_open_else == 0
    around.verdict[here] = max(around.verdict[here], SEPARATES if is_certain else PARTS)


@kernel(borrows=True)
def _search(graph: Graph, around: _Around, n_neighbors: int, n_open: int) -> None:
    """Search the points around a center from its first neighbor, and judge each place."""
    place, number, lowest, above = around.place, around.number, around.lowest, around.above
    number[0] = lowest[0] = 0
    above[0] = OUTSIDE
    count = 1
    here = 0
    while here != OUTSIDE:
        point = around.point[here]
        if around.following[here] < graph.start[point + 1]:
            other = place[graph.neighbors[around.following[here]]]
            around.following[here] += 1
            if other < 0 or other == above[here]:
                continue
            if number[other] == OUTSIDE:
                above[other] = here
                number[other] = lowest[other] = count
                count += 1
                here = other
            else:
                lowest[here] = min(lowest[here], number[other])
            continue
        before = above[here]
        if before != OUTSIDE:
            lowest[before] = min(lowest[before], lowest[here])
            if lowest[here] >= number[before]:
                _judge(around, before, here, n_neighbors, n_open)
            around.n_near[before] += around.n_near[here]
            around.n_open[before] += around.n_open[here]
        here = before


@kernel(borrows=True)
def _is_decided(graph: Graph, center: int, around: _Around, size: int) -> bool:
    """Search the points around a center; tell whether they show all that separates with it."""
    n_neighbors = graph.start[center + 1] - graph.start[center]
    n_open = 0
    for x in range(size):
        n_open += around.is_open[x]
    _search(graph, around, n_neighbors, n_open)
    if n_open == 0:
        return True
    if around.n_near[0] < n_neighbors:
        return False
    for x in range(size):
        if around.verdict[x] == PARTS:
            return False
    return True


@kernel
def _separating_pairs_from(graph: Graph, first: int, work: int) -> tuple[IntArray, int]:
    """Return the separating pairs whose smaller point comes next, and what follows these."""
    n_points = len(graph.start) - 1
    around = _nothing_around(n_points)
    pairs = np.empty((16, 2), dtype=np.int64)
    count = 0
    center = first
    while center < n_points and work > 0:
        most = FIRST_POINTS
        while True:
            size = _gather(graph, center, around, most)
            is_decided = _is_decided(graph, center, around, size)
            for x in range(size):
                around.place[around.point[x]] = OUTSIDE
            around.place[center] = OUTSIDE
            work -= size
            if is_decided:
                break
            most *= LARGER
        for x in range(size):
            if around.verdict[x] == SEPARATES and around.point[x] > center:
                if count == len(pairs):
                    more = np.empty((2 * count, 2), dtype=np.int64)
                    more[:count] = pairs
                    pairs = more
                pairs[count, 0], pairs[count, 1] = center, around.point[x]
                count += 1
        center += 1
    return pairs[:count].copy(), center


def separating_pairs(graph: Graph) -> IntArray:
    """
    Return all pairs of points whose removal disconnects a graph.

    Parameters
    ----------
    graph : Graph
        A graph that the removal of no single point disconnects.

    Returns
    -------
    ndarray of int, shape (k, 2)
        The pairs, ascending, the smaller point first.

    """
    n_points = len(graph.start) - 1
    found = []
    center = 0
    while center < n_points:
        pairs, center = _separating_pairs_from(graph, center, 1 + WORK_PER_LOOK // 16)
        found.append(pairs)
        look_after(WORK_PER_LOOK)
    pairs = np.concatenate(found)
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])
