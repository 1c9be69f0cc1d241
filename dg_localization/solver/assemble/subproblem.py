# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Parts of a problem: the same constraints among fewer points, within narrower bounds."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.problem import Chirality, Problem, SideConstraint

Bounds = tuple[FloatArray, FloatArray]
"""Lower and upper bounds of squared distances in m^2."""

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
    bounds: Bounds | None,
    constraints: Iterable[Constraint],
) -> Problem | None:
    """
    Return the problem of some of the points.

    Parameters
    ----------
    problem : Problem
        The problem.
    points : sequence of int
        The points, ascending.
    bounds : tuple of ndarray, shape (k, k), or None
        Lower and upper bounds of their squared distances in m^2, besides those of the problem.
    constraints : iterable of SideConstraint or Chirality
        Constraints among the points, by their numbers in `problem`.

    Returns
    -------
    Problem or None
        The points in the order given; None where the bounds contradict each other.

    """
    index = np.array(points)
    lower = problem.lower[index[:, None], index]
    upper = problem.upper[index[:, None], index]
    if bounds is not None:
        np.maximum(lower, bounds[0], out=lower)
        np.minimum(upper, bounds[1], out=upper)
        if (lower > upper).any():
            return None
    number = {point: x for x, point in enumerate(points)}
    sides, chiralities = [], []
    for constraint in constraints:
        if isinstance(constraint, Chirality):
            named = tuple(number[point] for point in constraint.points)
            chiralities.append(Chirality(named, constraint.sign))
        else:
            face = tuple(number[point] for point in constraint.face)
            apexes = number[constraint.first], number[constraint.second]
            sides.append(SideConstraint(face, *apexes, constraint.side))
    return Problem.unchecked(lower, upper, problem.dimension, sides, chiralities)


def unbounded(n_points: int) -> Bounds:
    """Return bounds that say nothing."""
    return np.zeros((n_points, n_points)), np.full((n_points, n_points), np.inf)
