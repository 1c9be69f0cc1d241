# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Decomposition of a fleet: which points are rigid together, and how these pieces are joined.

The rigid components of the graph of measured pairs are split at their separating sets. A piece
that the measurements among its own points do not hold rigid takes the distances of the points it
shares from a piece that comes before it. (Hendrickson, SIAM J. Comput. 21(1), 1992, has the
conditions in the plane.)
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
import heapq
from itertools import combinations

import numpy as np

from dg_localization.interval.kernels import WORK_OF_A_STEP, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import Pair, Subgraphs
from dg_localization.solver.decompose.joints import Joint, JointKind
from dg_localization.solver.decompose.rigid_components import (
    Points,
    is_rigid,
    rigid_components,
)
from dg_localization.solver.decompose.separators import split_at_separators

REMEMBERED = 32
"""For how many sets of measured pairs the pieces are kept."""


@dataclass(frozen=True)
class Decomposition:
    """Pieces in an order to solve them in, and the joints between them."""

    pieces: tuple[Points, ...]
    joints: tuple[Joint, ...]


def pairs_of(points: Iterable[int]) -> tuple[Pair, ...]:
    """Return all pairs of some points, the smaller point first."""
    return tuple(combinations(sorted(points), 2))


def pieces_of(n_points: int, pairs: IntArray, dimension: int) -> Decomposition:
    """
    Decompose a fleet, or return what was found for the same pairs, shape (m, 2), before.

    A fleet is localized again and again while the same pairs are measured.
    """
    return _remembered(n_points, np.ascontiguousarray(pairs).tobytes(), dimension)


@lru_cache(maxsize=REMEMBERED)
def _remembered(n_points: int, pairs: bytes, dimension: int) -> Decomposition:
    """Decompose a fleet, given its measured pairs one after another."""
    listed = np.frombuffer(pairs, dtype=np.int64).reshape(-1, 2)
    # A kernel is compiled anew for arrays that are read only.
    return decompose(n_points, listed.copy(), dimension)


def decompose(n_points: int, pairs: IntArray, dimension: int) -> Decomposition:
    """Decompose a fleet into rigid pieces and joints."""
    # In one layout: a kernel is compiled for each.
    pairs = np.ascontiguousarray(pairs)
    components = rigid_components(n_points, pairs, dimension)
    graph = Subgraphs(n_points, pairs)
    shared = {pair for pair in _shared_pairs(components, dimension) if pair not in graph}
    builder = _Builder(graph, dimension)
    for component in components:
        builder.add_component(component, shared)
        look_after(WORK_OF_A_STEP)
    builder.join_components(components)
    return builder.ordered()


def _shared_pairs(components: list[Points], dimension: int) -> set[Pair]:
    """Return the pairs of points that lie in two rigid components; in space there are some."""
    if dimension < 3:
        return set()
    seen: set[Pair] = set()
    shared: set[Pair] = set()
    n_components: dict[int, int] = defaultdict(int)
    for component in components:
        for point in component:
            n_components[point] += 1
    for component in components:
        new = set(pairs_of(point for point in component if n_components[point] > 1))
        shared |= seen & new
        seen |= new
    return shared


class _Builder:
    """Collects the parts of all components and the joints between them."""

    def __init__(self, graph: Subgraphs, dimension: int) -> None:
        self._graph = graph
        self._dimension = dimension
        self._parts: list[Points] = []
        self._joints: list[tuple[list[int], Points, JointKind]] = []

    def add_component(self, component: Points, shared: set[Pair]) -> None:
        """Split a rigid component at its separating sets."""
        if len(component) <= self._dimension + 1:
            self._parts.append(component)
            return
        points = np.array(component)
        inside = set(component)
        taken = [(i, j) for i, j in shared if i in inside and j in inside]
        inner = self._graph.pairs_among(points, taken)
        parts, separators = split_at_separators(len(points), inner, self._dimension)
        first = len(self._parts)
        self._parts.extend(tuple(points[part].tolist()) for part in parts)
        for separator, sharing in separators:
            numbers = [first + x for x in sharing]
            face = tuple(sorted(points[separator].tolist()))
            self._joints.append((numbers, face, JointKind.REFLECTION))

    def join_components(self, components: list[Points]) -> None:
        """Add the joints between different rigid components."""
        if self._dimension == 1:
            return
        holders: dict[Points, list[int]] = defaultdict(list)
        parts_of: dict[int, set[int]] = defaultdict(set)
        for x, part in enumerate(self._parts):
            for point in part:
                parts_of[point].add(x)
        of_point: dict[int, list[int]] = defaultdict(list)
        for x, component in enumerate(components):
            for point in component:
                of_point[point].append(x)
        if self._dimension == 2:
            for point, numbers in of_point.items():
                if len(numbers) > 1:
                    holders[(point,)] = numbers
        else:
            self._share_in_space(components, of_point, holders)
        inside = [set(component) for component in components]
        for points, numbers in sorted(holders.items()):
            sharing = set.intersection(*(parts_of[point] for point in points))
            pieces = []
            for number in numbers:
                pieces += [
                    x for x in sorted(sharing) if inside[number].issuperset(self._parts[x])
                ][:1]
            kind = JointKind.HINGE if len(points) == self._dimension - 1 else JointKind.LOOSE
            if len(pieces) > 1:
                self._joints.append((pieces, points, kind))

    def _share_in_space(
        self,
        components: list[Points],
        of_point: dict[int, list[int]],
        holders: dict[Points, list[int]],
    ) -> None:
        """Write which components share two points, and which only one."""
        for point, numbers in of_point.items():
            hinged: dict[int, int] = {}
            for first, second in combinations(numbers, 2):
                common = set(components[first]) & set(components[second])
                if len(common) == 2:
                    line = tuple(sorted(common))
                    if point == line[0]:
                        known = holders[line]
                        known += [x for x in (first, second) if x not in known]
                    root = hinged.get(first, first)
                    old = hinged.get(second, second)
                    for x in numbers:
                        if hinged.get(x, x) == old:
                            hinged[x] = root
            free = sorted({hinged.get(x, x) for x in numbers})
            if len(free) > 1:
                holders[(point,)] = free

    def ordered(self) -> Decomposition:
        """Return the pieces in an order in which each can be solved."""
        order = _Order(self._parts, self._joints, self._graph, self._dimension)
        return order.decomposition()


