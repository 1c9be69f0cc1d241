# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Pieces that come apart once what hangs on them is taken off.

A part that two points hold joins what lies on either side of these, and so it hides the sets of
points that separate the rest. Each such set doubles the placements of the piece. Searched as a
whole, all its points are contracted for every one of them; solved in parts, they are combined.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.solver.assemble.budget import CallBudget
from dg_localization.solver.assemble.combinations import Combination, Combinations
from dg_localization.solver.assemble.contraction import (
    MOST_CONTRACTED,
    bounds_within,
    contracted,
    smoothed,
)
from dg_localization.solver.assemble.links import Link, Linker
from dg_localization.solver.assemble.placing import Placer
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.assemble.subproblem import (
    Bounds,
    Orientations,
    parts_within,
    points_of,
    restricted,
)
from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.decomposition import Decomposition, pieces_of
from dg_localization.solver.decompose.joints import JointKind
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.place.placements import MARGIN
from dg_localization.solver.place.sparse_placements import refined
from dg_localization.solver.problem import Problem, Side, SideConstraint

LEAST_PARTED, MOST_PARTED = 9, 60
"""Fewer points are searched as a whole in less time; more are solved in patches."""

MOST_APART = 64
"""So many combinations are told apart, or more where more hypotheses are asked for."""

MOST_TOGETHER = 64_000
"""Combinations times the cube of the points, up to which all parts are contracted together. Of
more combinations, two parts at a time are, each two of their hypotheses once."""

_Part = tuple[Points, Bounds]


def hidden_parts(problem: Problem, stopped: Callable[[], bool]) -> Decomposition | None:
    """Return the parts of a piece, None where it has one part only or the time is over."""
    if not LEAST_PARTED <= problem.n_points <= MOST_PARTED:
        return None
    parts = None
    with until(stopped):
        parts = pieces_of(np.isfinite(problem.upper), problem.dimension)
    if parts is None or len(parts.pieces) == 1:
        return None
    if any(joint.kind is not JointKind.REFLECTION for joint in parts.joints):
        return None
    return parts


