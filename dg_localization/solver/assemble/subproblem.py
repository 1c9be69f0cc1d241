# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Parts of a problem: the same constraints among fewer points, within narrower bounds."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import product

import numpy as np

from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.pair_bounds import PairBounds
from dg_localization.solver.problem import Chirality, Problem, SideConstraint

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper bounds of squared distances in m^2."""

Ranges = Mapping[Pair, tuple[float, float]]
"""Lower and upper bounds of the squared distances of some pairs in m^2."""

MOST_DENSE = 200
"""Bounds among more points are those of listed pairs; no n x n array is made of them."""

Constraint = SideConstraint | Chirality


class Orientations:
    """The sides and chiralities of a problem, found by their points."""

    def __init__(self, problem: Problem) -> None:
        self._constraints: list[Constraint] = []
        self._of_point: dict[int, set[int]] = {}
        every: list[Constraint] = [*problem.sides, *problem.chiralities]
        for constraint in every:
            for point in points_of(constraint):
                self._of_point.setdefault(point, set()).add(len(self._constraints))
            self._constraints.append(constraint)

    def among(self, points: Iterable[int]) -> list[Constraint]:
        """Return the constraints all of whose points are among some points, in their order."""
        inside = set(points)
        numbers = {number for point in inside for number in self._of_point.get(point, ())}
        found = [self._constraints[number] for number in sorted(numbers)]
        return [constraint for constraint in found if inside.issuperset(points_of(constraint))]


def points_of(constraint: Constraint) -> Points:
    """Return the points that a constraint names."""
    if isinstance(constraint, Chirality):
        return tuple(constraint.points)
    return (*constraint.face, constraint.first, constraint.second)


def restricted(
    problem: Problem,
    points: Sequence[int],
    bounds: Bounds | Ranges | None,
    constraints: Iterable[Constraint],
) -> Problem | None:
    """Return the problem of some points within bounds; None where these contradict each other."""
    number = {point: x for x, point in enumerate(points)}
    left: Bounds | PairBounds | None
    if isinstance(bounds, Mapping):
        local = {(number[i], number[j]): ends for (i, j), ends in bounds.items()}
        if problem.is_sparse and len(points) > MOST_DENSE:
            left = _narrowed_pairs(problem.pairs.restricted(points), local)
        else:
            left = _narrowed(problem.bounds_among(points), _as_matrices(len(points), local))
    elif bounds is None and problem.is_sparse and len(points) > MOST_DENSE:
        left = problem.pairs.restricted(points)
    else:
        left = _narrowed(problem.bounds_among(points), bounds)
    if left is None:
        return None
    sides, chiralities = [], []
    for constraint in constraints:
        if isinstance(constraint, Chirality):
            named = tuple(number[point] for point in constraint.points)
            chiralities.append(Chirality(named, constraint.sign))
        else:
            face = tuple(number[point] for point in constraint.face)
            apexes = number[constraint.first], number[constraint.second]
            sides.append(SideConstraint(face, *apexes, constraint.side))
    return Problem.unchecked(left, problem.dimension, sides, chiralities)


def _narrowed(bounds: Bounds, others: Bounds | None) -> Bounds | None:
    """Narrow bounds, in place, to what they have in common with others; None where nothing."""
    if others is not None:
        lower, upper = bounds
        np.maximum(lower, others[0], out=lower)
        np.minimum(upper, others[1], out=upper)
        if (lower > upper).any():
            return None
    return bounds


def _as_matrices(n_points: int, ranges: Ranges) -> Bounds | None:
    """Return the bounds of some pairs as matrices, None where there are none."""
    if not ranges:
        return None
    lower, upper = unbounded(n_points)
    for (i, j), (low, high) in ranges.items():
        lower[i, j] = lower[j, i] = low
        upper[i, j] = upper[j, i] = high
    return lower, upper


def _narrowed_pairs(pairs: PairBounds, ranges: Ranges) -> PairBounds | None:
    """Return bounds narrowed to those of some pairs; None where they contradict each other."""
    if not ranges:
        return pairs
    rows, columns = np.array(list(ranges), dtype=np.int64).T
    lower, upper = np.array(list(ranges.values())).T
    narrowed = pairs.narrowed(rows, columns, lower, upper)
    return None if (narrowed.lower > narrowed.upper).any() else narrowed


def restricted_boxes(boxes: Iterable[Bounds], points: Points) -> list[Bounds]:
    """Return the bounds of some points."""
    index = np.ix_(points, points)
    return [(lower[index], upper[index]) for lower, upper in boxes]


def common_parts(boxes: Iterable[Bounds], others: Iterable[Bounds]) -> list[Bounds]:
    """Return what each of some boxes has in common with each of others."""
    common = (
        (np.maximum(lower, low), np.minimum(upper, high))
        for (lower, upper), (low, high) in product(boxes, others)
    )
    return [(lower, upper) for lower, upper in common if (lower <= upper).all()]


def parts_within(bounds: Bounds, within: Sequence[Bounds] | None) -> list[Bounds]:
    """Return what bounds have in common with each of some boxes; all of them without any."""
    return [bounds] if within is None else common_parts([bounds], within)


def as_box(bounds: Bounds) -> FloatArray:
    """Return bounds as a box without gaps."""
    return np.array([*bounds, *np.zeros_like(bounds)])


def unbounded(n_points: int) -> Bounds:
    """Return bounds that say nothing."""
    return np.zeros((n_points, n_points)), np.full((n_points, n_points), np.inf)
