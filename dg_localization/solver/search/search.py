# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a problem to a cover: branch and prune, then tightening of the boxes that are kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat
import os

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.contract.status import Status
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Budget, Cover, branch_and_prune
from dg_localization.solver.search.pruning import Pruner
from dg_localization.solver.search.splitting import split
from dg_localization.solver.search.tightening import tighten

POINTS_PER_WORKER = 32
"""From this many points on several boxes are examined at a time: below, threads do not pay."""


def search(
    problem: Problem,
    options: SolverOptions,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
    within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
    at_once: int | None = None,
    at_gaps: bool = False,
) -> tuple[Cover, Statistics]:
    """
    Cover all placements of a problem by boxes.

    Parameters
    ----------
    problem : Problem
        The problem.
    options : SolverOptions
        Resolution and limits.
    cancel : object with ``is_set()``, optional
        Stops the search when set, as a limit would.
    progress : callable, optional
        Called with the statistics so far, once a box.
    within : sequence of (ndarray, ndarray), shapes (n, n), optional
        Lower and upper bounds, in m^2, of the boxes to search in; None for everywhere.
    at_once : int, optional
        How many boxes to examine at a time; as many as there are processors without it, where
        the boxes are large. The cover depends on it.
    at_gaps : bool, optional
        Whether boxes are split at gaps only; one without a gap is finished then.

    Returns
    -------
    cover : Cover
        Kept and pending boxes, which together hold every placement.
    statistics : Statistics
        The effort.

    """
    budget = Budget(options, cancel)
    if _is_convex(problem):
        cover = _cover_by_triangles(problem, within, budget, progress)
        return cover, budget.statistics(cover, len(cover.pending))
    pruners = [Pruner(problem, options) for _ in range(at_once or _n_workers(problem))]
    whole = pruners[0].whole()
    if whole is None:
        cover = Cover(empty=1)
    else:
        starts = [whole] if within is None else _common_parts(whole, within)
        cover = _cover(starts, pruners, options.resolution, at_gaps, budget, progress)
    if not cover.pending and options.tighten_slices:
        _tighten_kept(cover, pruners[0], options.tighten_slices, budget)
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
    return branch_and_prune(
        starts, lambda boxes: map(smoothed, boxes), lambda _: [], budget, 1, progress
    )


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


def _n_workers(problem: Problem) -> int:
    """Return how many boxes to examine at a time; threads do not pay for small ones."""
    if problem.n_points < POINTS_PER_WORKER:
        return 1
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else 1


def _cover(
    starts: list[FloatArray],
    pruners: list[Pruner],
    resolution_m: float,
    at_gaps: bool,
    budget: Budget,
    progress: Callable[[Statistics], None] | None,
) -> Cover:
    """Cover the placements in some boxes, as many boxes at a time as there are pruners."""

    def split_further(pruned: Pruned) -> list[FloatArray]:
        return split(pruned, resolution_m, at_gaps)

    def prune_here(boxes: list[FloatArray]) -> list[Pruned]:
        return [pruners[0].prune(box, budget.stopped) for box in boxes]

    if len(pruners) == 1:
        return branch_and_prune(starts, prune_here, split_further, budget, 1, progress)
    with ThreadPoolExecutor(len(pruners)) as pool:

        def prune_in_threads(boxes: list[FloatArray]) -> list[Pruned]:
            if len(boxes) == 1:
                # Handing over the only box would take as long as some boxes do.
                return prune_here(boxes)
            return list(pool.map(Pruner.prune, pruners, boxes, repeat(budget.stopped)))

        at_once = len(pruners)
        return branch_and_prune(starts, prune_in_threads, split_further, budget, at_once, progress)


def _tighten_kept(cover: Cover, pruner: Pruner, slices: int, budget: Budget) -> None:
    """Tighten the boxes that were kept; one that turns out to be empty is dropped."""
    tightened = [tighten(pruner, box, slices, budget.tightening_stopped) for box in cover.kept]
    left = [box for box in tightened if box is not None]
    cover.empty += len(cover.kept) - len(left)
    cover.kept = left