class PartsTogether:
    """
    The parts of a piece together.

    Parameters
    ----------
    problem : Problem
        The piece.
    solved : SolvedPieces
        Its parts.
    budget : CallBudget
        What the call may take.
    within : sequence of (lower, upper), optional
        The boxes in m^2 that placements have to lie in; everywhere without any.

    """

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPieces,
        budget: CallBudget,
        within: Sequence[Bounds] | None,
    ) -> None:
        self._problem = problem
        self._parts, self._joints = solved.pieces, solved.joints
        self._budget = budget
        self._within = within
        self._orientations = Orientations(problem)
        self._options = replace(budget.options, tighten_slices=0)
        self._of_two: dict[tuple[int, int, int, int, Side], _Part | None] = {}
        links = Linker(problem, solved, budget, within).links(solved.joints)
        self._combinations = Combinations([len(p.hypotheses) for p in self._parts], links)

    def boxes(self) -> tuple[list[FloatArray], Callable[[int], FloatArray | None]]:
        """
        Return a box for each combination, or one for all where there are too many to list.

        Returns
        -------
        boxes : list of ndarray, shape (4, n, n)
            The boxes in m^2.
        start_of : callable
            Returns a placement in m, (n, q), in or near a box, by its number; None where a part
            has no placement.

        """
        if self._combinations.contradiction is not None:
            return [], lambda _: None
        number = self._combinations.number
        if number > max(MOST_APART, self._budget.options.max_hypotheses):
            every = self._bounds_of_all()
            parts = [] if every is None else parts_within(every, self._within)
            return _as_boxes(parts), lambda _: self._laid(self._combinations[0])
        together = number * self._problem.n_points**3 <= MOST_TOGETHER
        found, left = [], []
        for combination in (self._combinations[x] for x in range(number)):
            bounds = self._bounds(combination, together)
            for part in [] if bounds is None else parts_within(bounds, self._within):
                found.append(part)
                left.append(combination)
        return _as_boxes(found), lambda x: self._laid(left[x])

    def _bounds_of_all(self) -> Bounds | None:
        """Return the bounds of all pairs in any combination; None where none has a placement."""
        chosen = []
        for part, left in zip(self._parts, self._combinations.left, strict=True):
            lower = np.min([part.hypotheses[x].lower for x in left], axis=0)
            upper = np.max([part.hypotheses[x].upper for x in left], axis=0)
            chosen.append((part.points, (lower, upper)))
        narrowed = self._narrowed(self._all_points, chosen, [])
        if narrowed is None:
            return None
        return contracted(narrowed, self._options, self._within, self._budget.is_over)

    def _laid(self, combination: Combination) -> FloatArray | None:
        """Return the placements of parts, laid against each other as a combination says."""
        placed = [
            (part.points, part.hypotheses[x].positions)
            for part, x in zip(self._parts, combination.hypotheses, strict=True)
        ]
        known = [(points, local) for points, local in placed if local is not None]
        if len(known) < len(placed) or self._budget.is_over():
            return None
        problem, bounded = self._problem, self._problem.pairs
        placer = Placer(known, self._joints, combination.reflections(), problem.dimension, 0)
        together = placer.place(0.0)
        return refined(
            together, bounded.pairs, bounded.lower, bounded.upper, MARGIN, self._budget.is_over
        )

    def _bounds(self, combination: Combination, together: bool) -> Bounds | None:
        """Return the bounds of all pairs in a combination; None where it holds no placement."""
        chosen = [self._chosen(x, y) for x, y in enumerate(combination.hypotheses)]
        if together:
            narrowed = self._narrowed(self._all_points, chosen, combination.constraints())
            if narrowed is None:
                return None
            return contracted(narrowed, self._options, self._within, self._budget.is_over)
        for link, side in combination.sides:
            two = self._two(link, combination.hypotheses, side)
            if two is None:
                return None
            chosen.append(two)
        narrowed = self._narrowed(self._all_points, chosen, [])
        return smoothed(narrowed, self._within) if narrowed else None

    def _two(self, link: Link, hypotheses: Sequence[int], side: Side) -> _Part | None:
        """Return the bounds of two parts together; None where they have no placement."""
        x, y = hypotheses[link.first], hypotheses[link.second]
        key = link.first, link.second, x, y, side
        if key not in self._of_two:
            chosen = [self._chosen(link.first, x), self._chosen(link.second, y)]
            decided = link.constraint(x, y, side)
            points = tuple(sorted({*chosen[0][0], *chosen[1][0]}))
            if len(points) > MOST_CONTRACTED:
                points = tuple(sorted(points_of(decided))) if decided else link.joint.points
                chosen = [_among(points, part) for part in chosen]
            narrowed = self._narrowed(points, chosen, [decided] if decided else [])
            bounds = narrowed and contracted(narrowed, self._options, None, self._budget.is_over)
            self._of_two[key] = (points, bounds) if bounds else None
        return self._of_two[key]

    def _chosen(self, part: int, hypothesis: int) -> _Part:
        """Return the points of a part, and their bounds in one of its hypotheses."""
        found = self._parts[part].hypotheses[hypothesis]
        return self._parts[part].points, (found.lower, found.upper)

    @property
    def _all_points(self) -> Points:
        return tuple(range(self._problem.n_points))

    def _narrowed(
        self, points: Points, parts: Sequence[_Part], decided: Sequence[SideConstraint]
    ) -> Problem | None:
        """Return the problem of some points within the bounds of parts."""
        constraints = [*self._orientations.among(points), *decided]
        return restricted(self._problem, points, bounds_within(points, parts), constraints)


def _as_boxes(found: Sequence[Bounds]) -> list[FloatArray]:
    """Return bounds as boxes without gaps."""
    return [np.array([*bounds, *np.zeros_like(bounds)]) for bounds in found]


def _among(points: Points, part: _Part) -> _Part:
    """Return a part with those of its points only that are among some points."""
    members, (lower, upper) = part
    kept = [x for x, point in enumerate(members) if point in points]
    index = np.ix_(kept, kept)
    return tuple(members[x] for x in kept), (lower[index], upper[index])
