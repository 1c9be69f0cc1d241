# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A large rigid piece, solved in patches.

Small rigid neighborhoods cover all measured pairs and overlap. Each is solved as a problem of its
own; what all of them say of a shared pair narrows it, and hypotheses that contradict their
neighbors are dropped. Further patches cross the seams between those that are held together, and
look again at those that several hypotheses are left of. Every placement of the piece is a
placement of each patch, so that nothing is lost, whatever the patches are.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds, restricted, restricted_boxes
from dg_localization.solver.assemble.tasks import Subproblem, solve_subproblems
from dg_localization.solver.box import UPPER
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.patches.known_pairs import Ambiguities, KnownPairs, Patch
from dg_localization.solver.patches.neighborhoods import (
    PATCH_POINTS,
    Neighborhoods,
    bodies_of,
    covering_patches,
    seam_patches,
)
from dg_localization.solver.problem import Problem, points_of
from dg_localization.solver.search.budget import Budget

MOST_WHOLE = 16
"""A piece of more points is solved in patches, in the plane."""

MOST_PATCH_BOXES = 200
MOST_SEAM_BOXES = 40
MOST_REVIEW_BOXES = 12
"""One patch may take this many boxes; those that come later are given up where they take more."""

REVIEW_POINTS = 14
"""Most points of a patch that looks again at what another one leaves open."""


@dataclass
class SolvedPatches:
    """The patches of a piece."""

    patches: list[Patch]
    known: KnownPairs
    is_one_body: bool = False  # they hold all points of the piece together
    n_unsolved: int = 0  # were not begun for want of time

    def is_empty(self) -> bool:
        """Return whether a patch is left without a hypothesis: there is no placement."""
        return len(self.patches) == 1 and not self.patches[0].left.any()

    def is_complete(self) -> bool:
        """Return whether all patches were examined to the end."""
        return self.n_pending() == 0

    def n_boxes(self) -> int:
        """Return how many boxes the patches have; one that was not solved has one."""
        return sum(patch.n_boxes() for patch in self.patches) + self.n_unsolved

    def n_pending(self) -> int:
        """Return how many of these were not examined to the end."""
        return sum(patch.n_pending() for patch in self.patches) + self.n_unsolved


class PatchSolver:
    """Solves a piece in patches."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        share: float,
        within: Sequence[Bounds] | None,
        is_reviewed: bool,
    ) -> None:
        self._problem = problem
        self._budget = budget
        self._within = within
        self._is_over = budget.has_passed(share)
        self._is_reviewed = is_reviewed
        self._pairs: list[Pair] = [(i, j) for i, j in problem.pairs.measured.tolist()]
        self._tried: set[Points] = set()
        self._measured = Neighborhoods(problem.n_points, self._pairs, problem.dimension)

    def run(self) -> SolvedPatches | None:
        """Return the solved patches, None where no neighborhood is rigid."""
        q = self._problem.dimension
        if q != 2:
            # In space few neighborhoods of so few points are rigid.
            return None
        seeds = [tuple(sorted(points_of(constraint))) for constraint in self._problem.constraints]
        is_over = self._is_over
        chosen = covering_patches(self._measured, self._pairs, seeds, PATCH_POINTS, is_over)
        n_unsolved = int(is_over())
        if max(map(len, chosen), default=0) <= q + 1 and not n_unsolved:
            return None
        patches = list(self._solved(chosen, None, MOST_PATCH_BOXES))
        n_unsolved += len(chosen) - len(patches)
        known, empty = self._narrowed(patches)
        bodies = self._bodies(patches)
        while empty is None and not self._is_over():
            new = list(self._further(known, patches, bodies))
            if not new:
                break
            patches += new
            bodies = self._bodies(patches)
            known, empty = self._narrowed(patches)
        if empty is not None:
            return SolvedPatches([empty], known)
        return SolvedPatches(patches, known, self._hold_together(bodies), n_unsolved)

    def _solved(
        self,
        chosen: Sequence[Points],
        known: KnownPairs | None,
        most_boxes: int,
        all_or_nothing: bool = False,
    ) -> Iterator[Patch]:
        """Solve patches within what is known of their pairs, while there is time."""
        parts = (replace(self._part(p, known), all_or_nothing=all_or_nothing) for p in chosen)
        solved = solve_subproblems(parts, self._budget, most_boxes, self._is_over)
        for points, found in zip(chosen, solved, strict=False):
            pending = {box[: UPPER + 1].tobytes() for box in found.cover.pending}
            yield Patch(points, list(found.hypotheses), pending)

    def _part(self, points: Points, known: KnownPairs | None) -> Subproblem:
        """Return the problem of a patch, within what is known of its pairs."""
        bounds = known.among(points) if known else None
        problem = restricted(self._problem, points, bounds)
        within = restricted_boxes(self._within, points)
        return Subproblem(problem, within)

    def _narrowed(self, patches: Sequence[Patch]) -> tuple[KnownPairs, Patch | None]:
        """Return the pairs of all patches, and a patch that is left without a hypothesis."""
        known = KnownPairs(self._problem, self._pairs, patches)
        while True:
            number = known.narrow()
            if number is not None:
                patches[number].left[:] = False
                return known, patches[number]
            ambiguities = Ambiguities(patches, known, self._is_over)
            if self._is_over() or not ambiguities.drop_unmatched():
                return known, None

    def _bodies(self, patches: Sequence[Patch]) -> list[set[int]]:
        """Return what the patches make together, the largest first."""
        return bodies_of([patch.points for patch in patches], self._problem.dimension)

    def _further(
        self, known: KnownPairs, patches: Sequence[Patch], bodies: Sequence[set[int]]
    ) -> Iterator[Patch]:
        """Yield patches across the seams between bodies, and about what is open."""
        q = self._problem.dimension
        graph = Neighborhoods(self._problem.n_points, map(tuple, known.pairs.tolist()), q)
        is_open = not self._hold_together(bodies) and not self._is_over()
        seams = seam_patches(graph, bodies, q, self._is_over) if is_open else []
        reviews = [
            self._review(patch, graph)
            for patch in patches
            if self._is_reviewed and patch.left.sum() > 1 and not self._is_over()
        ]
        for chosen, most in ((seams, MOST_SEAM_BOXES), (reviews, MOST_REVIEW_BOXES)):
            new = [points for points in dict.fromkeys(chosen) if points not in self._tried]
            self._tried.update(new)
            solved = self._solved([*filter(None, new)], known, most, all_or_nothing=True)
            # One that takes many boxes is worth nothing, and nothing depends on it.
            yield from (patch for patch in solved if not patch.pending)

    def _hold_together(self, bodies: Sequence[set[int]]) -> bool:
        """Return whether one body has all points."""
        return bool(bodies) and len(bodies[0]) == self._problem.n_points

    def _review(self, patch: Patch, graph: Neighborhoods) -> Points:
        """Return a patch and all that its most open point measures, or nothing."""
        lengths = np.array([np.sqrt(h.lower) + np.sqrt(h.upper) for h in patch.remaining()])
        # Its distances differ most between the hypotheses of the patch.
        point = patch.points[int(np.argmax(np.ptp(lengths, axis=0).sum(axis=0)))]
        seed = self._measured.neighbors[point].union(patch.points)
        if not len(patch.points) < len(seed) <= REVIEW_POINTS:
            return ()
        return graph.rigid_part(graph.grown(seed, REVIEW_POINTS), patch.points)
