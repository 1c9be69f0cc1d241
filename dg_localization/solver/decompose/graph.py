# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Graphs of measured pairs: neighbors, connected parts, and points whose removal disconnects them.

Everything in this package works on the graph only. Its results affect the work of a search, never
the soundness: any set of points may be solved as a problem of its own.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import IntArray

Pair = tuple[int, int]
Points = tuple[int, ...]
BoolArray = NDArray[np.bool_]


class Graph(NamedTuple):
    """The neighbors of point i are ``neighbors[start[i]:start[i + 1]]``."""

    start: IntArray
    neighbors: IntArray


def pairs_of(points: Iterable[int]) -> tuple[Pair, ...]:
    """Return all pairs of some points, the smaller point first."""
    return tuple(combinations(sorted(points), 2))


def graph_of(n_points: int, pairs: IntArray) -> Graph:
    """Return the graph of some pairs of points, each pair once."""
    both = np.concatenate([pairs, pairs[:, ::-1]])
    ends = both[np.lexsort((both[:, 1], both[:, 0]))]
    start = np.searchsorted(ends[:, 0], np.arange(n_points + 1)).astype(np.int64)
    return Graph(start, np.ascontiguousarray(ends[:, 1]))


def restricted_pairs(n_points: int, pairs: IntArray, points: IntArray) -> IntArray:
    """Return the pairs among some points, ascending, renumbered by their order."""
    number = np.full(n_points, -1)
    number[points] = np.arange(len(points))
    ends = number[pairs]
    return np.ascontiguousarray(ends[(ends >= 0).all(axis=1)])


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
    """Return which points would disconnect the graph without `removed` points if removed too."""
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
