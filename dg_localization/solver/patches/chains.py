# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of far pairs from chains of known pairs.

The distance of two points is at most the length of any chain of known pairs between them. It is at
least a known distance at one of them minus the length of a chain from its other end. A pair in no
patch has only these bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import (
    down,
    sqrt_down,
    sqrt_up,
    square_down,
    square_up,
    up,
)
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import Graph, graph_of


class ChainGraph:
    """Points and the bounds in m^2 of known pairs of them, smaller point first."""

    def __init__(
        self, n_points: int, pairs: IntArray, lower: FloatArray, upper: FloatArray
    ) -> None:
        self._n_points = n_points
        self._graph = graph_of(n_points, pairs)
        both = np.concatenate([pairs, pairs[:, ::-1]])
        self._order = np.lexsort((both[:, 1], both[:, 0]))
        self._set_bounds(lower, upper)

    def _set_bounds(self, lower: FloatArray, upper: FloatArray) -> None:
        self._lower = np.concatenate([lower, lower])[self._order]
        self._upper = np.concatenate([upper, upper])[self._order]

    def with_bounds(self, lower: FloatArray, upper: FloatArray) -> ChainGraph:
        """Return the same pairs with other bounds in m^2, shapes (m,)."""
        other = copy(self)
        other._set_bounds(lower, upper)
        return other

    def bounds(self, points: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of all pairs of some points."""
        distinct, place = np.unique(points, return_inverse=True)
        lower, upper = _bounds(self._graph, self._lower, self._upper, distinct)
        lower, upper = np.maximum(lower, lower.T), np.minimum(upper, upper.T)
        return lower[np.ix_(place, place)], upper[np.ix_(place, place)]

    def pivot_lengths_m(
        self, most: int, stopped: Callable[[], bool]
    ) -> tuple[IntArray, FloatArray]:
        """Return points that are far from each other, and the lengths of chains from them."""
        pivots, lengths_m = [0], []
        nearest_m = np.full(self._n_points, np.inf)
        for _ in range(min(most, self._n_points)):
            lengths_m.append(_chain_lengths(self._graph, self._upper, pivots[-1], np.inf))
            nearest_m = np.minimum(nearest_m, lengths_m[-1])
            pivots.append(int(np.argmax(nearest_m)))
            if stopped():
                break
        return np.array(pivots[:-1]), np.array(lengths_m)


@kernel
def _chain_lengths(graph: Graph, upper: FloatArray, source: int, radius_m: float) -> FloatArray:
    """
    Return the length in m of the shortest chain from a source to each point, rounded up.

    No chain is followed beyond a radius. (Bellman, Ford and Moore: points wait in a ring buffer
    until their neighbors are examined.)
    """
    n_points = len(graph.start) - 1
    length_m = np.full(n_points, np.inf)
    length_m[source] = 0.0
    waits = np.zeros(n_points, dtype=np.bool_)
    ring = np.empty(n_points, dtype=np.int64)
    ring[0] = source
    head, n_waiting = 0, 1
    while n_waiting:
        point = ring[head]
        head = (head + 1) % n_points
        n_waiting -= 1
        waits[point] = False
        for x in range(graph.start[point], graph.start[point + 1]):
            other = graph.neighbors[x]
            there_m = up(length_m[point] + sqrt_up(upper[x]))
            if there_m < length_m[other] and there_m <= radius_m:
                length_m[other] = there_m
                if not waits[other]:
                    waits[other] = True
                    ring[(head + n_waiting) % n_points] = other
                    n_waiting += 1
    return length_m


@kernel
def _bounds(
    graph: Graph, lower: FloatArray, upper: FloatArray, points: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds that chains put on all pairs of some points, in m^2."""
    size = len(points)
    low = np.zeros((size, size))
    high = np.full((size, size), np.inf)
    # A chain from a neighbor gives a lower bound only if it is shorter than the known pair.
    radius_m = np.full(len(graph.start) - 1, -1.0)
    for x in range(size):
        high[x, x] = 0.0
        for z in range(graph.start[points[x]], graph.start[points[x] + 1]):
            near = graph.neighbors[z]
            radius_m[near] = max(radius_m[near], sqrt_up(lower[z]))
    radius_m[points] = np.inf
    place = np.full(len(radius_m), -1)
    for x in range(size):
        place[points[x]] = x
    for source in range(len(radius_m)):
        if radius_m[source] < 0.0:
            continue
        length_m = _chain_lengths(graph, upper, source, radius_m[source])
        x = place[source]
        if x >= 0:
            for y in range(size):
                if x != y and length_m[points[y]] < np.inf:
                    high[x, y] = min(high[x, y], square_up(length_m[points[y]]))
        for z in range(graph.start[source], graph.start[source + 1]):
            x = place[graph.neighbors[z]]
            if x < 0:
                continue
            least_m = sqrt_down(lower[z])
            for y in range(size):
                if points[y] == source:
                    low[x, y] = max(low[x, y], lower[z])
                    high[x, y] = min(high[x, y], upper[z])
                elif y != x:
                    rest_m = down(least_m - length_m[points[y]])
                    if rest_m > 0.0:
                        low[x, y] = max(low[x, y], square_down(rest_m))
    return low, high
