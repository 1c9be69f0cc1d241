# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How a large piece is solved: its patches first, then what they leave open.

Up to `MOST_TOGETHER` points all pairs of the piece are contracted together afterwards, within
what its patches allow. Where the patches hold it together that is one step for each choice of
their hypotheses, else the ordinary search; where distances are wide, it splits at gaps alone. The
answer of a larger piece, and of one that leaves many choices, is that of its patches.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.solver.assemble.budget import CallBudget
from dg_localization.solver.assemble.contraction import MOST_TOGETHER, MOST_WORK_TOGETHER
from dg_localization.solver.assemble.solved_pieces import Search
from dg_localization.solver.assemble.subproblem import Bounds
from dg_localization.solver.patches.answers import PatchAnswers
from dg_localization.solver.patches.solver import PatchSolver
from dg_localization.solver.problem import Problem

MOST_UNREVIEWED = 30
"""Up to so many points a piece as a whole rules out as much as reviews of its patches, and sooner,
where distances are wide. Few choices of larger pieces are contracted."""

PATCHES_SHARE = 0.5
"""Patches may take this part of the time of a piece that is contracted afterwards,"""

PATCHES_SHARE_ALONE = 0.7
"""and this part where what follows is a placement."""

MOST_WORK = 1_000_000
"""Choices times the cube of the points, up to which each choice is contracted as a whole. Of more
choices, few would be in time; chains bound those better that are not."""

LARGEST_ERROR = 0.1
"""One box is tried first where half of the distances with an upper bound, measured or known from
anchors and earlier pieces, are known to this fraction of that bound. Others are hardly ever
covered by one box."""


def is_known_well(problem: Problem) -> bool:
    """Return whether distances are known so well that one box may cover all placements."""
    known = np.isfinite(problem.upper) & (problem.upper > 0.0)
    errors = 1.0 - np.sqrt(problem.lower[known] / problem.upper[known])
    return len(errors) > 0 and bool(np.median(errors) <= LARGEST_ERROR)


def solve_large(
    problem: Problem, budget: CallBudget, share: float, within: Sequence[Bounds] | None
) -> Search | None:
    """Solve a large piece in patches; return None where its neighborhoods are not rigid."""
    is_whole = problem.n_points <= MOST_TOGETHER
    share_of_patches = (PATCHES_SHARE if is_whole else PATCHES_SHARE_ALONE) * share
    is_reviewed = problem.n_points > MOST_UNREVIEWED or is_known_well(problem)
    # The hypotheses of a piece that is contracted as a whole are placed, and not its patches.
    is_placed = not is_whole
    solved = PatchSolver(problem, budget, share_of_patches, within, is_reviewed, is_placed).run()
    if solved is None:
        return None
    if solved.is_empty():
        return Search(problem, [], [])
    answers = PatchAnswers(problem, solved, within, budget.is_over)
    most = budget.options.max_hypotheses
    if not is_whole:
        return Search(problem, [], [], answers.hypotheses(most), solved)
    boxes = answers.boxes(most)
    is_done = solved.is_one_body and solved.is_complete()
    if is_done and len(boxes) * problem.n_points**3 > MOST_WORK:
        return Search(problem, [], [], answers.hypotheses(most), solved)
    budget.go_on_from(solved.n_boxes() - solved.n_pending())
    if not is_done:
        # Halves of wide distances would be parts of the hypotheses that the patches tell apart.
        at_gaps = solved.is_complete() and not is_known_well(problem)
        cover = budget.search(problem, share, boxes, at_gaps=at_gaps)
        return Search(problem, cover.kept, cover.pending)
    is_split = len(boxes) * problem.n_points**3 <= MOST_WORK_TOGETHER
    most_boxes = 2 * len(boxes) if is_split else len(boxes)
    cover = budget.search(problem, PATCHES_SHARE * share, boxes, most_boxes)
    # The patches were examined to the end, and so is what they allow.
    budget.accept_pending(cover)
    return Search(problem, cover.kept, cover.pending)
