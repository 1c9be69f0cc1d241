# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What became of the pieces of a fleet."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.decompose.joints import Joint
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.patches.solver import SolvedPatches
from dg_localization.solver.result import Hypothesis


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
