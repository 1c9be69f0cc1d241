# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The hypotheses of the whole fleet, counted at once and built on demand."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
import math

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.solver.assemble.assembly import Assembly
from dg_localization.solver.assemble.combinations import Combination, Combinations, Network
from dg_localization.solver.assemble.links import Linker, crossing_pairs, is_degenerate
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.box import UPPER, FloatArray
from dg_localization.solver.place.hypotheses import (
    MOST_STARTS,
    Placement,
    first_proved,
    hulls_of,
    never,
    place_problem,
)
from dg_localization.solver.place.placements import MARGIN, refined, sought
from dg_localization.solver.problem import Problem, points_of
from dg_localization.solver.result import Hypothesis, JointKind
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.subproblem import (
    MOST_CONTRACTED,
    MOST_WORK,
    MOST_WORK_TOGETHER,
    Bounds,
    as_box,
    parts_within,
)

STEPS_PER_HYPOTHESIS = 16
"""Choices, complete or partial, that are examined per hypothesis to list."""


@dataclass
class _Listing:
    """Listed hypotheses, with limits of their number and of the choices to examine."""

    most: int
    steps_left: int
    found: list[Hypothesis] = field(default_factory=list)
    is_complete: bool = True

    def may_step(self) -> bool:
        """Count one more choice; return whether it may be examined."""
        self.steps_left -= 1
        return self.steps_left >= 0


class Nothing:
    """The whole fleet without any placement: an empty set, with reversed bounds."""

    hypotheses: tuple[Hypothesis, ...] = ()
    is_bound = False

    def __init__(self, n_points: int) -> None:
        self.bounds = (
            np.full((n_points, n_points), np.inf),
            np.full((n_points, n_points), -np.inf),
        )


