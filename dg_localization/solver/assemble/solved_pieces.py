# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What became of the pieces of a fleet, and what they say of pairs that nobody measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
import math

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds, Ranges, restricted_boxes
from dg_localization.solver.decompose.graph import Pair, Points
from dg_localization.solver.patches.answers import ChainedHypothesis
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.patches.solver import SolvedPatches
from dg_localization.solver.place.unplaced_hypotheses import Placement
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis, Joint


@dataclass
class SolvedPiece:
    """A piece, and the hypotheses that hold all its placements."""

    points: Points
    hypotheses: list[Hypothesis]
    pending: set[bytes]  # the bounds of the boxes among theirs that were not examined
    in_patches: list[SolvedPatches] = field(default_factory=list)  # where they are the answer
    was_examined: bool = True  # False where there was no time for any of it

    def hull(self, left: Iterable[int] | None = None) -> Bounds:
        """Return bounds that hold some of its hypotheses, all without any named."""
        numbers = range(len(self.hypotheses)) if left is None else left
        chosen = [self.hypotheses[x] for x in numbers]
        lower = np.min([h.lower for h in chosen], axis=0)
        return lower, np.max([h.upper for h in chosen], axis=0)

    def among(self, points: Points, hypothesis: int | None = None) -> tuple[Points, Bounds]:
        """Return its points among some, and their bounds in one of its hypotheses or all."""
        members = tuple(point for point in self.points if point in points)
        rows = [self.points.index(point) for point in members]
        chosen = self.hypotheses if hypothesis is None else [self.hypotheses[hypothesis]]
        ends = [h.bounds_among(rows) for h in chosen]
        lower = np.min([low for low, _ in ends], axis=0)
        return members, (lower, np.max([high for _, high in ends], axis=0))

    @property
    def is_finished(self) -> bool:
        """Whether nothing was left that was not examined."""
        return (
            self.was_examined
            and not self.pending
            and not any(solved.n_pending() for solved in self.in_patches)
        )

    def n_boxes(self, left: Iterable[int]) -> tuple[int, int]:
        """Return how many boxes some of its hypotheses have, and how many were not examined."""
        if not self.was_examined:
            return 1, 1
        if self.in_patches:
            # Another choice of what the piece is given may have been searched as a whole.
            n_pending = len(self.pending) + sum(solved.n_pending() for solved in self.in_patches)
            n_left = len(self.pending) + sum(solved.n_boxes() for solved in self.in_patches)
            return n_left, n_pending
        boxes = [box for x in left for box in self.hypotheses[x].boxes]
        if not self.pending:
            return len(boxes), 0
        return len(boxes), sum(box.tobytes() in self.pending for box in boxes)


@dataclass
class SolvedPieces:
    """All pieces and joints, or the one piece that cannot exist."""

    pieces: list[SolvedPiece] = field(default_factory=list)
    joints: list[Joint] = field(default_factory=list)
    contradiction: Points | None = None  # these points; the lists are not complete then


def unexamined(problem: Problem, points: Points, within: Sequence[Bounds] | None) -> SolvedPiece:
    """
    Return some points as one piece that was not examined, in the time that its measurements take.

    Its one hypothesis holds all placements: chains of known pairs bound them. Nothing shows that
    the points are rigid together, so it is flexible.
    """
    known = problem.pairs.restricted(points)
    chains = ChainGraph(len(points), known.pairs, known.lower, known.upper)
    boxes = within and restricted_boxes(within, points)
    hypothesis = ChainedHypothesis(chains, len(points), boxes, _nowhere, flexible=True)
    return SolvedPiece(points, [hypothesis], set(), was_examined=False)


def _nowhere() -> Placement:
    """Return that no placement was sought."""
    return None, False


def ranges_of(
    points: Points, hypotheses: Sequence[Hypothesis], pairs: Sequence[Pair]
) -> list[Ranges]:
    """Return what the hypotheses of a piece say of some pairs, in ranges that do not touch."""
    found: list[Ranges] = []
    for hypothesis in hypotheses:
        new: Ranges = {
            pair: hypothesis.bounds_of_pair(*(points.index(point) for point in pair))
            for pair in pairs
        }
        while touching := [ranges for ranges in found if _touch(ranges, new)]:
            found = [ranges for ranges in found if ranges not in touching]
            new = hull_of_ranges([new, *touching])
        found.append(new)
    return found


def _touch(first: Ranges, second: Ranges) -> bool:
    """Tell whether two sets of ranges of the same pairs have a point in common."""
    return all(
        low <= second[pair][1] and second[pair][0] <= high for pair, (low, high) in first.items()
    )


def common_ranges(ranges: Iterable[Ranges]) -> Ranges:
    """Return what several ranges, each of some pairs, have in common."""
    common: dict[Pair, tuple[float, float]] = {}
    for pair, (low, high) in (item for given in ranges for item in given.items()):
        least, most = common.get(pair, (0.0, math.inf))
        common[pair] = max(low, least), min(high, most)
    return common


def hull_of_ranges(ranges: list[Ranges]) -> Ranges:
    """Return the smallest ranges that hold several."""
    return {
        pair: (min(r[pair][0] for r in ranges), max(r[pair][1] for r in ranges))
        for pair in ranges[0]
    }
