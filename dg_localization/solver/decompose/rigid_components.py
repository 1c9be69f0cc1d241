# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid components: the maximal sets of points that measured pairs hold rigid, generically."""

from __future__ import annotations

from collections import Counter

import numpy as np

from dg_localization.interval.kernels import kernel, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.generic_rank import generic_rank, implied_pairs, rigid_rank
from dg_localization.solver.decompose.graph import BoolArray, connected_parts, graph_of
from dg_localization.solver.decompose.pebble_game import rank_2d, rigid_components_2d

Points = tuple[int, ...]


@kernel
def _next_component(
    implied: BoolArray, covered: BoolArray, i: int, j: int, member: BoolArray
) -> bool:
    """Write the next component that holds an implied pair; False when there is no other one."""
    n_points = len(implied)
    for k in range(n_points):
        if k == i or k == j or not (implied[i, k] and implied[j, k]) or covered[k]:
            continue
        for point in range(n_points):
            member[point] = implied[i, point] and implied[j, point] and implied[k, point]
            covered[point] |= member[point]
        return True
    return False


def _components_of_implied(implied: BoolArray) -> list[IntArray]:
    """
    Return the sets of three and more points in space all of whose distances are implied.

    Three points whose distances are implied lie in one such set, and in no other.
    """
    found: list[IntArray] = []
    known: list[set[int]] = [set() for _ in implied]
    member = np.empty(len(implied), dtype=np.bool_)
    for i, j in np.argwhere(np.triu(implied, 1)).tolist():
        covered = np.zeros(len(implied), dtype=np.bool_)
        for number in known[i] & known[j]:
            covered[found[number]] = True
        look_after(len(implied))
        while _next_component(implied, covered, i, j, member):
            points = np.flatnonzero(member)
            found.append(points)
            for point in points.tolist():
                known[point].add(len(found) - 1)
    return found


def _cluster(neighbors: list[set[int]], i: int, j: int) -> list[int]:
    """Return points that a measured pair in space grows by: each has three distances to others."""
    order, inside, n_links = [i, j], {i, j}, Counter[int]()
    for point in order:
        for other in neighbors[point] - inside:
            n_links[other] += 1
            # The third point needs two distances, all others three.
            if n_links[other] >= min(len(order), 3):
                inside.add(other)
                order.append(other)
    return order


def _without_interiors(n_points: int, pairs: IntArray) -> tuple[list[IntArray], IntArray]:
    """
    Return rigid clusters, and pairs among fewer points that have the same rigidity.

    A cluster is replaced by the three points that it grew from and those that other pairs end at.
    """
    neighbors: list[set[int]] = [set() for _ in range(n_points)]
    for i, j in pairs.tolist():
        neighbors[i].add(j)
        neighbors[j].add(i)
    left = np.ones(len(pairs), dtype=np.bool_)
    clusters, n_clusters = [], np.zeros(n_points, dtype=np.int64)
    for x, (i, j) in enumerate(pairs.tolist()):
        grown = _cluster(neighbors, i, j) if left[x] else []
        look_after(len(grown))
        if len(grown) > 3:
            clusters.append(np.array(grown))
            n_clusters[grown] += 1
            left &= ~np.isin(pairs, grown).all(axis=1)
    is_seen = n_clusters > 1
    is_seen[pairs[left]] = True
    kept = [pairs[left]]
    for cluster in clusters:
        base, others = cluster[:3], cluster[3:][is_seen[cluster[3:]]]
        kept.append(base[[[0, 1], [0, 2], [1, 2]]])
        kept += [np.stack([np.full_like(others, b), others], axis=1) for b in base]
    return clusters, np.unique(np.sort(np.concatenate(kept), axis=1), axis=0)


def _components_3d(n_points: int, pairs: IntArray) -> list[IntArray]:
    """Return the rigid components in space that hold a measured pair or three implied ones."""
    clusters, fewer = _without_interiors(n_points, pairs)
    points, ends = np.unique(fewer, return_inverse=True)
    implied = implied_pairs(len(points), ends.reshape(fewer.shape), 3)
    components = [points[members] for members in _components_of_implied(implied)]
    for x, component in enumerate(components):
        for cluster in clusters:
            # Three common points make a component and a cluster one body.
            if len(np.intersect1d(component, cluster)) >= 3:
                component = np.union1d(component, cluster)
        components[x] = component
    held = np.zeros(len(pairs), dtype=np.bool_)
    for component in components:
        held |= np.isin(pairs, component).all(axis=1)
    return components + list(np.sort(pairs[~held], axis=1))


def rigid_components(n_points: int, pairs: IntArray, dimension: int) -> list[Points]:
    """Return the maximal sets of points that are rigid together at generic coordinates."""
    if dimension == 1:
        part = connected_parts(graph_of(n_points, pairs), np.zeros(n_points, dtype=np.bool_))
        components = [np.flatnonzero(part == k) for k in range(part.max() + 1)]
    else:
        if dimension == 2:
            components = rigid_components_2d(n_points, pairs)
        elif len(pairs):
            components = _components_3d(n_points, pairs)
        else:
            components = []
        alone = np.ones(n_points, dtype=np.bool_)
        alone[pairs] = False
        components.extend(np.flatnonzero(alone)[:, None])
    return sorted(tuple(sorted(component.tolist())) for component in components)


def is_rigid(n_points: int, pairs: IntArray, dimension: int) -> bool:
    """Tell whether pairs hold all points rigid at generic coordinates."""
    if len(pairs) == n_points * (n_points - 1) // 2:
        return True
    most = rigid_rank(n_points, dimension)
    if len(pairs) < most:
        return False
    if dimension == 2:
        return rank_2d(n_points, pairs) == most
    if dimension == 3:
        clusters, pairs = _without_interiors(n_points, pairs)
        points, ends = np.unique(pairs, return_inverse=True)
        if any(len(cluster) == n_points for cluster in clusters):
            return True
        if not clusters and len(points) < n_points:
            return False
        most = rigid_rank(len(points), 3)
        return generic_rank(len(points), ends.reshape(pairs.shape), 3) == most
    return generic_rank(n_points, pairs, dimension) == most
