# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The hypotheses of a whole piece from those of its patches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, partial

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.interval.kernels import until
from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.rigid_components import is_flexible
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.patches.known_pairs import Ambiguities
from dg_localization.solver.patches.solver import SolvedPatches
from dg_localization.solver.place.existence import settled
from dg_localization.solver.place.hypotheses import (
    LARGEST_M2,
    LazyHypothesis,
    Placement,
    Seek,
    never,
)
from dg_localization.solver.place.placements import MARGIN, QUICK, refined, scaled, sought
from dg_localization.solver.place.proofs import pairs_lie_within, with_known_chirality
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.subproblem import (
    MOST_DENSE,
    MOST_NUMBERS,
    MOST_TOGETHER,
    Bounds,
    parts_within,
)


class ChainedHypothesis(LazyHypothesis):
    """
    A hypothesis of a large piece, which keeps the bounds of known pairs only.

    The bounds of all pairs, from chains of known ones, and the placement are computed at first
    use.
    """

    _graph: ChainGraph
    _n_points: int
    _within: Sequence[Bounds] | None

    def __init__(
        self,
        graph: ChainGraph,
        n_points: int,
        within: Sequence[Bounds] | None,
        seek: Seek | None = None,
        may_move: Callable[[Hypothesis], bool] | None = None,
    ) -> None:
        super().__init__(seek, may_move, _graph=graph, _n_points=n_points, _within=within)

    def bounds_of_pair(self, first: int, second: int) -> tuple[float, float]:
        """Return the bounds in m^2 of the squared distance of two points, by their rows."""
        lower, upper = self.bounds_among((first, second))
        return float(lower[0, 1]), float(upper[0, 1])

    @default_environment()
    def bounds_among(self, points: Sequence[int]) -> Bounds:
        """Return the bounds of all pairs of some points."""
        lower, upper = self._graph.bounds(np.array(points, dtype=np.int64))
        if self._within is not None:
            index = np.ix_(points, points)
            lower = np.maximum(lower, np.min([low[index] for low, _ in self._within], axis=0))
            upper = np.minimum(upper, np.max([high[index] for _, high in self._within], axis=0))
        return lower, upper

    @cached_property
    def _all(self) -> Bounds:
        """The bounds of all pairs."""
        return self.bounds_among(range(self._n_points))

    @property
    def lower(self) -> FloatArray:
        """Lower bounds of every squared distance in m^2, shape (n, n)."""
        return self._all[0]

    @property
    def upper(self) -> FloatArray:
        """Upper bounds of every squared distance in m^2, shape (n, n)."""
        return self._all[1]

    @property
    def boxes(self) -> FloatArray:
        """The one box of its cover, shape (1, 2, n, n)."""
        return np.stack(self._all)[None]


