# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Separating sets: q points of a rigid component whose removal disconnects it.

What lies on either side of them may be mirrored in the hyperplane that they span, whatever the
measured distances are, and each side is a smaller problem.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np

from dg_localization.interval.kernels import look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import Graph, connected_parts, cut_points, graph_of

MOST_TRIPLES = 100
"""In space, sets of three among more points are looked for at points with three pairs only."""


def _separators(graph: Graph, dimension: int) -> IntArray:
    """Return separating sets of q points: all of them, but for many points in space."""
    n_points = len(graph.start) - 1
    if n_points <= dimension + 1:
        return np.empty((0, dimension), dtype=np.int64)
    if dimension == 3 and n_points > MOST_TRIPLES:
        return _neighborhoods(graph, 3)
    found = []
    removed = np.zeros(n_points, dtype=np.bool_)
    for fixed in combinations(range(n_points), dimension - 1):
        removed[list(fixed)] = True
        cuts = np.flatnonzero(cut_points(graph, removed)).tolist()
        found += [(*fixed, k) for k in cuts if k > max(fixed, default=-1)]
        removed[list(fixed)] = False
        look_after(len(graph.neighbors))
    return np.array(found, dtype=np.int64).reshape(-1, dimension)


def _neighborhoods(graph: Graph, size: int) -> IntArray:
    """Return the sets of neighbors of the points that have so many."""
    sets = {
        tuple(sorted(graph.neighbors[a:b].tolist()))
        for a, b in zip(graph.start[:-1], graph.start[1:], strict=True)
        if b - a == size
    }
    return np.array(sorted(sets), dtype=np.int64).reshape(-1, size)


def split_at_separators(
    n_points: int, pairs: IntArray, dimension: int
) -> tuple[list[IntArray], list[tuple[IntArray, list[int]]]]:
    """Split a rigid component at its separating sets of q points."""
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
