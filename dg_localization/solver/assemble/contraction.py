# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One contraction, without a split, of several pieces together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.solver.assemble.subproblem import Bounds, as_box, parts_within
from dg_localization.solver.box import LOWER, UPPER, FloatArray, Status
from dg_localization.solver.contract.fixed_point import Contractor, Goal
from dg_localization.solver.contract.linear import groups_of
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.branch_and_prune import EXPLAINED_FACTOR, Pruner
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.tightening import tighten

MOST_CONTRACTED = 40
"""Up to this many points are contracted together."""

MOST_TOGETHER = 60
"""Up to this many points a piece is contracted as a whole: far pairs are bounded far better.
It takes seconds for more."""

MOST_WORK_TOGETHER = 100_000
"""Choices times the cube of the points, up to which all points are contracted for each choice, or
the box of each choice is split once: halves of larger boxes are hardly narrower."""

MOST_SWEEPS = 2
"""Later sweeps over all axes narrow hardly anything of what joints leave open."""

MOST_SMOOTHED = 300
"""Up to this many points chains of known distances bound those of their ends."""


def contracted(
    problem: Problem,
    budget: Budget,
    within: Sequence[Bounds] | None = None,
    is_tightened: bool = False,
) -> Bounds | None:
    """Contract a problem once, and tighten it if asked; None proves that it has no placement."""
    n_points, resolution_m = problem.n_points, budget.options.resolution
    box = as_box((problem.lower, problem.upper))
    if n_points <= MOST_SMOOTHED and not (n_points > MOST_CONTRACTED and budget.is_over()):
        if not _smooth(box):
            return None
    if n_points <= MOST_CONTRACTED:
        contractor = Contractor(problem)
        n_axes = max(1, len(contractor.axes))
        goal = Goal(resolution_m, EXPLAINED_FACTOR, MOST_SWEEPS, n_axes)
        groups = groups_of(problem.lower, problem.upper)
        pruned = contractor.contract(box, groups, goal, budget.is_over)
        if pruned.status is Status.EMPTY:
            return None
        box = pruned.box
        if is_tightened and not budget.leaves_wide():
            tightened = tighten(Pruner(problem, resolution_m), box, budget.leaves_wide)
            if tightened is None:
                return None
            box = tightened
        # Sides may have bounded a pair, and so all that chains lead to by it.
        if not _smooth(box):
            return None
    return _common_hull((box[LOWER].copy(), box[UPPER].copy()), within)


def smoothed(problem: Problem, within: Sequence[Bounds] | None = None) -> Bounds | None:
    """Bound all pairs by chains of known ones; None proves that there is no placement."""
    bounds = _smoothed(problem.lower, problem.upper)
    return _common_hull(bounds, within) if bounds else None


def _common_hull(bounds: Bounds, within: Sequence[Bounds] | None) -> Bounds | None:
    """Return the hull of what bounds have in common with boxes, None where they have nothing."""
    if within is None:
        return bounds
    left = parts_within([bounds], within)
    if not left:
        return None
    lower = np.min([low for low, _ in left], axis=0)
    upper = np.max([high for _, high in left], axis=0)
    if len(lower) > MOST_SMOOTHED:
        return lower, upper
    hull = _smoothed(lower, upper)
    # What is between several boxes may be all that the triangle inequalities leave.
    return hull if hull and parts_within([hull], within) else None


def _smoothed(lower: FloatArray, upper: FloatArray) -> Bounds | None:
    """Return bounds that meet all triangle inequalities, None where no distances do."""
    box = as_box((lower, upper))
    return (box[LOWER].copy(), box[UPPER].copy()) if _smooth(box) else None


def _smooth(box: FloatArray) -> bool:
    """Have a box meet all triangle inequalities, in place; return False where no distances do."""
    return bool(smooth_triangles(box, np.empty_like(box), np.arange(box.shape[1])))
