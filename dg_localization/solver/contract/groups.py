# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Groups of connected points with their measured pairs, for the kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray


class Groups(NamedTuple):
    """
    The points that chains of measured pairs connect, group by group, for the kernels.

    Group g has the points ``members[offsets[g]:offsets[g + 1]]`` and the measured pairs
    ``edges[edge_offsets[g]:edge_offsets[g + 1]]``, which count within its members.
    """

    offsets: IntArray
    members: IntArray
    edge_offsets: IntArray
    edges: IntArray
    errors: FloatArray  # width of each measured interval in m^2


@kernel
def groups_of(lower: FloatArray, upper: FloatArray) -> Groups:
    """Return the points of a problem in groups that chains of measured pairs connect."""
    n_points = len(upper)
    group_of = np.full(n_points, -1)
    queue = np.empty(n_points, dtype=np.int64)
    members = np.empty(n_points, dtype=np.int64)
    offsets = np.zeros(n_points + 1, dtype=np.int64)
    edge_offsets = np.zeros(n_points + 1, dtype=np.int64)
    edges = np.empty((n_points * n_points, 2), dtype=np.int64)
    errors = np.empty(n_points * n_points)
    n_groups = n_members = n_edges = 0
    for seed in range(n_points):
        if group_of[seed] >= 0:
            continue
        group_of[seed] = n_groups
        queue[0] = seed
        head, tail = 0, 1
        while head < tail:
            point = queue[head]
            head += 1
            for other in range(n_points):
                if group_of[other] < 0 and upper[point, other] < np.inf:
                    group_of[other] = n_groups
                    queue[tail] = other
                    tail += 1
        first = n_members
        for point in range(n_points):
            if group_of[point] == n_groups:
                members[n_members] = point
                n_members += 1
        for x in range(first, n_members):
            for y in range(x + 1, n_members):
                i, j = members[x], members[y]
                if upper[i, j] < np.inf:
                    edges[n_edges, 0], edges[n_edges, 1] = x - first, y - first
                    errors[n_edges] = upper[i, j] - lower[i, j]
                    n_edges += 1
        n_groups += 1
        offsets[n_groups] = n_members
        edge_offsets[n_groups] = n_edges
    return Groups(
        offsets[: n_groups + 1].copy(),
        members,
        edge_offsets[: n_groups + 1].copy(),
        edges[:n_edges].copy(),
        errors[:n_edges].copy(),
    )


def with_measured_pair(groups: Groups, pair: tuple[int, int]) -> Groups:
    """Return groups in which one more pair counts as measured, unless no chain connects it."""
    positions = [int(np.flatnonzero(groups.members == point)[0]) for point in pair]
    group = int(np.searchsorted(groups.offsets, positions[0], side='right')) - 1
    local = [position - int(groups.offsets[group]) for position in positions]
    end = int(groups.edge_offsets[group + 1])
    known = groups.edges[groups.edge_offsets[group] : end]
    is_apart = not groups.offsets[group] <= positions[1] < groups.offsets[group + 1]
    if is_apart or (known == local).all(axis=1).any():
        return groups
    return groups._replace(
        edge_offsets=groups.edge_offsets + (np.arange(len(groups.offsets)) > group),
        edges=np.insert(groups.edges, end, local, axis=0),
        errors=np.insert(groups.errors, end, 0.0),
    )
