# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of far pairs from chains of known ones.

Two points are no farther apart than any chain of known pairs between them is long, and no nearer
than a known pair at one of them exceeds the chain from its other end. Nothing else is known of a
pair that no patch holds.
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
from dg_localization.solver.decompose.graph import Graph


class ChainGraph:
    """Points and the bounds of known pairs of them."""

    def __init__(
        self, n_points: int, pairs: IntArray, lower: FloatArray, upper: FloatArray
    ) -> None:
        self._n_points = n_points
        both = np.concatenate([pairs, pairs[:, ::-1]])
        self._order = np.lexsort((both[:, 1], both[:, 0]))
        ends = both[self._order]
        start = np.searchsorted(ends[:, 0], np.arange(n_points + 1)).astype(np.int64)
        self._graph = Graph(start, np.ascontiguousarray(ends[:, 1]))
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
        lower, upper = self._bounds_among(distinct)
        return lower[np.ix_(place, place)], upper[np.ix_(place, place)]

    def _bounds_among(self, points: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of all pairs of different points, in their order."""
        start, neighbors = self._graph
        column_of = np.full(self._n_points, -1)
        column_of[points] = np.arange(len(points))
        sources, radii_m = _sources(start, neighbors, self._lower, points)
        row_of = np.full(self._n_points, -1)
        row_of[sources] = np.arange(len(sources))
        lengths_m = _chain_lengths(start, neighbors, self._upper, sources, radii_m, column_of)
        args = start, neighbors, self._lower, self._upper
        lower, upper = _bounds(*args, points, row_of, lengths_m)
        return np.maximum(lower, lower.T), np.minimum(upper, upper.T)

    def pivot_lengths_m(
        self, most: int, stopped: Callable[[], bool] = lambda: False
    ) -> tuple[IntArray, FloatArray]:
        """Return points that lie far from each other, and how long chains from them are."""
        start, neighbors = self._graph
        every = np.arange(self._n_points)
        pivots, lengths_m = [0], []
        nearest_m = np.full(self._n_points, np.inf)
        for _ in range(min(most, self._n_points)):
            source = np.array(pivots[-1:])
            args = start, neighbors, self._upper, source, np.array([np.inf]), every
            lengths_m.append(_chain_lengths(*args)[0])
            nearest_m = np.minimum(nearest_m, lengths_m[-1])
            pivots.append(int(np.argmax(nearest_m)))
            if stopped():
                break
        return np.array(pivots[:-1]), np.array(lengths_m)


@kernel
def _sources(
    start: IntArray, neighbors: IntArray, lower: FloatArray, points: IntArray
) -> tuple[IntArray, FloatArray]:
    """
    Return where chains to some points have to begin, and how long in m they may be to matter.

    A chain from one of the points may have any length. One from a neighbor serves to show that a
    pair exceeds it, and is of no use beyond the length of that pair.
    """
    radius_m = np.full(len(start) - 1, -1.0)
    for i in points:
        for z in range(start[i], start[i + 1]):
            j = neighbors[z]
            radius_m[j] = max(radius_m[j], sqrt_up(lower[z]))
    for i in points:
        radius_m[i] = np.inf
    sources = np.flatnonzero(radius_m >= 0.0)
    return sources, radius_m[sources]


@kernel
def _chain_lengths(
    start: IntArray,
    neighbors: IntArray,
    upper: FloatArray,
    sources: IntArray,
    radii_m: FloatArray,
    column_of: IntArray,
) -> FloatArray:
    """
    Return the length in m of the shortest chain from each source to each target, rounded up.

    The columns of the targets are ``column_of[target]``, -1 elsewhere. No chain is followed beyond
    the radius of its source, nor farther than to the last target.
    """
    n_points = len(start) - 1
    n_targets = (column_of >= 0).sum()
    lengths_m = np.full((len(sources), n_targets), np.inf)
    length_m = np.full(n_points, np.inf)
    reached = np.empty(n_points, dtype=np.int64)
    heap_m = np.empty(len(neighbors) + 1)
    heap = np.empty(len(neighbors) + 1, dtype=np.int64)
    for row in range(len(sources)):
        length_m[sources[row]] = 0.0
        reached[0], n_reached = sources[row], 1
        heap_m[0], heap[0] = 0.0, sources[row]
        size = 1
        n_left = n_targets
        while size and n_left:
            here_m, point = heap_m[0], heap[0]
            size -= 1
            _sink(heap_m, heap, size, heap_m[size], heap[size])
            if here_m > radii_m[row]:
                break
            if here_m > length_m[point]:
                continue
            if column_of[point] >= 0:
                lengths_m[row, column_of[point]] = here_m
                n_left -= 1
            for x in range(start[point], start[point + 1]):
                other = neighbors[x]
                there_m = up(here_m + sqrt_up(upper[x]))
                if there_m < length_m[other]:
                    if length_m[other] == np.inf:
                        reached[n_reached] = other
                        n_reached += 1
                    length_m[other] = there_m
                    _rise(heap_m, heap, size, there_m, other)
                    size += 1
        for x in range(n_reached):
            length_m[reached[x]] = np.inf
    return lengths_m


@kernel(borrows=True)
def _rise(heap_m: FloatArray, heap: IntArray, at: int, key_m: float, point: int) -> None:
    """Insert a point at the end of a heap and move it up to its place."""
    while at > 0 and heap_m[(at - 1) // 2] > key_m:
        heap_m[at], heap[at] = heap_m[(at - 1) // 2], heap[(at - 1) // 2]
        at = (at - 1) // 2
    heap_m[at], heap[at] = key_m, point


@kernel(borrows=True)
def _sink(heap_m: FloatArray, heap: IntArray, size: int, key_m: float, point: int) -> None:
    """Replace the first point of a heap and move the new one down to its place."""
    at = 0
    while 2 * at + 1 < size:
        below = 2 * at + 1
        if below + 1 < size and heap_m[below + 1] < heap_m[below]:
            below += 1
        if heap_m[below] >= key_m:
            break
        heap_m[at], heap[at] = heap_m[below], heap[below]
        at = below
    heap_m[at], heap[at] = key_m, point


@kernel
def _bounds(
    start: IntArray,
    neighbors: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    points: IntArray,
    row_of: IntArray,
    lengths_m: FloatArray,
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds that chains put on all pairs of some points, in m^2."""
    size = len(points)
    low = np.zeros((size, size))
    high = np.zeros((size, size))
    for x in range(size):
        i = points[x]
        for y in range(size):
            if x != y:
                length_m = lengths_m[row_of[i], y]
                high[x, y] = square_up(length_m) if length_m < np.inf else np.inf
        for z in range(start[i], start[i + 1]):
            j = neighbors[z]
            least_m = sqrt_down(lower[z])
            for y in range(size):
                k = points[y]
                if k == j:
                    low[x, y] = max(low[x, y], lower[z])
                    high[x, y] = min(high[x, y], upper[z])
                elif k != i:
                    rest_m = down(least_m - lengths_m[row_of[j], y])
                    if rest_m > 0.0:
                        low[x, y] = max(low[x, y], square_down(rest_m))
    return low, high
