# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How a rigid piece in space is solved: grown point by point first, then contracted as a whole.

Growth finds what can come apart: one box for each choice of regions. Where points are held weakly
these boxes are wide, because many placements agree. Halves of such a box would hold parts of one
and the same hypothesis, and so it is split at gaps alone. Boxes of many points stay as they grew.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.solver.assemble.budget import CallBudget
from dg_localization.solver.assemble.subproblem import Bounds, common_parts
from dg_localization.solver.growth.partial_boxes import Growth
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.branch_and_prune import Cover

LEAST_GROWN, MOST_GROWN = 12, 200
"""A piece of fewer points is searched as a whole, and for more points each step takes too long."""

MOST_CONTRACTED = 60
"""Boxes of more points are kept as they grew: contracting them takes seconds and gains nothing."""

ONE_BOX_SHARE = 0.1
"""One box is tried first, in this part of the time: it is enough where points are held well."""

GROWTH_SHARE = 0.6
"""Growth may take this part of the time of a piece,"""

GROWTH_SHARE_ALONE = 0.85
"""and this part where what follows is a placement."""

BOXES_PER_START, LEAST_BOXES = 2, 6
"""Once all points are placed, so many boxes are looked at for each that grew, and at least
so many."""


def is_grown(n_points: int, dimension: int) -> bool:
    """Return whether a piece is solved point by point."""
    return dimension == 3 and LEAST_GROWN <= n_points <= MOST_GROWN


def solve_grown(
    problem: Problem, budget: CallBudget, share: float, within: Sequence[Bounds] | None
) -> Cover | None:
    """Solve a piece in space point by point; return None where there is nothing to begin with."""
    if not is_grown(problem.n_points, problem.dimension) or budget.boxes_left() < LEAST_BOXES:
        return None
    is_large = problem.n_points > MOST_CONTRACTED
    if within is None and not is_large:
        in_one_box = budget.search_in_one_box(problem, ONE_BOX_SHARE * share)
        if not in_one_box.pending:
            return in_one_box
    left_s = budget.seconds_left()
    growth_share = GROWTH_SHARE_ALONE if is_large else GROWTH_SHARE
    end_s = budget.seconds() + growth_share * share * left_s
    growth = Growth(
        problem,
        budget.options.resolution,
        lambda: budget.is_over() or budget.seconds() > end_s,
    )
    grown = growth.run()
    if grown is None:
        return None
    budget.count_split()
    boxes = [growth.bounds(partial) for partial in grown]
    if within is not None:
        boxes = common_parts(boxes, within)
    if any(len(partial.points) < problem.n_points for partial in grown):
        return budget.search(problem, share, boxes)
    if is_large and budget.keep(len(boxes)):
        return Cover(kept=[np.array([*bounds, *np.zeros_like(bounds)]) for bounds in boxes])
    most_boxes = max(BOXES_PER_START * len(boxes), LEAST_BOXES)
    cover = budget.search(problem, share, boxes, most_boxes, at_gaps=True)
    if cover.processed >= len(boxes):
        # Growth came to its end and examined everything; what follows makes its boxes narrower.
        budget.accept_pending(cover)
    return cover