class PatchAnswers:
    """The combined hypotheses of the patches of a piece."""

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPatches,
        within: Sequence[Bounds] | None,
        budget: Budget,
    ) -> None:
        self._problem = problem
        self._solved = solved
        self._within = within
        self._budget = budget
        self._ambiguities = Ambiguities(solved.patches, solved.known, budget.is_over)
        known = solved.known
        self._chains = ChainGraph(problem.n_points, known.pairs, known.lower, known.upper)

    def boxes(self, most: int) -> list[Bounds]:
        """Return boxes of all pairs that together hold every placement."""
        rows, columns = self._solved.known.pairs.T
        boxes = []
        for choice in self._ambiguities.choices(most):
            low, high = self._chosen(choice)
            lower, upper = self._problem.lower.copy(), self._problem.upper.copy()
            lower[rows, columns] = lower[columns, rows] = low
            upper[rows, columns] = upper[columns, rows] = high
            boxes.append((lower, upper))
        return parts_within(boxes, self._within)

    def hypotheses(self, most: int) -> list[Hypothesis]:
        """Return hypotheses that together hold every placement."""
        n_points = self._problem.n_points
        limit = max(1, MOST_NUMBERS // n_points**2)
        choices = self._ambiguities.choices(1 if self._budget.is_over() else min(most, limit))
        return [
            ChainedHypothesis(
                self._chains.with_bounds(*self._chosen(choice)),
                n_points,
                self._within,
                partial(self._placement_of, choice),
                self._may_move,
            )
            for choice in choices
        ]

    def _placement_of(self, choice: Mapping[int, int]) -> Placement:
        """Return a placement for a choice of hypotheses."""
        start, anywhere = self._anywhere
        positions, proved = anywhere
        if start is None or positions is None or not choice:
            return anywhere
        # It belongs to the choice that it lies in; most other choices have no placement at all.
        if proved and self._is_within(positions, choice):
            return anywhere
        known = self._solved.known.pairs, *self._chosen(choice)
        positions = refined(start, *known, 0.0, never, QUICK)
        positions = refined(positions, *known, 0.5 * MARGIN, never, QUICK)
        positions, proved = self._settled(positions)
        return positions, proved and self._is_within(positions, choice)

    @cached_property
    def _anywhere(self) -> tuple[FloatArray | None, Placement]:
        """A placement laid out by chains, and one with any hypotheses of the patches."""
        stopped = self._budget.new_clock()
        nothing: Placement = (None, False)
        if stopped():
            return None, nothing
        pivots, lengths_m = self._chains.pivot_lengths_m(MOST_TOGETHER, stopped)
        if not lengths_m.max() ** 2 < LARGEST_M2:
            return None, nothing
        start = scaled(lengths_m, pivots, self._problem.dimension)
        return start, self._placement(start, stopped)

    def _placement(self, start: FloatArray, stopped: Callable[[], bool]) -> Placement:
        """Return a placement with any hypotheses of the patches, and whether it is proved."""
        known = self._solved.known.pairs, *self._chosen({})
        measured = self._problem.pairs.pairs, self._problem.pairs.lower, self._problem.pairs.upper
        # All known pairs give the shape; then the measured pairs must agree.
        positions = refined(start, *known, 0.0, stopped, QUICK)
        positions = refined(positions, *measured, MARGIN, stopped)
        proved = False
        with until(stopped):
            positions, proved = self._settled(positions)
        if not proved and not stopped():
            positions = sought(positions, *measured, stopped)
            with until(stopped):
                positions, proved = self._settled(positions)
        return positions, proved

    def _settled(self, positions: FloatArray) -> tuple[FloatArray, bool]:
        """Return a placement with the known chirality, and whether it is proved."""
        placed = with_known_chirality(self._problem, positions)
        return settled(self._problem, placed, self._boxes_within)

    @cached_property
    def _boxes_within(self) -> list[FloatArray] | None:
        """The boxes of `within`; None if placements may lie anywhere."""
        return None if self._within is None else [np.array(bounds) for bounds in self._within]

    def _is_within(self, positions: FloatArray, choice: Mapping[int, int]) -> bool:
        """Prove that the known pairs of a placement agree with a choice of hypotheses."""
        return pairs_lie_within(self._solved.known.pairs, *self._chosen(choice), positions)

    def _may_move(self, _: Hypothesis) -> bool:
        """Return whether a placement can move, or that takes too long to examine."""
        solved = self._solved
        patches = [h for p in solved.patches for h in p.remaining()]
        if solved.is_one_body and not any(h.flexible for h in patches):
            # Rigid patches that hold together are rigid as a whole.
            return False
        # The rank of a placement takes the cube of the points of time.
        if solved.n_unsolved > 0 or self._problem.n_points > MOST_DENSE:
            return True
        return self._is_flexible

    @cached_property
    def _is_flexible(self) -> bool:
        """Whether the placement of all patches is flexible, or was not proved in time."""
        positions, proved = self._anywhere[1]
        if positions is None or not proved:
            return True
        return is_flexible(positions, np.isfinite(self._problem.upper))

    def _chosen(self, choice: Mapping[int, int]) -> Bounds:
        """Return the bounds of the known pairs for a choice of hypotheses."""
        known = self._solved.known
        low, high = known.lower.copy(), known.upper.copy()
        for patch, x in choice.items():
            numbers, (patch_low, patch_high) = known.bounds_of(patch, x)
            low[numbers] = np.maximum(low[numbers], patch_low)
            high[numbers] = np.minimum(high[numbers], patch_high)
        return low, high
