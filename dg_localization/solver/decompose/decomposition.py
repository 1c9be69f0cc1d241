# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Decomposition of a fleet into rigid pieces and the joints between them.

The rigid components of the graph of measured pairs are split at their separating sets: q points
whose removal disconnects a component. The parts on either side may be mirrored in the hyperplane
of these points, and each part is a smaller problem. A piece that is not rigid by the measurements
among its own points takes the distances of shared points from an earlier piece. (Hendrickson,
SIAM J. Comput. 21(1), 1992, has the conditions in the plane.)
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, combinations

import numpy as np

from dg_localization.interval.kernels import WORK_OF_A_STEP, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import (
    Graph,
    Pair,
    Points,
    connected_parts,
    cut_points,
    graph_of,
    pairs_of,
    restricted_pairs,
)
from dg_localization.solver.decompose.rigid_components import is_rigid, rigid_components
from dg_localization.solver.result import Joint, JointKind

REMEMBERED = 32
"""Number of sets of measured pairs whose pieces are cached."""

MOST_TRIPLES = 100
"""In space, with more points, separating sets are sought at points with three pairs only."""


@dataclass(frozen=True)
class Decomposition:
    """Pieces in the order of their solution, and the joints between them."""

    pieces: tuple[Points, ...]
    joints: tuple[Joint, ...]


def pieces_of(n_points: int, pairs: IntArray, dimension: int) -> Decomposition:
    """Decompose a fleet with measured pairs, shape (m, 2); results are cached."""
    return _remembered(n_points, np.ascontiguousarray(pairs).tobytes(), dimension)


@lru_cache(maxsize=REMEMBERED)
def _remembered(n_points: int, listed: bytes, dimension: int) -> Decomposition:
    """Decompose a fleet into rigid pieces and joints, given the bytes of its pairs."""
    # A kernel is compiled anew for read-only arrays.
    pairs = np.frombuffer(listed, dtype=np.int64).reshape(-1, 2).copy()
    measured = {(i, j) for i, j in pairs.tolist()}
    components = rigid_components(n_points, pairs, dimension)
    implied = _shared_pairs(components) - measured if dimension == 3 else set()
    known = np.concatenate([pairs, _as_array(implied)])
    parts: list[Points] = []
    joints: list[_Joint] = []
    first_part = []
    for component in components:
        first_part.append(len(parts))
        if len(component) <= dimension + 1:
            parts.append(component)
            continue
        points = np.array(component)
        inner = restricted_pairs(n_points, known, points)
        split, separators = _split(len(points), inner, dimension)
        for separator, sharing in separators:
            face = tuple(sorted(points[separator].tolist()))
            numbers = {len(parts) + x for x in sharing}
            joints.append(_Joint(numbers, face, JointKind.REFLECTION))
        parts += [tuple(points[part].tolist()) for part in split]
        look_after(WORK_OF_A_STEP)
    ranges = zip(first_part, [*first_part[1:], len(parts)], strict=True)
    joints += _joints_of_components(components, [parts[a:b] for a, b in ranges], dimension)
    return _ordered(parts, joints, (n_points, pairs, measured), dimension)


@dataclass
class _Joint:
    """A joint between parts, given by number."""

    parts: set[int]
    points: Points
    kind: JointKind


def _as_array(pairs: Iterable[Pair]) -> IntArray:
    """Return pairs as an array, shape (m, 2)."""
    return np.array(list(pairs), dtype=np.int64).reshape(-1, 2)


def _shared_pairs(components: list[Points]) -> set[Pair]:
    """Return the pairs of points that lie in two rigid components."""
    n_components = Counter(chain.from_iterable(components))
    shared = ([point for point in c if n_components[point] > 1] for c in components)
    n_shared = Counter(pair for points in shared for pair in pairs_of(points))
    return {pair for pair, n in n_shared.items() if n > 1}


def _joints_of_components(
    components: list[Points], parts: list[list[Points]], dimension: int
) -> Iterator[_Joint]:
    """Yield the joints between rigid components: points and, in space, lines."""
    if dimension == 1:
        return
    of_point: dict[int, list[int]] = defaultdict(list)
    for x, component in enumerate(components):
        for point in component:
            of_point[point].append(x)
    holders: dict[Points, set[int]] = {}
    for point, numbers in sorted(of_point.items()):
        # Components that share a line have a hinge there, and need no joint at its points.
        group = {x: x for x in numbers}
        for first, second in combinations(numbers if dimension == 3 else (), 2):
            line = tuple(sorted({*components[first]} & {*components[second]}))
            if len(line) == 2:
                holders.setdefault(line, set()).update((first, second))
                old, new = group[second], group[first]
                group = {x: new if root == old else root for x, root in group.items()}
        if len(roots := {*group.values()}) > 1:
            holders[(point,)] = roots
    offsets = np.cumsum([0, *map(len, parts)]).tolist()
    for points, among in sorted(holders.items()):
        # The first part of each component that has all the points.
        sharing = {
            next((offsets[c] + x for x, p in enumerate(parts[c]) if {*points} <= {*p}), -1)
            for c in among
        } - {-1}
        kind = JointKind.HINGE if len(points) == dimension - 1 else JointKind.LOOSE
        if len(sharing) > 1:
            yield _Joint(sharing, points, kind)


