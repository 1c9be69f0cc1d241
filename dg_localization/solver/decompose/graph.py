# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Graphs of measured pairs: neighbors, connected parts, and points whose removal disconnects them.

Everything in this room works on the graph alone. What it finds decides how much work a search
has, never what is true: any set of points may be solved as a problem of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import IntArray

Pair = tuple[int, int]
BoolArray = NDArray[np.bool_]


class Graph(NamedTuple):
    """The neighbors of point i are ``neighbors[start[i]:start[i + 1]]``."""

    start: IntArray
    neighbors: IntArray


@kernel
def graph_of(n_points: int, pairs: IntArray) -> Graph:
    """Return the graph of some pairs of points, each pair once."""
    start = np.zeros(n_points + 1, dtype=np.int64)
    for x in range(len(pairs)):
        start[pairs[x, 0] + 1] += 1
        start[pairs[x, 1] + 1] += 1
    start = np.cumsum(start)
    end = start[:-1].copy()
    neighbors = np.empty(2 * len(pairs), dtype=np.int64)
    for x in range(len(pairs)):
        for side in range(2):
            point = pairs[x, side]
            neighbors[end[point]] = pairs[x, 1 - side]
            end[point] += 1
    return Graph(start, neighbors)


@kernel
def _pairs_among(graph: Graph, points: IntArray, number: IntArray) -> IntArray:
    """Return the pairs among some points, by their places; `number` is -1 before and after."""
    n_arcs = 0
    for x in range(len(points)):
        number[points[x]] = x
        n_arcs += graph.start[points[x] + 1] - graph.start[points[x]]
    pairs = np.empty((n_arcs, 2), dtype=np.int64)
    count = 0
    for x in range(len(points)):
        for arc in range(graph.start[points[x]], graph.start[points[x] + 1]):
            other = number[graph.neighbors[arc]]
            if other > x:
                pairs[count, 0], pairs[count, 1] = x, other
                count += 1
    for x in range(len(points)):
        number[points[x]] = -1
    return pairs[:count].copy()


class Subgraphs:
    """The parts of a graph, each in the time that its own points take."""

    def __init__(self, n_points: int, pairs: IntArray) -> None:
        self._graph = graph_of(n_points, pairs)
        self._number = np.full(n_points, -1)
        # Numbers, and not tuples: these are what a collection of garbage looks at.
        self._keys = set((pairs[:, 0] * n_points + pairs[:, 1]).tolist())

    def __contains__(self, pair: Pair) -> bool:
        """Return whether a pair is in the graph, its smaller point first."""
        return pair[0] * len(self._number) + pair[1] in self._keys

    def pairs_among(self, points: IntArray, more: Sequence[Pair]) -> IntArray:
        """Return the pairs that join some points."""
        pairs = _pairs_among(self._graph, points, self._number)
        if not more:
            return pairs
        return np.concatenate([pairs, np.searchsorted(points, np.array(more))])


@kernel
def connected_parts(graph: Graph, removed: BoolArray) -> IntArray:
    """Return the connected parts of a graph without some of its points."""
    n_points = len(graph.start) - 1
    part = np.full(n_points, -1)
    stack = np.empty(n_points, dtype=np.int64)
    n_parts = 0
    for seed in range(n_points):
        if removed[seed] or part[seed] >= 0:
            continue
        part[seed] = n_parts
        stack[0] = seed
        height = 1
        while height:
            height -= 1
            point = stack[height]
            for x in range(graph.start[point], graph.start[point + 1]):
                other = graph.neighbors[x]
                if part[other] < 0 and not removed[other]:
                    part[other] = n_parts
                    stack[height] = other
                    height += 1
        n_parts += 1
    return part


@kernel
def cut_points(graph: Graph, removed: BoolArray) -> BoolArray:
    """Tell whose removal leaves more connected parts, after some points are removed already."""
    n_points = len(graph.start) - 1
    is_cut = np.zeros(n_points, dtype=np.bool_)
    number = np.full(n_points, -1)
    lowest = np.empty(n_points, dtype=np.int64)
    parent = np.full(n_points, -1)
    following = graph.start[:-1].copy()
    count = 0
    for root in range(n_points):
        if removed[root] or number[root] >= 0:
            continue
        n_children = 0
        number[root] = lowest[root] = count
        count += 1
        point = root
        while point >= 0:
            if following[point] < graph.start[point + 1]:
                other = graph.neighbors[following[point]]
                following[point] += 1
                if removed[other] or other == parent[point]:
                    continue
                if number[other] >= 0:
                    lowest[point] = min(lowest[point], number[other])
                    continue
                parent[other] = point
                number[other] = lowest[other] = count
                count += 1
                if point == root:
                    n_children += 1
                point = other
                continue
            above = parent[point]
            if above >= 0:
                lowest[above] = min(lowest[above], lowest[point])
                if above != root and lowest[point] >= number[above]:
                    is_cut[above] = True
            point = above
        is_cut[root] = n_children > 1
    return is_cut
