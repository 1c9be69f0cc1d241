# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds and placements of the combinations that pieces make together.

A combination narrows the original problem to what its hypotheses say of their pieces, with a side
for every apex. One contraction, without a split, bounds the distances between the pieces; where
there are many points or combinations, two linked pieces at a time are contracted, and chains of
known distances bound the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import cached_property

from dg_localization.solver.assemble.combinations import Combination, Combinations, PieceLink
from dg_localization.solver.assemble.contraction import (
    MOST_CONTRACTED,
    bounds_within,
    contracted,
    smoothed,
)
from dg_localization.solver.assemble.placing import Layout
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.assemble.subproblem import (
    Bounds,
    Constraint,
    Orientations,
    restricted,
)
from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.problem import Problem, SideConstraint

MOST_TOGETHER = 64_000
"""Combinations times the cube of the points, up to which all parts of a piece are contracted
together. Of more combinations, two parts at a time are, each two of their hypotheses once."""


class Assembly:
    """Puts solved pieces of a problem together as a combination says."""

    def __init__(
        self,
        problem: Problem,
        options: SolverOptions,
        solved: SolvedPieces,
        combinations: Combinations,
        within: Sequence[Bounds] | None,
    ) -> None:
        self.problem = problem
        self.solved = solved
        self.combinations = combinations
        self._within = within
        self._without_slices = replace(options, tighten_slices=0)
        self._every = tuple(range(problem.n_points))
        self._orientations = Orientations(problem)
        self._of_two: dict[tuple[int, ...], tuple[Points, Bounds] | None] = {}

    @cached_property
    def is_small(self) -> bool:
        """Whether few enough combinations are left to contract all points for each."""
        return self.combinations.number * self.problem.n_points**3 <= MOST_TOGETHER

    @cached_property
    def hull(self) -> Bounds | None:
        """The bounds of all combinations together; None when they prove that there is none."""
        if len(self.solved.pieces) == 1:
            return self.solved.pieces[0].hull(sorted(self.combinations.left[0]))
        return self.bounds(Combination({}, {}))

    def bounds(
        self,
        combination: Combination,
        options: SolverOptions | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> Bounds | None:
        """Return the bounds of all pairs in a combination; None where it holds no placement."""
        n_times = 1 + any(site.is_merged for site in self.combinations.sites)
        bounds: Bounds | None = bounds_within(self._every, self._chosen(combination))
        for _ in range(n_times):
            narrowed = self._narrowed(self._every, bounds, self._sides(combination))
            if narrowed is None:
                return None
            # What the first time says of flat pieces tells the sides of those at their ends.
            chosen = options or self._without_slices
            bounds = contracted(narrowed, chosen, self._within, stopped)
            if bounds is None:
                return None
        return bounds

    def bounds_by_twos(
        self, combination: Combination, stopped: Callable[[], bool]
    ) -> Bounds | None:
        """Return the same, of two linked pieces at a time."""
        chosen = self._chosen(combination)
        for link in self.combinations.forest:
            two = self._bounds_of_two(link, combination, stopped)
            if two is None:
                return None
            chosen.append(two)
        narrowed = self._narrowed(self._every, bounds_within(self._every, chosen), [])
        return smoothed(narrowed, self._within) if narrowed else None

    def placements(
        self, combination: Combination, least_m: float, most: int
    ) -> Iterator[FloatArray]:
        """Yield placements in m, pieces laid against each other; none where a piece has none."""
        pieces = [
            (piece.points, piece.hypotheses[combination.hypotheses[x]].positions)
            for x, piece in enumerate(self.solved.pieces)
        ]
        known = [(points, local) for points, local in pieces if local is not None]
        sides = self._sides(combination)
        for seed in range(most if len(known) == len(pieces) else 0):
            placer = Layout(known, self.solved.joints, sides, self.problem.dimension, seed)
            yield placer.place(least_m)
            if not placer.has_chosen:
                break

    def with_sides(self, combination: Combination) -> Problem:
        """Return the problem with the sides that a combination has."""
        every: list[Constraint] = [*self.problem.sides, *self.problem.chiralities]
        every += self._sides(combination)
        sided = restricted(self.problem, self._every, None, every)
        return sided or self.problem

    def _sides(self, combination: Combination) -> list[SideConstraint]:
        return combination.constraints(self.combinations.sites)

    def _narrowed(
        self, points: Points, bounds: Bounds | None, decided: Sequence[SideConstraint]
    ) -> Problem | None:
        """Return the problem of some points within bounds; None where they leave nothing."""
        known: list[Constraint] = [*self._orientations.among(points), *decided]
        return restricted(self.problem, points, bounds, known)

    def _chosen(self, combination: Combination) -> list[tuple[Points, Bounds]]:
        """Return the bounds of each piece, of all its hypotheses where none is chosen."""
        chosen = []
        for number, piece in enumerate(self.solved.pieces):
            x = combination.hypotheses.get(number)
            left = sorted(self.combinations.left[number]) if x is None else [x]
            chosen.append((piece.points, piece.hull(left)))
        return chosen

    def _bounds_of_two(
        self, link: PieceLink, combination: Combination, stopped: Callable[[], bool]
    ) -> tuple[Points, Bounds] | None:
        """Return the bounds of two linked pieces; None where they have no placement."""
        pieces = (link.first, link.second)
        x, y = (combination.hypotheses[piece] for piece in pieces)
        signs = [combination.sides.get((link.number, piece), 0) for piece in pieces]
        key = (*pieces, x, y, signs[0] * signs[1])
        if key not in self._of_two:
            chosen = []
            for piece, hypothesis in zip(pieces, (x, y), strict=True):
                solved = self.solved.pieces[piece]
                chosen.append((solved.points, solved.hull([hypothesis])))
            points = tuple(sorted({*chosen[0][0], *chosen[1][0]}))
            inside = set(points)
            decided = [
                side
                for side in self._sides(combination)
                if inside.issuperset((*side.face, side.first, side.second))
            ]
            if len(points) > MOST_CONTRACTED:
                named = {p for side in decided for p in (*side.face, side.first, side.second)}
                points = tuple(sorted(named or set(chosen[0][0]) & set(chosen[1][0])))
                chosen = [
                    self.solved.pieces[piece].among(points, number)
                    for piece, number in zip(pieces, (x, y), strict=True)
                ]
            narrowed = self._narrowed(points, bounds_within(points, chosen), decided)
            args = self._without_slices, None, stopped
            bounds = contracted(narrowed, *args) if narrowed else None
            self._of_two[key] = (points, bounds) if bounds else None
        return self._of_two[key]
