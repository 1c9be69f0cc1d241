# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid components: the maximal sets of points that measured pairs hold rigid, generically."""

from __future__ import annotations

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


def _components_3d(n_points: int, pairs: IntArray) -> list[IntArray]:
    """Return the rigid components in space that hold a measured pair or three implied ones."""
    components = _components_of_implied(implied_pairs(n_points, pairs, 3))
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
    return generic_rank(n_points, pairs, dimension) == most
