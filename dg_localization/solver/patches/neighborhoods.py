# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Choice of patches: small rigid neighborhoods that cover every measured pair.

Everything here works on the graph of known pairs only. It affects the work and the width of the
answer but not its soundness: any set of points may be solved as a problem of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np

from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.decompose.rigid_components import rigid_components

PATCH_POINTS = 8
"""Most points of a patch: larger ones took longer and gave bounds as wide."""

SEAM_POINTS = 12
"""Most shared points of a patch that joins bodies of patches."""

SEAM_HOPS = 3
"""Greatest number of known pairs between two points of a body that are joined across a seam."""

MOST_FILLED = 20
FILLED_AT_ONCE = 4
"""Most points of a patch in a body, and how many are added to it at a time."""


class Neighborhoods:
    """Finds neighborhoods in a graph of known pairs."""

    def __init__(self, n_points: int, pairs: Iterable[Pair], dimension: int) -> None:
        self._dimension = dimension
        self.neighbors: list[set[int]] = [set() for _ in range(n_points)]
        for i, j in pairs:
            self.neighbors[i].add(j)
            self.neighbors[j].add(i)

    def grown(self, seed: Iterable[int], most: int) -> set[int]:
        """Return a set grown to at most `most` points, those with most known pairs to it first."""
        inside = set(seed)
        n_points = len(self.neighbors)
        # The rank of a point is its links to the set, minus a tie-breaker below one link. Ties put
        # points with few neighbors first, since they are hard to hold later.
        link = n_points**2
        ranks: dict[int, int] = {}

        def count_links(point: int) -> None:
            for other in self.neighbors[point] - inside:
                if other not in ranks:
                    ranks[other] = -len(self.neighbors[other]) * n_points - other
                ranks[other] += link

        for point in inside:
            count_links(point)
        while len(inside) < most and ranks:
            best = max(ranks, key=ranks.__getitem__)
            # The tie-breaker is less than one link.
            if ranks.pop(best) <= (self._dimension - 1) * link:
                break
            inside.add(best)
            count_links(best)
        return inside

    def rigid_part(self, points: Collection[int], wanted: Collection[int]) -> Points:
        """Return the largest rigid part of points that holds the wanted ones, or nothing."""
        ordered = sorted(points)
        local = {point: x for x, point in enumerate(ordered)}
        inner = [(local[i], local[j]) for i, j in self.pairs_among(ordered)]
        pairs = np.array(inner, dtype=np.int64).reshape(-1, 2)
        parts = rigid_components(len(ordered), pairs, self._dimension)
        needed = {local[point] for point in wanted}
        held = [part for part in parts if needed.issubset(part)]
        return tuple(ordered[x] for x in max(held, key=len, default=()))

    def within_hops(self, start: int, body: set[int], most: int) -> set[int]:
        """Return the points of a body within `most` known pairs of a start."""
        seen = front = {start}
        for _ in range(most):
            front = set().union(*(self.neighbors[point] for point in front)) & body - seen
            seen = seen | front
        return seen

    def paths(self, start: int, ends: Collection[int], body: set[int]) -> set[int]:
        """Return the points on a shortest path of known pairs in a body to each of some ends."""
        before = {start: start}
        front = [start]
        left = set(ends) - {start}
        while front and left:
            reached = []
            for point in front:
                for other in self.neighbors[point]:
                    if other in body and other not in before:
                        before[other] = point
                        reached.append(other)
                        left.discard(other)
            front = reached
        on_paths = set()
        for end in ends:
            point = end if end in before else start
            while point != start:
                on_paths.add(point)
                point = before[point]
        return on_paths

    def pairs_among(self, points: Sequence[int]) -> list[Pair]:
        """Return the known pairs among some points."""
        inside = set(points)
        return [(i, j) for i in points for j in self.neighbors[i] & inside if i < j]


def covering_patches(
    graph: Neighborhoods,
    pairs: Sequence[Pair],
    seeds: Sequence[Points],
    most: int,
    stopped: Callable[[], bool],
) -> list[Points]:
    """Return patches that cover every known pair, or those found before the time is over."""
    patches: list[Points] = []
    covered: set[Pair] = set()
    for wanted in dict.fromkeys((*seeds, *pairs)):
        is_seed = len(wanted) > 2
        if wanted in covered or (is_seed and any({*wanted} <= {*patch} for patch in patches)):
            continue
        if stopped():
            break
        patch = graph.rigid_part(graph.grown(wanted, most), wanted)
        if patch:
            patches.append(patch)
            covered.update(graph.pairs_among(patch))
    return patches


def seam_patches(
    known: Neighborhoods,
    bodies: Sequence[set[int]],
    dimension: int,
    stopped: Callable[[], bool],
) -> list[Points]:
    """
    Return patches across the seams between bodies, or those found before the time is over.

    Points in several bodies hold the bodies together. With all distances within each body known,
    they form a small problem of the same kind. If some of these distances are not known yet,
    patches within the bodies come first to find them.
    """
    n_bodies = Counter(point for body in bodies for point in body)
    shared = {point for point, n in n_bodies.items() if n > 1}
    pairs: dict[Pair, None] = {}
    for body in bodies:
        for point in sorted(body & shared):
            if stopped():
                return []
            near = known.within_hops(point, body, SEAM_HOPS) & shared
            pairs.update(dict.fromkeys((point, other) for other in near if other > point))
    graph = Neighborhoods(len(known.neighbors), pairs, dimension)
    found = []
    for patch in covering_patches(graph, list(pairs), (), SEAM_POINTS, stopped):
        if stopped():
            break
        if len(patch) > dimension and not any(body.issuperset(patch) for body in bodies):
            found += _braced(known, patch, bodies)
    return found


def _braced(known: Neighborhoods, patch: Points, bodies: Sequence[set[int]]) -> list[Points]:
    """Return a patch if its distances in bodies are known, else patches in bodies to find them."""
    braces = []
    for body in bodies:
        inside = tuple(sorted(body & set(patch)))
        if len(known.pairs_among(inside)) < len(inside) * (len(inside) - 1) // 2:
            brace = _filled(known, inside, body)
            if not brace:
                return []
            braces.append(brace)
    return braces or [patch]


def _filled(known: Neighborhoods, wanted: Points, body: set[int]) -> Points:
    """Return a rigid part of a body that holds the wanted points, or nothing if too large."""
    points = set(wanted)
    for point in wanted:
        points |= known.paths(point, wanted, body)
    for most in range(len(points), MOST_FILLED + 1, FILLED_AT_ONCE):
        rigid = known.rigid_part(known.grown(points, most), wanted)
        if rigid:
            return rigid
    return ()
