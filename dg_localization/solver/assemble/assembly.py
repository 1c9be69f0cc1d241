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

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
import math

from dg_localization.solver.assemble.combinations import Combination, Combinations
from dg_localization.solver.assemble.contraction import MOST_WORK_TOGETHER, contracted, smoothed
from dg_localization.solver.assemble.links import Linker
from dg_localization.solver.assemble.placing import Layout
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.assemble.subproblem import Bounds, bounds_within, restricted
from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.budget import Budget


class Assembly:
    """Puts solved pieces of a problem together as a combination says."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        solved: SolvedPieces,
        combinations: Combinations,
        linker: Linker | None,
        within: Sequence[Bounds] | None,
    ) -> None:
        self.problem = problem
        self.solved = solved
        self.combinations = combinations
        self._linker = linker
        self._within = within
        self._unlimited = budget.again(replace(budget.options, max_seconds=math.inf))
        self._every = tuple(range(problem.n_points))

    def __getstate__(self) -> dict[str, object]:
        """Return what is pickled: what looks at the clock of the call is not."""
        return vars(self) | {'_linker': None}

    @cached_property
    def is_small(self) -> bool:
        """Whether few enough combinations are left to contract all points for each."""
        return self.combinations.number * self.problem.n_points**3 <= MOST_WORK_TOGETHER

    @cached_property
    def hull(self) -> Bounds | None:
        """The bounds of all combinations together; None when they prove that there is none."""
        if len(self.solved.pieces) == 1:
            return self.solved.pieces[0].hull(sorted(self.combinations.left[0]))
        return self.bounds(Combination({}, {}))

    def bounds(
        self,
        combination: Combination,
        budget: Budget | None = None,
        in_twos: bool = False,
        is_tightened: bool = False,
    ) -> Bounds | None:
        """
        Return the bounds of all pairs in a combination; None where it holds no placement.

        All points are contracted together or, of many, two linked pieces at a time.
        """
        n_times = 1 + any(site.is_merged for site in self.combinations.sites)
        chosen = self._chosen(combination)
        if in_twos:
            n_times = 1
            for link in self.combinations.forest:
                pieces = (link.first, link.second)
                signs = [combination.sides.get((link.number, piece), 0) for piece in pieces]
                # The product of two signs is -1 on opposite sides.
                side = -signs[0] * signs[1]
                x, y = (combination.hypotheses[piece] for piece in pieces)
                two = self._linker.bounds_of_two(link, x, y, side) if self._linker else None
                if two is None:
                    return None
                chosen.append(two)
        bounds: Bounds | None = bounds_within(self._every, chosen)
        decided = [] if in_twos else combination.constraints(self.combinations.sites)
        for _ in range(n_times):
            problem = restricted(self.problem, self._every, bounds, decided)
            if problem is None:
                return None
            if in_twos:
                return smoothed(problem, self._within)
            # What the first time says of flat pieces tells the sides of those at their ends.
            bounds = contracted(problem, budget or self._unlimited, self._within, is_tightened)
            if bounds is None:
                return None
        return bounds

    def placements(
        self, combination: Combination, least_m: float, most: int
    ) -> Iterator[FloatArray]:
        """Yield placements in m, pieces laid against each other; none where a piece has none."""
        pieces = [
            (piece.points, piece.hypotheses[combination.hypotheses[x]].positions)
            for x, piece in enumerate(self.solved.pieces)
        ]
        known = [(points, local) for points, local in pieces if local is not None]
        sides = combination.constraints(self.combinations.sites)
        for seed in range(most if len(known) == len(pieces) else 0):
            placer = Layout(known, self.solved.joints, sides, self.problem.dimension, seed)
            yield placer.place(least_m)
            if not placer.has_chosen:
                break

    def with_sides(self, combination: Combination) -> Problem:
        """Return the problem with the sides that a combination has."""
        decided = combination.constraints(self.combinations.sites)
        return restricted(self.problem, self._every, None, decided) or self.problem

    def _chosen(self, combination: Combination) -> list[tuple[Points, Bounds]]:
        """Return the bounds of each piece, of all its hypotheses where none is chosen."""
        chosen = []
        for number, piece in enumerate(self.solved.pieces):
            x = combination.hypotheses.get(number)
            left = sorted(self.combinations.left[number]) if x is None else [x]
            chosen.append((piece.points, piece.hull(left)))
        return chosen
