# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Parts of a problem: the same constraints among fewer points, within narrower bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.decomposition import Decomposition, pieces_of
from dg_localization.solver.decompose.graph import Pair, Points, connected_parts, graph_of
from dg_localization.solver.pair_bounds import PairBounds
from dg_localization.solver.problem import Chirality, Constraint, Problem, SideConstraint
from dg_localization.solver.result import Joint

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper bounds of squared distances in m^2."""

Ranges = Mapping[Pair, tuple[float, float]]
"""Lower and upper bounds of the squared distances of some pairs in m^2."""

MOST_DENSE = 200
"""Bounds among more points are stored by pair, without an n x n array. Among fewer points, chains
of known distances bound the distances of their ends."""


def restricted(
    problem: Problem,
    points: Sequence[int],
    bounds: Bounds | Ranges | None = None,
    more: Iterable[Constraint] = (),
) -> Problem | None:
    """
    Return the problem of some points within bounds; None if these contradict each other.

    It has the sides and chiralities of the problem among the points, and those in `more`.
    """
    number = {point: x for x, point in enumerate(points)}
    left: Bounds | PairBounds
    if problem.is_sparse and len(points) > MOST_DENSE and not isinstance(bounds, tuple):
        left = problem.pairs.restricted(points)
        if bounds:
            rows, columns = np.array([(number[i], number[j]) for i, j in bounds]).T
            left = left.narrowed(rows, columns, *np.array(list(bounds.values())).T)
        is_empty = (left.lower > left.upper).any()
    else:
        lower, upper = left = problem.bounds_among(points)
        if isinstance(bounds, tuple):
            np.maximum(lower, bounds[0], out=lower)
            np.minimum(upper, bounds[1], out=upper)
        else:
            for (i, j), (low, high) in (bounds or {}).items():
                x, y = number[i], number[j]
                lower[x, y] = lower[y, x] = max(lower[x, y], low)
                upper[x, y] = upper[y, x] = min(upper[x, y], high)
        is_empty = (lower > upper).any()
    if is_empty:
        return None
    sides, chiralities = [], []
    for constraint in (*problem.constraints_among(points), *more):
        if isinstance(constraint, Chirality):
            named = tuple(number[point] for point in constraint.points)
            chiralities.append(Chirality(named, constraint.sign))
        else:
            face = tuple(number[point] for point in constraint.face)
            apexes = number[constraint.first], number[constraint.second]
            sides.append(SideConstraint(face, *apexes, constraint.side))
    return Problem.unchecked(left, problem.dimension, sides, chiralities)


def restricted_boxes(boxes: Sequence[Bounds] | None, points: Points) -> list[Bounds] | None:
    """Return the bounds of some points in each box; None without boxes."""
    if boxes is None:
        return None
    index = np.ix_(points, points)
    return [(lower[index], upper[index]) for lower, upper in boxes]


def parts_within(bounds: Iterable[Bounds], within: Sequence[Bounds] | None) -> list[Bounds]:
    """Return the nonempty intersections of bounds with boxes; the bounds if there are no boxes."""
    if within is None:
        return list(bounds)
    common = (
        (np.maximum(lower, low), np.minimum(upper, high))
        for (lower, upper), (low, high) in product(bounds, within)
    )
    return [(lower, upper) for lower, upper in common if (lower <= upper).all()]


def bounds_within(points: Points, parts: Iterable[tuple[Points, Bounds]]) -> Bounds:
    """Return the bounds of the distances of some points from the bounds of parts of them."""
    lower = np.zeros((len(points), len(points)))
    upper = np.full_like(lower, np.inf)
    for members, (low, high) in parts:
        place = np.searchsorted(points, members)
        index = place[:, None], place
        lower[index] = np.maximum(lower[index], low)
        upper[index] = np.minimum(upper[index], high)
    np.fill_diagonal(upper, 0.0)
    return lower, upper


def as_box(bounds: Bounds) -> FloatArray:
    """Return bounds as a box without gaps."""
    return np.array([*bounds, *np.zeros_like(bounds)])


def _first_of(known: PairBounds) -> IntArray | None:
    """Return the first point at the place of each point; None if all places may differ."""
    zero = np.ascontiguousarray(known.pairs[known.upper == 0.0])
    if not len(zero):
        return None
    removed = np.zeros(known.n_points, dtype=np.bool_)
    part = connected_parts(graph_of(known.n_points, zero), removed)
    _, first = np.unique(part, return_index=True)
    return np.asarray(first[part])


def with_shared_bounds(problem: Problem) -> Problem | None:
    """Return a problem in which points at one place share bounds; None if bounds contradict."""
    known = problem.pairs
    first = _first_of(known)
    if first is None:
        return problem
    members = [np.flatnonzero(first == point).tolist() for point in range(known.n_points)]
    every: dict[Pair, tuple[float, float]] = {}
    for (i, j), low, high in zip(
        first[known.pairs].tolist(), known.lower, known.upper, strict=True
    ):
        if i == j and low > 0.0:
            return None
        for x, y in product(members[i], members[j]):
            if x != y:
                pair = min(x, y), max(x, y)
                least, most = every.get(pair, (0.0, np.inf))
                every[pair] = max(least, low), min(most, high)
    return restricted(problem, range(problem.n_points), every)


def pieces_of_problem(problem: Problem) -> Decomposition:
    """Return the pieces and joints of a problem; points at one place belong to the same pieces."""
    known = problem.pairs
    first = _first_of(known)
    if first is None:
        return pieces_of(known.n_points, known.measured, problem.dimension)
    places, number = np.unique(first, return_inverse=True)
    ends = np.sort(number[known.measured], axis=1)
    pairs = np.unique(ends[ends[:, 0] < ends[:, 1]], axis=0)
    found = pieces_of(len(places), pairs, problem.dimension)
    parts = [tuple(np.flatnonzero(np.isin(number, piece)).tolist()) for piece in found.pieces]
    joints = [
        Joint(joint.pieces, tuple(places[list(joint.points)].tolist()), joint.kind)
        for joint in found.joints
    ]
    return Decomposition(tuple(parts), tuple(joints))


MOST_NUMBERS = 10**6
"""Most entries of an array that grows with a power of the number of points: more take too much
memory or time."""

MOST_CONTRACTED = 40
"""Most points that are contracted together."""

MOST_TOGETHER = 60
"""Most points of a piece that is contracted as a whole, which bounds far pairs much better. It
takes seconds for more points."""

MOST_WORK_TOGETHER = 100_000
"""Greatest product of choices and cubed points for which all points are contracted for each choice
or the box of each choice is split once: halves of larger boxes are little narrower."""

MOST_WORK = 900_000
"""Greatest product of choices and cubed points for which each choice is contracted as a whole, or
examined to count it. If there are more, time suffices for few choices, and chains bound the others
better."""
