# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The hypotheses of a whole piece from those of its patches."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds, common_parts
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.patches.choices import Ambiguities
from dg_localization.solver.patches.placing import laid_together
from dg_localization.solver.patches.solver import SolvedPatches
from dg_localization.solver.place.existence import settled
from dg_localization.solver.place.hypotheses import LARGEST_M2
from dg_localization.solver.place.placements import MARGIN
from dg_localization.solver.place.proofs import with_known_chirality
from dg_localization.solver.place.rigidity import is_flexible
from dg_localization.solver.place.sparse_placements import refined, scaled, sought
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis

MOST_NUMBERS = 10**6
"""Hypotheses times the square of the points, up to which those of a large piece are listed."""

MOST_SCALED = 300
"""Up to so many points the chains between all of them are the start of a placement."""

MOST_RANKED = 150
"""Up to so many points the rank of a placement is computed, which takes their cube of time."""


class ChainedHypothesis(Hypothesis):
    """
    A hypothesis of a large piece, which keeps the bounds of known pairs only.

    Those of all pairs follow from chains of known ones when they are asked for.

    Parameters
    ----------
    graph : ChainGraph
        The known pairs.
    n_points : int
        The number of points.
    within : sequence of (lower, upper), optional
        The boxes in m^2 that placements have to lie in; everywhere without any.
    positions : ndarray, shape (n, q), or None
        A placement in m.
    proved : bool
        Whether it meets every constraint.
    flexible : bool
        Whether the placements are a continuum even without measurement errors.

    """

    _graph: ChainGraph
    _n_points: int
    _within: Sequence[Bounds] | None

    def __init__(
        self,
        graph: ChainGraph,
        n_points: int,
        within: Sequence[Bounds] | None,
        positions: FloatArray | None,
        proved: bool,
        flexible: bool,
    ) -> None:
        # The base class is frozen.
        values = {
            '_graph': graph,
            '_n_points': n_points,
            '_within': within,
            'positions': positions,
            'proved': proved,
            'flexible': flexible,
        }
        self.__dict__.update(values)

    def bounds_of_pair(self, first: int, second: int) -> tuple[float, float]:
        """Return the bounds in m^2 of the squared distance of two points, by their rows."""
        lower, upper = self.bounds_among((first, second))
        return float(lower[0, 1]), float(upper[0, 1])

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
    """
    What the patches of a piece make together.

    Parameters
    ----------
    problem : Problem
        The piece.
    solved : SolvedPatches
        Its patches.
    within : sequence of (lower, upper), optional
        The boxes in m^2 that placements have to lie in; everywhere without any.
    stopped : callable
        Whether there is no time left to look for choices and placements that agree.

    """

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPatches,
        within: Sequence[Bounds] | None,
        stopped: Callable[[], bool],
    ) -> None:
        self._problem = problem
        self._solved = solved
        self._within = within
        self._stopped = stopped
        self._ambiguities = Ambiguities(solved.patches, solved.known, stopped)

    def boxes(self, most: int) -> list[Bounds]:
        """
        Return boxes of all pairs that hold every placement between them.

        Parameters
        ----------
        most : int
            Choices of hypotheses to tell apart; where there are more, one box holds them all.

        Returns
        -------
        list of (ndarray, ndarray)
            Lower and upper bounds in m^2, shapes (n, n).

        """
        rows, columns = self._solved.known.pairs.T
        boxes = []
        for choice in self._choices(most):
            low, high = self._chosen(choice)
            lower, upper = self._problem.lower.copy(), self._problem.upper.copy()
            lower[rows, columns] = lower[columns, rows] = low
            upper[rows, columns] = upper[columns, rows] = high
            boxes.append((lower, upper))
        if self._within is None:
            return boxes
        return common_parts(boxes, self._within)

    def hypotheses(self, most: int) -> list[Hypothesis]:
        """
        Return hypotheses that hold every placement between them.

        Parameters
        ----------
        most : int
            Choices of hypotheses to tell apart; where there are more, one hypothesis holds all.

        Returns
        -------
        list of Hypothesis
            One for each choice.

        """
        n_points = self._problem.n_points
        known = self._solved.known
        chains = ChainGraph(n_points, known.pairs, known.lower, known.upper)
        most = 1 if self._stopped() else min(most, max(1, MOST_NUMBERS // n_points**2))
        choices = self._choices(most)
        graphs = [chains.with_bounds(*self._chosen(choice)) for choice in choices]
        placed = self._placements(choices, chains)
        flexible = self._is_flexible(placed[0][0])
        return [
            ChainedHypothesis(graph, n_points, self._within, positions, proved, flexible)
            for graph, (positions, proved) in zip(graphs, placed, strict=True)
        ]

    def _placements(
        self, choices: Sequence[Mapping[int, int]], chains: ChainGraph
    ) -> list[tuple[FloatArray | None, bool]]:
        """Return a placement for each choice, and whether it is proved to agree."""
        placed: list[tuple[FloatArray | None, bool]] = []
        by_chains = self._placement_by_chains(chains) if len(choices) == 1 else None
        if by_chains is not None:
            return [by_chains]
        for choice in choices:
            if placed and self._stopped():
                # Without time for one of its own it has the placement of another.
                placed.append((placed[0][0], False))
                continue
            positions = self._placement(choice or self._ambiguities.first())
            placed.append(self._settled(positions) if positions is not None else (None, False))
        if len(choices) > 1 and not any(proved for _, proved in placed):
            positions, proved = self._placement_by_chains(chains) or (None, False)
            if positions is not None and proved:
                for x, choice in enumerate(choices):
                    if self._is_within(positions, choice):
                        placed[x] = positions, True
        return placed

    def _placement_by_chains(self, chains: ChainGraph) -> tuple[FloatArray, bool] | None:
        """Return a placement laid out by the chains between all points, None without any."""
        problem, known = self._problem, self._solved.known
        if problem.n_points > MOST_SCALED or self._stopped():
            return None
        _, longest_m2 = chains.bounds(np.arange(problem.n_points))
        if not longest_m2.max() < LARGEST_M2:
            return None
        positions = scaled(longest_m2, problem.dimension)
        positions = refined(positions, known.pairs, *self._chosen({}), 0.0, self._stopped)
        return self._settled(sought(positions, *self._measured, self._stopped))

    def _settled(self, positions: FloatArray) -> tuple[FloatArray, bool]:
        """Return a placement with the chirality that is known, and whether it is proved."""
        return settled(self._problem, with_known_chirality(self._problem, positions))

    def _is_within(self, positions: FloatArray, choice: Mapping[int, int]) -> bool:
        """Return whether the known pairs of a placement agree with a choice of hypotheses."""
        first, second = self._solved.known.pairs.T
        squared = ((positions[first] - positions[second]) ** 2).sum(axis=1)
        low, high = self._chosen(choice)
        return bool(((low <= squared) & (squared <= high)).all())

    def _is_flexible(self, positions: FloatArray | None) -> bool:
        """
        Return whether a placement can move, where that is to be had in time.

        Rigid patches that hold together are rigid as a whole. Else the rank decides, and a piece
        that is too large for it is rigid, as its graph is.
        """
        solved, problem = self._solved, self._problem
        if solved.is_one_body and not any(
            h.flexible for p in solved.patches for h in p.remaining()
        ):
            return False
        if positions is None or problem.n_points > MOST_RANKED or self._stopped():
            return False
        return bool(is_flexible(positions, np.isfinite(problem.upper)))

    def _choices(self, most: int) -> list[dict[int, int]]:
        """Return a hypothesis for each ambiguous patch, or none chosen where there are many."""
        choices = self._ambiguities.choices(most)
        return [{}] if choices is None else choices

    def _chosen(self, choice: Mapping[int, int]) -> Bounds:
        """Return the bounds of the known pairs for a choice of hypotheses."""
        known = self._solved.known
        low, high = known.lower.copy(), known.upper.copy()
        for patch, x in choice.items():
            numbers, (patch_low, patch_high) = known.bounds_of(patch, x)
            low[numbers] = np.maximum(low[numbers], patch_low)
            high[numbers] = np.minimum(high[numbers], patch_high)
        return low, high

    def _placement(self, choice: Mapping[int, int]) -> FloatArray | None:
        """Return a placement for one hypothesis of every patch, None without time for one."""
        stopped = self._stopped
        local = []
        for number, patch in enumerate(self._solved.patches):
            chosen = choice.get(number, int(np.argmax(patch.left)))
            positions = patch.hypotheses[chosen].positions
            if positions is not None and np.isfinite(positions).all():
                local.append((patch.points, positions))
        problem, known = self._problem, self._solved.known
        low, high = self._chosen(choice)
        positions = np.full((problem.n_points, problem.dimension), np.nan)
        if local:
            args = problem.n_points, local, known.pairs, low, high
            positions = laid_together(*args, stopped)
        lost = ~np.isfinite(positions[:, 0])
        if lost.any() and stopped():
            return None
        if lost.any():
            # Points of patches that were not solved: anywhere, but not in one place.
            spread = np.random.default_rng(0).standard_normal((int(lost.sum()), len(positions[0])))
            positions[lost] = np.sqrt(high.max(initial=1.0)) * spread
            return positions
        # Known pairs give the shape; what has to agree are the measured ones.
        positions = refined(positions, known.pairs, low, high, 0.0, stopped)
        return refined(positions, *self._measured, MARGIN, stopped)

    @cached_property
    def _measured(self) -> tuple[IntArray, FloatArray, FloatArray]:
        """The pairs that the problem bounds, and their bounds in m^2."""
        bounded = self._problem.pairs
        return bounded.pairs, bounded.lower, bounded.upper
