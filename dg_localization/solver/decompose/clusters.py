# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Rigid clusters by trilateration, which make large fleets small before their rank is taken.

Points that see each other grow into a cluster by every further point that has q measured
distances to it. That proves rigidity, but does not find all of it; in space the rank finds the
rest, on a graph in which every cluster is replaced by those of its points that others see.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import BoolArray, Graph, graph_of

BASE = 3
"""The points of space that a cluster grows from."""


@kernel
def _grow(
    graph: Graph, i: int, j: int, n_links: IntArray, order: IntArray, inside: BoolArray
) -> int:
    """Write the points of the cluster of a measured pair in the order they join; count them."""
    n_links[:] = 0
    inside[:] = False
    order[0], order[1] = i, j
    size, done = 2, 0
    inside[i] = inside[j] = True
    while done < size:
        point = order[done]
        done += 1
        for x in range(graph.start[point], graph.start[point + 1]):
            other = graph.neighbors[x]
            n_links[other] += 1
            # The third point needs two distances, all others three.
            if not inside[other] and n_links[other] >= min(size, BASE):
                inside[other] = True
                order[size] = other
                size += 1
    return size


@kernel
def clusters_of(n_points: int, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """
    Return clusters that are rigid in space; each pair is in at most one of them.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    offsets, members : ndarray of int
        Cluster k has the points ``members[offsets[k]:offsets[k + 1]]``, the base of its growth
        first. Only clusters of more points than the base are listed.

    """
    graph = graph_of(n_points, pairs)
    n_links = np.empty(n_points, dtype=np.int64)
    order = np.empty(n_points, dtype=np.int64)
    inside = np.empty(n_points, dtype=np.bool_)
    assigned = np.zeros(len(pairs), dtype=np.bool_)
    offsets = np.zeros(len(pairs) + 1, dtype=np.int64)
    # A cluster of k points takes 3 k - 6 pairs that are in no other.
    members = np.empty(2 * len(pairs) + 1, dtype=np.int64)
    count = 0
    for x in range(len(pairs)):
        if assigned[x]:
            continue
        size = _grow(graph, pairs[x, 0], pairs[x, 1], n_links, order, inside)
        if size <= BASE:
            continue
        n_new = 0
        for y in range(len(pairs)):
            if not assigned[y] and inside[pairs[y, 0]] and inside[pairs[y, 1]]:
                n_new += 1
        if n_new < size:
            continue
        for y in range(len(pairs)):
            if inside[pairs[y, 0]] and inside[pairs[y, 1]]:
                assigned[y] = True
        end = offsets[count]
        members[end : end + size] = order[:size]
        count += 1
        offsets[count] = end + size
    return offsets[: count + 1].copy(), members[: offsets[count]].copy()


def without_interiors(n_points: int, pairs: IntArray) -> tuple[list[IntArray], IntArray]:
    """
    Replace every cluster by its base and the points that other pairs end at.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    clusters : list of ndarray of int
        The points of each cluster, its base first.
    pairs : ndarray of int, shape (k, 2)
        Pairs among fewer points, with the same rigidity.

    """
    offsets, members = clusters_of(n_points, pairs)
    clusters = [members[a:b] for a, b in zip(offsets[:-1], offsets[1:], strict=True)]
    outside = np.ones(len(pairs), dtype=np.bool_)
    n_clusters = np.zeros(n_points, dtype=np.int64)
    for cluster in clusters:
        inside = np.zeros(n_points, dtype=np.bool_)
        inside[cluster] = True
        outside &= ~inside[pairs].all(axis=1)
        n_clusters[cluster] += 1
    is_seen = n_clusters > 1
    is_seen[pairs[outside]] = True
    kept = [pairs[outside]]
    for cluster in clusters:
        base = cluster[:BASE]
        others = cluster[BASE:][is_seen[cluster[BASE:]]]
        kept.append(base[[[0, 1], [0, 2], [1, 2]]])
        kept.extend(np.stack([np.full_like(others, b), others], axis=1) for b in base)
    joined = np.concatenate(kept) if clusters else pairs
    return clusters, np.unique(np.sort(joined, axis=1), axis=0)
