# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is answered of points that there was no time to examine."""

from __future__ import annotations

from collections.abc import Sequence

from dg_localization.solver.assemble.solved_pieces import SolvedPiece
from dg_localization.solver.assemble.subproblem import Bounds, restricted_boxes
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.patches.answers import ChainedHypothesis
from dg_localization.solver.patches.chains import ChainGraph
from dg_localization.solver.place.unplaced_hypotheses import Placement
from dg_localization.solver.problem import Problem


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