class Product:
    """All hypotheses of the whole fleet, from pieces that were solved one by one."""

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPieces,
        budget: Budget,
        within: Sequence[Bounds] | None,
    ) -> None:
        self._problem = problem
        self._budget = budget
        self._options = budget.options
        self.solved = solved
        self._within = within
        is_joined = len(solved.pieces) > 1 and bool(solved.joints)
        linker = Linker(problem, solved, budget, within) if is_joined else None
        network = linker.network(solved.joints) if linker else Network()
        counts = [len(piece.hypotheses) for piece in solved.pieces]
        self.combinations = Combinations(counts, network)
        self._assembly = Assembly(problem, budget, solved, self.combinations, linker, within)
        # Crossed: constraints beyond the distances within pieces. Tied: `within`, or a loop.
        self._is_crossed = _is_crossed(problem, solved)
        n_groups = solved.n_groups()
        n_linked = sum(len(joint.pieces) - 1 for joint in solved.joints)
        has_loop = n_linked > len(solved.pieces) - n_groups
        self._is_tied = within is not None or has_loop
        is_open = any(joint.kind is not JointKind.REFLECTION for joint in solved.joints)
        self._turns = is_open or n_groups > 1
        self._is_counted = not (self._is_crossed or self._is_tied)
        self.number = 0 if self.combinations.contradiction is not None else self._count(budget)

    def _count(self, budget: Budget) -> int:
        """
        Return an upper bound of the number of hypotheses; 0 proves that there is none.

        If there are constraints beyond the distances within pieces, the combinations are examined
        one by one, up to a limit.
        """
        number, n_points = self.combinations.number, self._problem.n_points
        is_plain = self._is_counted and self.combinations.is_exact
        if is_plain or len(self.solved.pieces) == 1:
            return number
        if n_points <= MOST_CONTRACTED and not budget.is_over():
            if not self._is_counted and self._assembly.hull is None:
                return 0
            is_listed = self._is_crossed or not self.combinations.is_exact
            if is_listed and self.combinations.lists_all_sides:
                most_steps = max(1, MOST_WORK // n_points**3)
                listing = _Listing(self._options.max_hypotheses, most_steps)
                self._list(listing, budget)
                if listing.is_complete and not budget.is_over():
                    self._is_counted = True
                    self.hypotheses = tuple(listing.found)
                    return len(listing.found)
        # Each combination may have a part in each group of boxes.
        boxes = [as_box(part) for part in self._within or ()]
        return number * max(1, len(hulls_of(boxes)))

    @cached_property
    @default_environment()
    def bounds(self) -> Bounds:
        """Lower and upper bounds in m^2 of all squared distances, over all combinations."""
        return self._assembly.hull or Nothing(self._problem.n_points).bounds

    @cached_property
    @default_environment()
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """The first combinations, without those that prove to hold no placement."""
        most = self._options.max_hypotheses
        listing = _Listing(most, STEPS_PER_HYPOTHESIS * most)
        # A list built on demand may take as long as the call.
        self._list(listing, self._budget.again())
        lower, upper = self.bounds if not listing.is_complete else (np.array(1), np.array(0))
        if not listing.found and (lower <= upper).all():
            # Placements may be in any of the combinations that were not examined.
            return (Hypothesis(lower, upper, np.array([[lower, upper]]), None, False, True),)
        return tuple(listing.found)

    @cached_property
    @default_environment()
    def is_bound(self) -> bool:
        """Whether some of the counted combinations may hold no placement."""
        pieces = self.solved.pieces
        if not all(piece.is_finished for piece in pieces):
            return True
        if not self.combinations.lists_all_sides:
            return True
        if len(pieces) == 1 or self.number <= self._options.max_hypotheses:
            listed = self.hypotheses
            return len(listed) < self.number or not all(h.proved for h in listed)
        # If only distances within pieces are known, one placement can be mirrored at every joint.
        is_plain = self._is_counted and self.combinations.is_exact
        is_single = all(len(left) == 1 for left in self.combinations.left)
        if not (is_plain and is_single):
            return True
        first = _Listing(1, STEPS_PER_HYPOTHESIS)
        self._list(first, self._budget.again())
        return not (first.found and first.found[0].proved)

    def boxes(
        self,
    ) -> tuple[list[FloatArray], Callable[[int, Callable[[], bool]], FloatArray | None]]:
        """
        Return a box for each combination, or one for all if there are too many to list.

        Also return a function that gives a placement in m, (n, q), in or near a box by its number,
        or None if a piece has no placement.
        """
        found: list[FloatArray] = []
        of: list[Combination] = []
        # If there are many, two linked pieces at a time are contracted.
        in_twos = self.combinations.number * self._problem.n_points**3 > MOST_WORK_TOGETHER
        if self.combinations.number > self._options.max_hypotheses:
            hull = self._assembly.hull
            first = next(self.combinations.listed(lambda _: True), None)
            listed = [(first, hull)] if first and hull else []
        else:
            every = self.combinations.listed(lambda _: True)
            bounds_of = partial(self._assembly.bounds, budget=self._budget, in_twos=in_twos)
            listed = [(c, bounds) for c in every if (bounds := bounds_of(c))]
        for combination, bounds in listed:
            for part in parts_within([bounds], self._within):
                found.append(as_box(part))
                of.append(combination)
        return found, partial(self._laid, of)

    def _laid(
        self, combinations: list[Combination], number: int, stopped: Callable[[], bool]
    ) -> FloatArray | None:
        """Return a placement of a combination: pieces aligned, and fitted to all bounds."""
        known, combination = self._problem.pairs, combinations[number]
        for positions in self._assembly.placements(combination, 0.0, int(not stopped())):
            return refined(positions, known.pairs, known.lower, known.upper, MARGIN, stopped)
        return None

    def _list(self, listing: _Listing, budget: Budget) -> None:
        """Build hypotheses; without time they are not tightened."""
        if len(self.solved.pieces) == 1:
            listing.found = list(self.solved.pieces[0].hypotheses)
            return

        def is_possible(combination: Combination) -> bool:
            if not (self._is_crossed or self._is_tied) or not listing.may_step():
                return True
            return self._assembly.bounds(combination, budget) is not None

        for combination in self.combinations.listed(is_possible):
            if not listing.may_step() or len(listing.found) >= listing.most:
                listing.is_complete = False
                return
            listing.found += self._hypotheses(combination, budget, not listing.found)

    def _hypotheses(
        self,
        combination: Combination,
        budget: Budget,
        is_first: bool,
    ) -> Iterator[Hypothesis]:
        """Yield the hypotheses of a combination, one for each connected part of it."""
        bounds = self._assembly.bounds(combination, budget, is_tightened=True)
        if bounds is None:
            return
        chosen = [
            piece.hypotheses[combination.hypotheses[x]]
            for x, piece in enumerate(self.solved.pieces)
        ]
        flexible = self._turns or any(h.flexible for h in chosen) or self._may_turn(chosen)
        parts = [as_box(part) for part in parts_within([bounds], self._within)]
        for hull, numbers in hulls_of(parts):
            boxes = [parts[x][: UPPER + 1] for x in numbers]
            found: Placement = (None, False)
            if is_first or not budget.is_over():
                problem = self._assembly.with_sides(combination)
                attempts = self._attempts(problem, combination, hull, budget.is_over)
                found = first_proved(problem, attempts, boxes, budget.is_over, never)
            yield Hypothesis(hull[0], hull[1], np.stack(boxes), *found, flexible)

    def _may_turn(self, chosen: Sequence[Hypothesis]) -> bool:
        """Return whether the points of some face are in line or coincide."""
        for joint in self.solved.joints:
            points = self.solved.pieces[joint.pieces[0]].points
            positions = chosen[joint.pieces[0]].positions
            if positions is None or is_degenerate(
                positions[np.searchsorted(points, joint.points)]
            ):
                return True
        return False

    def _attempts(
        self,
        problem: Problem,
        combination: Combination,
        bounds: FloatArray,
        stopped: Callable[[], bool],
    ) -> Iterator[FloatArray]:
        """Yield placements that may agree: of aligned pieces, and of all points together."""
        known = problem.pairs.pairs
        rows, columns = known.T
        lower, upper = bounds[0][rows, columns], bounds[1][rows, columns]
        least_m = math.sqrt(bounds[0].max())
        for positions in self._assembly.placements(combination, least_m, MOST_STARTS):
            yield positions
            yield sought(positions, known, lower, upper, stopped)
        if problem.n_points <= MOST_CONTRACTED:
            yield place_problem(problem, as_box((bounds[0], bounds[1])))


def _is_crossed(problem: Problem, solved: SolvedPieces) -> bool:
    """Return whether a side, chirality or lower bound connects different pieces."""
    if len(solved.pieces) == 1:
        return False
    if len(problem.chiralities) > 1:
        return True
    if crossing_pairs(problem, solved.pieces):
        return True
    sets = [set(piece.points) for piece in solved.pieces]
    return any(not any(s.issuperset(points_of(c)) for s in sets) for c in problem.constraints)