def _ordered(
    parts: list[Points],
    joints: list[_Joint],
    graph: tuple[int, IntArray, set[Pair]],
    dimension: int,
) -> Decomposition:
    """
    Return parts in an order in which each is rigid when the earlier ones are known.

    Parts that depend on each other, which only happens in space, are merged.
    """
    n_points, pairs, measured = graph
    known: set[Pair] = set()
    order: list[int] = []
    waiting = sorted(range(len(parts)), key=lambda x: (len(parts[x]), x))

    def shared(part: int) -> set[Pair]:
        faces = (joint.points for joint in joints_of[part])
        return {pair for face in faces for pair in pairs_of(face)} - measured

    def is_ready(part: int) -> bool:
        points = np.array(parts[part])
        implied = _as_array(pair for pair in pairs_of(parts[part]) if pair in known)
        inner = restricted_pairs(n_points, np.concatenate([pairs, implied]), points)
        return is_rigid(len(points), inner, dimension)

    while waiting:
        joints_of: dict[int, list[_Joint]] = defaultdict(list)
        for joint in joints:
            for x in joint.parts:
                joints_of[x].append(joint)
        left = []
        for part in waiting:
            look_after(WORK_OF_A_STEP)
            if (new := shared(part)) <= known or is_ready(part):
                order.append(part)
                known |= new
            else:
                left.append(part)
        if len(left) == len(waiting):
            stuck = next((s for j in joints if len(s := j.parts & {*left}) > 1), {left[0]})
            merged = min(stuck)
            parts[merged] = tuple(sorted({p for x in stuck for p in parts[x]}))
            for joint in joints:
                if joint.parts & stuck:
                    joint.parts = joint.parts - stuck | {merged}
            joints = [joint for joint in joints if len(joint.parts) > 1]
            left = [x for x in left if x not in stuck or x == merged]
            if len(stuck) == 1:
                # No other part will make it rigid.
                order.append(merged)
                known |= shared(merged)
                left.remove(merged)
        waiting = left
    number_of = {part: number for number, part in enumerate(order)}
    found = [Joint(tuple(sorted(number_of[x] for x in j.parts)), j.points, j.kind) for j in joints]
    found.sort(key=lambda joint: (joint.pieces, joint.points))
    return Decomposition(tuple(parts[x] for x in order), tuple(found))


def _separators(graph: Graph, dimension: int) -> IntArray:
    """Return separating sets of q points; not always all of them for many points in space."""
    n_points = len(graph.start) - 1
    if dimension == 3 and n_points > MOST_TRIPLES:
        ends = zip(graph.start[:-1], graph.start[1:], strict=True)
        sets = {tuple(graph.neighbors[a:b].tolist()) for a, b in ends if b - a == 3}
        return np.array(sorted(sets), dtype=np.int64).reshape(-1, 3)
    found = []
    removed = np.zeros(n_points, dtype=np.bool_)
    for fixed in combinations(range(n_points), dimension - 1):
        removed[list(fixed)] = True
        cuts = cut_points(graph, removed).nonzero()[0].tolist()
        found += [(*fixed, k) for k in cuts if k > max(fixed, default=-1)]
        removed[list(fixed)] = False
        look_after(len(graph.neighbors))
    return np.array(found, dtype=np.int64).reshape(-1, dimension)


def _split(
    n_points: int, pairs: IntArray, dimension: int
) -> tuple[list[IntArray], list[tuple[IntArray, list[int]]]]:
    """Return the parts of a rigid component, and its separating sets with the parts at each."""
    graph = graph_of(n_points, pairs)
    parts = [np.ones(n_points, dtype=np.bool_)]
    parts_of = [{0} for _ in range(n_points)]
    used: list[IntArray] = []
    for separator in _separators(graph, dimension):
        look_after(2 * len(graph.neighbors))
        removed = np.zeros(n_points, dtype=np.bool_)
        removed[separator] = True
        side = connected_parts(graph, removed)
        holders = set.intersection(*(parts_of[point] for point in separator))
        if len(holders) != 1:
            continue
        (holder,) = holders
        whole = parts[holder]
        sides = np.unique(side[whole & ~removed])
        if len(sides) < 2:
            continue
        used.append(separator)
        for number in sides:
            part = (whole & (side == number)) | removed
            if number == sides[0]:
                for point in np.flatnonzero(whole & ~part):
                    parts_of[point].remove(holder)
                parts[holder] = part
                continue
            for point in np.flatnonzero(part):
                parts_of[point].add(len(parts))
            parts.append(part)
    sharing = [sorted(set.intersection(*(parts_of[point] for point in s))) for s in used]
    return [np.flatnonzero(part) for part in parts], list(zip(used, sharing, strict=True))
