# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a problem to a cover: branch and prune, then tightening of the boxes that are kept."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray, Status
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Paving, Pruner, pave, split
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.tightening import tighten


def search(
    problem: Problem,
    budget: Budget,
    within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
    at_gaps: bool = False,
    all_or_nothing: bool = False,
) -> Paving:
    """Cover all placements of a problem by boxes."""
    if _is_convex(problem):
        return _cover_by_triangles(problem, within, budget)
    resolution_m = budget.options.resolution
    pruner = Pruner(problem, resolution_m)
    whole = pruner.whole()
    if whole is None:
        return Paving(empty=1)
    cover = pave(
        [whole] if within is None else _common_parts(whole, within),
        lambda box: pruner.prune(box, budget.is_over),
        lambda pruned: split(pruned, resolution_m, at_gaps),
        budget,
        all_or_nothing,
    )
    if not cover.pending:
        tightened = [tighten(pruner, box, budget.leaves_wide) for box in cover.kept]
        left = [box for box in tightened if box is not None]
        cover.empty += len(cover.kept) - len(left)
        cover.kept = left
    return cover


def search_share(
    problem: Problem,
    budget: Budget,
    share: float,
    within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
    most_boxes: int | None = None,
    at_gaps: bool = False,
) -> Paving:
    """Cover the placements of a part of a problem with a share of what is left of a budget."""
    part = budget.part(share, most_boxes)
    cover = search(problem, part, within, at_gaps)
    budget.spend(cover.statistics(len(cover.pending), part.seconds()))
    return cover


def search_in_one_box(problem: Problem, budget: Budget, share: float = 1.0) -> Paving:
    """Cover a problem by one box; else all is pending and counts nothing."""
    part = budget.part(share, 1, is_silent=True)
    cover = search(problem, part)
    if not cover.pending:
        budget.spend(cover.statistics(0, part.seconds()))
        budget.report(Statistics())
    return cover


def accept_pending(cover: Paving, budget: Budget) -> None:
    """Keep the boxes which a search left pending as they are, if there are enough left."""
    n_pending = len(cover.pending)
    if budget.keep(n_pending):
        budget.take_back(n_pending)
        cover.kept, cover.pending = cover.kept + cover.pending, []


def _is_convex(problem: Problem) -> bool:
    """
    Return whether the distances of the placements in any box are a convex set.

    Those of three points obey the triangle inequalities and nothing else, in the plane and in
    space. These give the hull of the set, and parts of it would be parts of one hypothesis. One
    chirality only chooses between mirror images; two may leave flat triangles alone.
    """
    most_points = 2 if problem.dimension == 1 else 3
    return problem.n_points <= most_points and len(problem.chiralities) < 2


def _cover_by_triangles(
    problem: Problem,
    within: Sequence[tuple[FloatArray, FloatArray]] | None,
    budget: Budget,
) -> Paving:
    """Cover the placements of a convex problem by a box, or by one in each of some boxes."""

    def smoothed(box: FloatArray) -> Pruned:
        is_left = smooth_triangles(box, np.empty_like(box), np.arange(problem.n_points))
        status = Status.CONTRACTED if is_left else Status.EMPTY
        return Pruned(status, box, np.zeros(box.shape[1:]))

    whole = np.array([problem.lower, problem.upper, *np.zeros((2, *problem.lower.shape))])
    if smoothed(whole).status is Status.EMPTY:
        return Paving(empty=1)
    starts = [whole] if within is None else _common_parts(whole, within)
    return pave(starts, smoothed, lambda _: [], budget)


def _common_parts(
    whole: FloatArray, within: Sequence[tuple[FloatArray, FloatArray]]
) -> list[FloatArray]:
    """Return what a box has in common with others."""
    parts = []
    for lower, upper in within:
        part = whole.copy()
        part[LOWER] = np.maximum(whole[LOWER], lower)
        part[UPPER] = np.minimum(whole[UPPER], upper)
        if (part[LOWER] <= part[UPPER]).all():
            parts.append(part)
    return parts
