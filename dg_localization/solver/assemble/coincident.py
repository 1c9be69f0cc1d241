# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Points at one place: a pair whose squared distance is zero takes away q degrees of freedom.

Whatever is known of one of them is known of all, and for the graph they are one point.
"""

from __future__ import annotations

import numpy as np

from dg_localization.solver.assemble.subproblem import restricted
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.decomposition import Decomposition, pieces_of
from dg_localization.solver.decompose.graph import connected_parts, graph_of
from dg_localization.solver.pair_bounds import PairBounds
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Joint


def _first_of(known: PairBounds) -> IntArray | None:
    """Return the first point at the place of each point; None where all places differ."""
    zero = np.ascontiguousarray(known.pairs[known.upper == 0.0])
    if not len(zero):
        return None
    removed = np.zeros(known.n_points, dtype=np.bool_)
    part = connected_parts(graph_of(known.n_points, zero), removed)
    _, first = np.unique(part, return_index=True)
    return np.asarray(first[part])


def with_shared_bounds(problem: Problem) -> Problem | None:
    """Return a problem in which points at one place share their bounds; None where it has none."""
    known = problem.pairs
    first = _first_of(known)
    if first is None:
        return problem
    i, j = first[known.pairs].T
    if (known.lower[i == j] > 0.0).any():
        return None
    members = [np.flatnonzero(first == point) for point in range(known.n_points)]
    bounds: dict[tuple[int, int], tuple[float, float]] = {}
    for a, b, low, high in zip(i.tolist(), j.tolist(), known.lower, known.upper, strict=True):
        least, most = bounds.get((min(a, b), max(a, b)), (0.0, np.inf))
        bounds[min(a, b), max(a, b)] = max(least, low), min(most, high)
    every = {
        (min(x, y), max(x, y)): ends
        for (a, b), ends in bounds.items()
        for x in members[a].tolist()
        for y in members[b].tolist()
        if x != y
    }
    points = range(problem.n_points)
    return restricted(problem, points, every, [*problem.sides, *problem.chiralities])


def pieces_of_problem(problem: Problem) -> Decomposition:
    """Return the pieces and joints of a problem; points at one place belong to the same pieces."""
    known = problem.pairs
    first = _first_of(known)
    if first is None:
        return pieces_of(known.n_points, known.measured, problem.dimension)
    places, number = np.unique(first, return_inverse=True)
    ends = np.sort(number[known.measured], axis=1)
    pairs = np.unique(ends[ends[:, 0] < ends[:, 1]], axis=0)
    found = pieces_of(len(places), np.ascontiguousarray(pairs), problem.dimension)
    parts = []
    for piece in found.pieces:
        parts.append(tuple(np.flatnonzero(np.isin(number, piece)).tolist()))
    joints = [
        Joint(joint.pieces, tuple(places[list(joint.points)].tolist()), joint.kind)
        for joint in found.joints
    ]
    return Decomposition(tuple(parts), tuple(joints))
