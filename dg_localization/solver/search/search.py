# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a problem to a cover: branch and prune, then tightening of the boxes that are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.contract.status import Status
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Budget, Cover, pave
from dg_localization.solver.search.pruning import Pruner
from dg_localization.solver.search.splitting import split
from dg_localization.solver.search.tightening import tighten


def search(
    problem: Problem,
    options: SolverOptions,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
    within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
    at_gaps: bool = False,
) -> tuple[Cover, Statistics]:
    """Cover all placements of a problem by boxes."""
    budget = Budget(options, cancel)
    if _is_convex(problem):
        cover = _cover_by_triangles(problem, within, budget, progress)
        return cover, budget.statistics(cover, len(cover.pending))
    pruner = Pruner(problem, options)
    whole = pruner.whole()
    if whole is None:
        cover = Cover(empty=1)
    else:
        starts = [whole] if within is None else _common_parts(whole, within)
        cover = pave(
            starts,
            lambda box: pruner.prune(box, budget.stopped),
            lambda pruned: split(pruned, options.resolution, at_gaps),
            budget,
            progress,
        )
    if not cover.pending:
        _tighten_kept(cover, pruner, budget)
    return cover, budget.statistics(cover, len(cover.pending))


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
    progress: Callable[[Statistics], None] | None,
) -> Cover:
    """Cover the placements of a convex problem by a box, or by one in each of some boxes."""

    def smoothed(box: FloatArray) -> Pruned:
        is_left = smooth_triangles(box, np.empty_like(box), np.arange(problem.n_points))
        status = Status.CONTRACTED if is_left else Status.EMPTY
        return Pruned(status, box, np.zeros(box.shape[1:]))

    whole = np.array([problem.lower, problem.upper, *np.zeros((2, *problem.lower.shape))])
    if smoothed(whole).status is Status.EMPTY:
        return Cover(empty=1)
    starts = [whole] if within is None else _common_parts(whole, within)
    return pave(starts, smoothed, lambda _: [], budget, progress)


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


def _tighten_kept(cover: Cover, pruner: Pruner, budget: Budget) -> None:
    """Tighten the boxes that were kept; one that turns out to be empty is dropped."""
    tightened = [tighten(pruner, box, budget.tightening_stopped) for box in cover.kept]
    left = [box for box in tightened if box is not None]
    cover.empty += len(cover.kept) - len(left)
    cover.kept = left
