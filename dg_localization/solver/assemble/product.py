# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The whole fleet: bounds and placements of the combinations that the pieces make together.

Nothing here is computed before it is asked for. A combination narrows the original problem to
what its hypotheses say of their pieces, with a side for every reflection that is decided; one
contraction, without a split, bounds the distances between the pieces.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property
import math
import time

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.solver.assemble.combinations import Combination, Combinations
from dg_localization.solver.assemble.contraction import MOST_CONTRACTED, bounds_within, contracted
from dg_localization.solver.assemble.placing import Placer
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.assemble.subproblem import (
    Bounds,
    Constraint,
    parts_within,
    restricted,
)
from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.joints import JointKind
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.options import SolverOptions
from dg_localization.solver.place.existence import settled
from dg_localization.solver.place.hypotheses import never, place_problem
from dg_localization.solver.place.placements import MOST_STEPS, refine
from dg_localization.solver.place.proofs import with_known_chirality
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis

MOST_REFINED = 100
"""Up to so many points a placement is refined by least squares, which takes their cube of time."""

MOST_AT_ONCE = 20
"""Up to so many rigid points a placement is first sought for all of them together."""

MOST_LISTED = 6400
"""Combinations times the square of the points, up to which all are looked at for a placement."""

MOST_ATTEMPTS = 4
"""How often a placement is put together until it is proved to agree."""


class Nothing:
    """The whole fleet where there is no placement at all: an empty set, with reversed bounds."""

    hypotheses: tuple[Hypothesis, ...] = ()

    def __init__(self, n_points: int) -> None:
        self.bounds = (
            np.full((n_points, n_points), np.inf),
            np.full((n_points, n_points), -np.inf),
        )


