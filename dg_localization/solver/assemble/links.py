# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What the hypotheses of joined pieces allow each other.

A joint of several pieces links each of them to the first. Two hypotheses go together when they
agree on the distances of the shared points; where both lie on one side of the face for certain,
they make two placements, with their apexes on the same side and on opposite sides of it. Sides,
chiralities and least distances between the two may rule out either.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dg_localization.solver.assemble.budget import CallBudget
from dg_localization.solver.assemble.contraction import MOST_CONTRACTED, bounds_within, contracted
from dg_localization.solver.assemble.faces import apex_of
from dg_localization.solver.assemble.solved_pieces import SolvedPiece, SolvedPieces
from dg_localization.solver.assemble.subproblem import (
    Bounds,
    Constraint,
    Orientations,
    points_of,
    restricted,
    restricted_boxes,
)
from dg_localization.solver.decompose.decomposition import pairs_of
from dg_localization.solver.decompose.graph import BoolArray
from dg_localization.solver.decompose.joints import Joint, JointKind
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.problem import Chirality, Problem, Side, SideConstraint

MOST_PAIRS = 4096
"""Pieces with more pairs of hypotheses than this are not compared: all of them go together."""

FREE = (Side.FREE,)
EITHER = (Side.SAME, Side.OPPOSITE)


@dataclass
class Link:
    """
    Two joined pieces.

    Attributes
    ----------
    first, second : int
        The pieces.
    joint : Joint
        What they share.
    apexes : dict
        For each piece and hypothesis, the apex with respect to the face, or None.
    allowed : dict
        For each pair of hypotheses that go together, the sides their apexes may lie on.

    """

    first: int
    second: int
    joint: Joint
    apexes: dict[tuple[int, int], int | None] = field(default_factory=dict)
    allowed: dict[tuple[int, int], tuple[Side, ...]] = field(default_factory=dict)

    def constraint(self, x: int, y: int, side: Side) -> SideConstraint | None:
        """Return what it means for two hypotheses that their apexes lie on these sides."""
        first, second = self.apexes.get((self.first, x)), self.apexes.get((self.second, y))
        if side is Side.FREE or first is None or second is None:
            return None
        return SideConstraint(self.joint.points, first, second, side)


class Linker:
    """Finds out what the hypotheses of joined pieces allow each other."""

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPieces,
        budget: CallBudget,
        within: Sequence[Bounds] | None,
    ) -> None:
        self._problem = problem
        self._q = problem.dimension
        self._within = within
        self._pieces = solved.pieces
        self._budget = budget
        self._orientations = Orientations(problem)

    def links(self, joints: Sequence[Joint]) -> list[Link]:
        """Return the links of all joints."""
        found = (
            self._link(joint, joint.pieces[0], second)
            for joint in joints
            for second in joint.pieces[1:]
            # What is not linked goes together.
            if not self._budget.is_overdue()
        )
        return [link for link in found if link is not None]

    def _link(self, joint: Joint, first: int, second: int) -> Link | None:
        """Return what two pieces allow each other; None where that is everything."""
        pieces = self._pieces[first], self._pieces[second]
        between = self._between(*pieces)
        together = _agreeing(pieces, joint.points)
        if together.size > MOST_PAIRS or (between is None and len(joint.points) == 1 < self._q):
            return None
        link = Link(first, second, joint)
        sides: tuple[Side, ...] = FREE
        if joint.kind is JointKind.REFLECTION:
            sides = EITHER
            for number, piece in zip((first, second), pieces, strict=True):
                link.apexes |= self._apexes(number, piece, joint.points)
        for x, y in np.argwhere(together).tolist():
            certain = link.apexes.get((first, x)), link.apexes.get((second, y))
            allowed: tuple[Side, ...] = FREE if None in certain else sides
            if between is not None:
                allowed = tuple(s for s in allowed if self._may_be(link, (x, y), s, between))
            if allowed:
                link.allowed[x, y] = allowed
        return link

    def _apexes(
        self, number: int, piece: SolvedPiece, face: Points
    ) -> dict[tuple[int, int], int | None]:
        """Return the apexes of the hypotheses of a piece; without time a side is open."""
        apexes: dict[tuple[int, int], int | None] = {}
        for x, hypothesis in enumerate(piece.hypotheses):
            if self._budget.is_over():
                break
            # A placement is sought once for all: most points are near the face in each of them.
            apexes[number, x] = apex_of(piece.points, hypothesis, face, piece.hypotheses[0])
        return apexes

    def _between(self, first: SolvedPiece, second: SolvedPiece) -> list[Constraint] | None:
        """Return the constraints among two pieces; None where nothing is known across them."""
        points = tuple(sorted({*first.points, *second.points}))
        if len(points) > MOST_CONTRACTED:
            return None
        known = self._orientations.among(points)
        if self._within is not None:
            return known
        inside = [set(piece.points) for piece in (first, second)]
        holds = [
            [any(s.issuperset(points_of(c)) for c in known if isinstance(c, Chirality))]
            for s in inside
        ]
        if all(h[0] for h in holds) or any(
            not any(s.issuperset(points_of(constraint)) for s in inside) for constraint in known
        ):
            return known
        apart = [sorted(s - t) for s, t in (inside, inside[::-1])]
        lower, _ = self._problem.bounds_among([*apart[0], *apart[1]])
        return known if (lower[: len(apart[0]), len(apart[0]) :] > 0.0).any() else None

    def _may_be(
        self, link: Link, pair: tuple[int, int], side: Side, known: list[Constraint]
    ) -> bool:
        """Return whether two hypotheses may go together on these sides of the face."""
        if self._budget.is_over():
            return True
        chosen = [
            (self._pieces[number].points, self._pieces[number].hypotheses[x])
            for number, x in zip((link.first, link.second), pair, strict=True)
        ]
        points = tuple(sorted({*chosen[0][0], *chosen[1][0]}))
        decided = link.constraint(*pair, side)
        constraints = [*known, decided] if decided else known
        bounds = bounds_within(points, [(p, (h.lower, h.upper)) for p, h in chosen])
        problem = restricted(self._problem, points, bounds, constraints)
        if problem is None:
            return False
        within = self._within and restricted_boxes(self._within, points)
        stopped = self._budget.is_over
        options = replace(self._budget.options, tighten_slices=0)
        return contracted(problem, options, within, stopped) is not None


def _agreeing(pieces: tuple[SolvedPiece, SolvedPiece], shared: Points) -> BoolArray:
    """Tell which pairs of hypotheses of two pieces agree on the distances of shared points."""
    together = np.ones([len(piece.hypotheses) for piece in pieces], dtype=np.bool_)
    for i, j in pairs_of(shared):
        ends = []
        for piece in pieces:
            index = piece.points.index(i), piece.points.index(j)
            ends.append(np.array([h.bounds_of_pair(*index) for h in piece.hypotheses]))
        first, second = ends
        together &= first[:, None, 0] <= second[None, :, 1]
        together &= second[None, :, 0] <= first[:, None, 1]
    return together