class _Order:
    """
    Puts parts into an order in which each is rigid once the earlier ones are known.

    Parts that wait for each other, which only happens in space, are merged.
    """

    def __init__(
        self,
        parts: list[Points],
        joints: list[tuple[list[int], Points, JointKind]],
        graph: Subgraphs,
        dimension: int,
    ) -> None:
        self._points: dict[int, Points] = dict(enumerate(parts))
        self._joints = joints
        self._graph = graph
        # The pairs that earlier pieces imply, by their smaller points.
        self._implied: dict[int, list[Pair]] = {}
        self._dimension = dimension
        self._parts_with: dict[int, set[int]] = defaultdict(set)
        for x, part in self._points.items():
            for point in part:
                self._parts_with[point].add(x)
        self._joints_of: dict[int, set[int]] = {x: set() for x in self._points}
        for number, (pieces, _, _) in enumerate(joints):
            for x in pieces:
                self._joints_of[x].add(number)
        self._order: list[int] = []
        self._waiting = set(self._points)
        self._ready: list[tuple[int, int]] = []
        self._queued: set[int] = set()
        for x in self._points:
            self._queue_if_ready(x)
            look_after(WORK_OF_A_STEP)

    def _shared(self, part: int) -> set[Pair]:
        """Return the pairs of a part that nobody measured and a joint shares."""
        faces = (self._joints[number][1] for number in self._joints_of[part])
        return {pair for face in faces for pair in pairs_of(face) if pair not in self._graph}

    def _is_implied(self, pair: Pair) -> bool:
        """Return whether an earlier piece implies a pair."""
        return pair in self._implied.get(pair[0], ())

    def _is_ready(self, part: int) -> bool:
        """Return whether a part is rigid by what is measured and what is implied by now."""
        if all(map(self._is_implied, self._shared(part))):
            return True
        points = np.array(self._points[part])
        inside = set(self._points[part])
        near = (pair for i in inside & self._implied.keys() for pair in self._implied[i])
        implied = [pair for pair in near if pair[1] in inside]
        pairs = self._graph.pairs_among(points, implied)
        return is_rigid(len(points), pairs, self._dimension)

    def _queue_if_ready(self, part: int) -> None:
        """Let a part be taken when its turn comes if it waits for nothing."""
        if part not in self._queued and self._is_ready(part):
            self._queue(part)

    def _queue(self, part: int) -> None:
        """Let a part be taken when its turn comes."""
        self._queued.add(part)
        heapq.heappush(self._ready, (len(self._points[part]), part))

    def _take(self, part: int) -> None:
        """Make a part the next piece, and look who was waiting for it."""
        self._waiting.remove(part)
        shared = self._shared(part)
        new = {pair for pair in shared if not self._is_implied(pair)}
        self._order.append(part)
        # A part that shares no joint with this one may wait for the pair all the same.
        concerned: set[int] = set()
        for pair in new:
            self._implied.setdefault(pair[0], []).append(pair)
            concerned |= self._parts_with[pair[0]] & self._parts_with[pair[1]]
        for x in sorted(concerned & self._waiting):
            self._queue_if_ready(x)

    def _merge(self) -> None:
        """Merge the waiting parts of one joint, or give up waiting where there is none."""
        for pieces, _, _ in self._joints:
            stuck = [x for x in pieces if x in self._waiting]
            if len(stuck) > 1:
                break
        else:
            stuck = [min(self._waiting, key=lambda x: (len(self._points[x]), x))]
        merged, *others = stuck
        self._points[merged] = tuple(sorted({p for x in stuck for p in self._points[x]}))
        for point in self._points[merged]:
            self._parts_with[point].add(merged)
        for x in others:
            self._waiting.remove(x)
            for number in self._joints_of.pop(x):
                pieces = self._joints[number][0]
                pieces[:] = sorted({merged if y == x else y for y in pieces})
                self._joints_of[merged].add(number)
        for number in sorted(self._joints_of[merged]):
            if len(self._joints[number][0]) < 2:
                self._joints_of[merged].remove(number)
        if others:
            self._queue_if_ready(merged)
        else:
            self._queue(merged)

    def decomposition(self) -> Decomposition:
        """Return all pieces and joints, in order."""
        while self._waiting:
            look_after(WORK_OF_A_STEP)
            if self._ready:
                self._take(heapq.heappop(self._ready)[1])
            else:
                self._merge()
        number_of = {part: number for number, part in enumerate(self._order)}
        joints = [
            (tuple(sorted(number_of[x] for x in pieces)), points, kind)
            for pieces, points, kind in self._joints
            if len(pieces) > 1
        ]
        return Decomposition(
            tuple(self._points[x] for x in self._order),
            tuple(Joint(*joint) for joint in sorted(joints, key=lambda joint: joint[:2])),
        )
