# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The solved pieces of a fleet, and their bounds of pairs that were not measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from dg_localization.solver.box import UPPER, FloatArray
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.decompose.rigid_components import joined_bodies
from dg_localization.solver.patches.answers import ChainedHypothesis
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.patches.solver import SolvedPatches
from dg_localization.solver.place.hypotheses import hypotheses_of
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis, Joint
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.subproblem import Bounds, Ranges, restricted_boxes


@dataclass
class Search:
    """One problem of a piece, for one choice of given ranges, and its cover so far."""

    problem: Problem
    kept: list[FloatArray]
    pending: list[FloatArray]
    found: Sequence[Hypothesis] | None = None  # hypotheses of the cover, once gathered
    patches: SolvedPatches | None = None  # set if patches are the answer instead of a cover

    def gather(self, budget: Budget) -> Sequence[Hypothesis]:
        """Return the hypotheses of the cover."""
        if self.found is None:
            self.found = hypotheses_of(self.problem, self.kept, self.pending, budget.new_clock)
        return self.found


@dataclass(eq=False)
class SolvedPiece:
    """A piece with the hypotheses that hold all its placements."""

    points: Points
    searches: list[Search] = field(default_factory=list)
    hypotheses: list[Hypothesis] = field(default_factory=list)
    was_examined: bool = True  # False if there was no time for it

    def gather(self, budget: Budget) -> None:
        """Write the hypotheses of the covers of all searches."""
        self.hypotheses = [h for search in self.searches for h in search.gather(budget)]

    def hull(self, left: Iterable[int]) -> Bounds:
        """Return the hull of some of its hypotheses."""
        chosen = [self.hypotheses[x] for x in left]
        lower = np.min([h.lower for h in chosen], axis=0)
        return lower, np.max([h.upper for h in chosen], axis=0)

    def among(self, points: Points, hypothesis: int | None = None) -> tuple[Points, Bounds]:
        """Return its points among given ones, with their bounds in one or all hypotheses."""
        members = tuple(point for point in self.points if point in points)
        rows = [self.points.index(point) for point in members]
        if hypothesis is not None:
            return members, self.hypotheses[hypothesis].bounds_among(rows)
        ends = [h.bounds_among(rows) for h in self.hypotheses]
        lower = np.min([low for low, _ in ends], axis=0)
        return members, (lower, np.max([high for _, high in ends], axis=0))

    @property
    def is_finished(self) -> bool:
        """Whether every box was examined."""
        return self.was_examined and self.n_boxes(range(len(self.hypotheses)))[1] == 0

    def n_boxes(self, left: Iterable[int]) -> tuple[int, int]:
        """Return the number of boxes of some hypotheses, and of those not examined."""
        if not self.was_examined:
            return 1, 1
        # The bounds of the boxes that were not examined.
        keys = {box[: UPPER + 1].tobytes() for search in self.searches for box in search.pending}
        in_patches = [search.patches for search in self.searches if search.patches]
        if in_patches:
            # Another choice of given ranges may have been searched as a whole.
            n_pending = len(keys) + sum(solved.n_pending() for solved in in_patches)
            return len(keys) + sum(solved.n_boxes() for solved in in_patches), n_pending
        boxes = [box for x in left for box in self.hypotheses[x].boxes]
        return len(boxes), sum(box.tobytes() in keys for box in boxes) if keys else 0

    def ranges_of(self, pairs: Sequence[Pair]) -> list[Ranges]:
        """Return the ranges of some pairs in its hypotheses, merged until they do not touch."""
        found: list[Ranges] = []
        for hypothesis in self.hypotheses:
            ends = {pair: tuple(map(self.points.index, pair)) for pair in pairs}
            new: Ranges = {pair: hypothesis.bounds_of_pair(*x) for pair, x in ends.items()}
            while touching := [r for r in found if _touch(r, new)]:
                found = [ranges for ranges in found if ranges not in touching]
                new = hull_of_ranges([new, *touching])
            found.append(new)
        return found

    def widest(self, pair: Pair) -> float:
        """Return the greatest width of a pair in a hypothesis, in m^2."""
        ends = tuple(map(self.points.index, pair))
        bounds = (hypothesis.bounds_of_pair(*ends) for hypothesis in self.hypotheses)
        return max(high - low for low, high in bounds)


@dataclass
class SolvedPieces:
    """All pieces and joints, or the one piece without a placement."""

    pieces: list[SolvedPiece] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    contradiction: Points | None = None  # these points; the lists are not complete then

    def n_groups(self) -> int:
        """Return the number of groups of pieces that joints connect."""
        alone = ((number,) for number in range(len(self.pieces)))
        return len(joined_bodies([*alone, *(joint.pieces for joint in self.joints)], 1))


def unexamined(problem: Problem, points: Points, within: Sequence[Bounds] | None) -> SolvedPiece:
    """
    Return points as one unexamined piece, in time proportional to the number of measurements.

    Its one hypothesis holds all placements: chains of known pairs bound them. It counts as
    flexible, since the points were not shown to be rigid together.
    """
    known = problem.pairs.restricted(points)
    chains = ChainGraph(len(points), known.pairs, known.lower, known.upper)
    boxes = restricted_boxes(within, points)
    hypothesis = ChainedHypothesis(chains, len(points), boxes)
    return SolvedPiece(points, [], [hypothesis], was_examined=False)


def _touch(first: Ranges, second: Ranges) -> bool:
    """Return whether two sets of ranges of the same pairs have a point in common."""
    return all(
        low <= second[pair][1] and second[pair][0] <= high for pair, (low, high) in first.items()
    )


def common_ranges(ranges: Iterable[Ranges]) -> Ranges:
    """Return the intersection of several ranges, each of some pairs."""
    common: dict[Pair, tuple[float, float]] = {}
    for pair, (low, high) in (item for given in ranges for item in given.items()):
        least, most = common.get(pair, (0.0, math.inf))
        common[pair] = max(low, least), min(high, most)
    return common


def hull_of_ranges(ranges: list[Ranges]) -> Ranges:
    """Return the hull of several ranges."""
    return {
        pair: (min(r[pair][0] for r in ranges), max(r[pair][1] for r in ranges))
        for pair in ranges[0]
    }