class Product:
    """
    All whole-fleet hypotheses of pieces that were solved one by one.

    Parameters
    ----------
    problem : Problem
        The problem of the whole fleet.
    options : SolverOptions
        Its options.
    solved : SolvedPieces
        The pieces and joints.
    combinations : Combinations
        The combinations that the joints allow.
    within : sequence of (lower, upper), optional
        The boxes in m^2 that placements have to lie in.
    cancelled : callable, optional
        Whether the call was cancelled; the hypotheses are less tight then.

    """

    def __init__(
        self,
        problem: Problem,
        options: SolverOptions,
        solved: SolvedPieces,
        combinations: Combinations,
        within: Sequence[Bounds] | None,
        cancelled: Callable[[], bool] = never,
    ) -> None:
        self._problem = problem
        self._cancelled = cancelled
        self._options = options
        self.solved = solved
        self.combinations = combinations
        self._within = within
        self._all_points = tuple(range(problem.n_points))

    def __getstate__(self) -> dict[str, object]:
        """Return what is pickled: whoever might cancel the call is not."""
        return vars(self) | {'_cancelled': never}

    @cached_property
    @default_environment()
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The first combinations, but those that turn out to hold no placement."""
        end = time.perf_counter() + self._options.max_seconds
        return self._build(lambda: self._cancelled() or time.perf_counter() > end)

    def _build(self, stopped: Callable[[], bool]) -> tuple[Hypothesis, ...]:
        """Build the hypotheses, less tight ones from when there is no time left."""
        if len(self.solved.pieces) == 1:
            return tuple(self.solved.pieces[0].hypotheses)
        count = min(self.combinations.number, self._options.max_hypotheses)
        end = time.perf_counter() + self._options.tighten_seconds

        def options() -> SolverOptions:
            left = end - time.perf_counter()
            if left <= 0.0:
                return replace(self._options, tighten_slices=0)
            return replace(self._options, tighten_seconds=left)

        found = (
            self._hypothesis(self.combinations[rank], options(), stopped) for rank in range(count)
        )
        return tuple(hypothesis for hypothesis in found if hypothesis is not None)

    @cached_property
    @default_environment()
    def bounds(self) -> Bounds:
        """Lower and upper bounds in m^2 of all squared distances, over all combinations."""
        return self._all or Nothing(self._problem.n_points).bounds

    def is_empty(self, is_crossed: bool, is_tied: bool, stopped: Callable[[], bool]) -> bool:
        """
        Prove that no combination holds a placement, or return False.

        Parameters
        ----------
        is_crossed : bool
            Sides, chiralities or least distances are known between different pieces.
        is_tied : bool
            The joints close a loop, or all placements have to lie in some boxes.
        stopped : callable
            Whether there is no time left to look.

        Returns
        -------
        bool
            True is a proof.

        """
        if not (is_crossed or is_tied) or stopped():
            return False
        if self._all is None:
            return True
        most = min(self._options.max_hypotheses, MOST_LISTED // self._problem.n_points**2)
        if not is_crossed or self.combinations.number > most or stopped():
            return False
        self.hypotheses = self._build(stopped)
        return not self.hypotheses

    @cached_property
    def _all(self) -> Bounds | None:
        """The bounds of all combinations together; None when they prove that there is none."""
        parts: list[tuple[Points, Bounds]] = []
        for piece, left in zip(self.solved.pieces, self.combinations.left, strict=True):
            hypotheses = [piece.hypotheses[x] for x in sorted(left)]
            lower = np.min([h.lower for h in hypotheses], axis=0)
            upper = np.max([h.upper for h in hypotheses], axis=0)
            parts.append((piece.points, (lower, upper)))
        if len(parts) == 1:
            return parts[0][1]
        problem = self._narrowed(parts, None)
        options = replace(self._options, tighten_slices=0)
        return contracted(problem, options, self._within) if problem else None

    def _narrowed(
        self,
        parts: Sequence[tuple[Points, Bounds]],
        combination: Combination | None,
    ) -> Problem | None:
        """Return the problem within the bounds of its pieces and with the sides that are known."""
        constraints: list[Constraint] = [*self._problem.sides, *self._problem.chiralities]
        if combination is not None:
            constraints += combination.constraints()
        bounds = bounds_within(self._all_points, parts)
        return restricted(self._problem, self._all_points, bounds, constraints)

    def _hypothesis(
        self, combination: Combination, options: SolverOptions, stopped: Callable[[], bool]
    ) -> Hypothesis | None:
        """Return the whole fleet as a combination has it; None when that is impossible."""
        chosen = [
            piece.hypotheses[x]
            for piece, x in zip(self.solved.pieces, combination.hypotheses, strict=True)
        ]
        parts = [
            (piece.points, (hypothesis.lower, hypothesis.upper))
            for piece, hypothesis in zip(self.solved.pieces, chosen, strict=True)
        ]
        problem = self._narrowed(parts, combination)
        bounds = contracted(problem, options, self._within, stopped) if problem else None
        if problem is None or bounds is None:
            return None
        # The bounds are the hull of what lies within one of several boxes.
        boxes = [np.stack(part) for part in parts_within(bounds, self._within)]
        positions, proved = self._placement(problem, bounds, boxes, combination, chosen, stopped)
        flexible = self._turns or any(hypothesis.flexible for hypothesis in chosen)
        return Hypothesis(bounds[0], bounds[1], np.stack(boxes), positions, proved, flexible)

    @cached_property
    def _turns(self) -> bool:
        """Whether some joint is open, or some pieces are not joined at all."""
        group = list(range(len(self.solved.pieces)))
        for joint in self.solved.joints:
            if joint.kind is not JointKind.REFLECTION:
                return True
            together = {group[piece] for piece in joint.pieces}
            group = [min(together) if number in together else number for number in group]
        return len(set(group)) > 1

    def _placement(
        self,
        problem: Problem,
        bounds: Bounds,
        boxes: Sequence[FloatArray],
        combination: Combination,
        chosen: Sequence[Hypothesis],
        stopped: Callable[[], bool],
    ) -> tuple[FloatArray | None, bool]:
        """Return a placement of a combination, and whether it is proved to agree, in a box."""
        begins_at_once = problem.n_points <= MOST_AT_ONCE and not self._turns
        if begins_at_once:
            positions, proved = settled(self._problem, self._at_once(problem, bounds), boxes)
            if proved:
                return positions, True
        pieces = [
            (piece.points, hypothesis.positions)
            for piece, hypothesis in zip(self.solved.pieces, chosen, strict=True)
            if hypothesis.positions is not None
        ]
        if len(pieces) < len(chosen):
            # There was no time to place one of them.
            return None, False
        reflections = combination.reflections()
        least_m = math.sqrt(problem.lower.max())
        known = np.stack([problem.lower, problem.upper])
        first = None
        for seed in range(MOST_ATTEMPTS):
            placer = Placer(pieces, self.solved.joints, reflections, self._problem.dimension, seed)
            positions = with_known_chirality(self._problem, placer.place(least_m))
            positions, proved = settled(self._problem, positions, boxes)
            if proved:
                return positions, True
            if stopped():
                return positions, False
            if problem.n_points <= MOST_REFINED:
                refined = refine(positions, known, MOST_STEPS)
                positions = with_known_chirality(self._problem, refined)
                positions, proved = settled(self._problem, positions, boxes)
                if proved:
                    return positions, True
            if first is None:
                first = positions
            if not placer.has_chosen:
                break
        if problem.n_points <= MOST_CONTRACTED and not begins_at_once:
            positions, proved = settled(self._problem, self._at_once(problem, bounds), boxes)
            if proved:
                return positions, True
        return first, False

    @staticmethod
    def _at_once(problem: Problem, bounds: Bounds) -> FloatArray:
        """Return a placement by the bounds of all distances, whatever the pieces."""
        return place_problem(problem, np.array([*bounds, *np.zeros_like(bounds)]))
