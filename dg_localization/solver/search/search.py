# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From a problem to a cover: branch and prune (Section 4), then tightening of the kept boxes.

Combinations of pieces are contracted once, without a split.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import math

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.interval.pave import LEAST_GAIN, Examined, Paving, pave
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status, cut_at
from dg_localization.solver.contract.fixed_point import MOST_IDLE_TESTS, Contractor, Pruned
from dg_localization.solver.contract.linear import EXPLAINED_FACTOR
from dg_localization.solver.contract.triangles import smooth
from dg_localization.solver.contract.widths import excess
from dg_localization.solver.pair_bounds import pairs_among
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.subproblem import (
    MOST_CONTRACTED,
    MOST_DENSE,
    Bounds,
    as_box,
    parts_within,
)

WELL_EXPLAINED = 0.01
"""An interval this close, relatively, to the first-order effect of the errors is not tightened."""

CLOSED_WIDTH = 1.05
"""A pair is finished below this ratio of its width to the width its linear program explains."""


def _unexplained_pairs(problem: Problem, pruned: Pruned) -> IntArray:
    """
    Return the unknown pairs whose width the errors do not explain, widest first.

    To first order the explained width is the width of the exact hull. A narrower interval, like a
    wider one, shows that effects of higher order matter.
    """
    known = np.isinf(problem.upper) & (pruned.explained > 0.0)
    width = pruned.box[UPPER] - pruned.box[LOWER]
    ratios = np.divide(width, pruned.explained, out=np.ones_like(width), where=known)
    pairs = np.argwhere(np.triu(np.abs(ratios - 1.0) > WELL_EXPLAINED))
    return pairs[np.argsort(-ratios[tuple(pairs.T)], kind='stable')]


def tighten(
    contractor: Contractor, box: FloatArray, stopped: Callable[[], bool]
) -> FloatArray | None:
    """Return a finished box narrowed by linear programs; None if they prove it empty."""
    if stopped():
        return box
    # Contraction also returns the widths that the errors explain.
    pruned = contractor.contract(box, stopped)
    if pruned.status is Status.EMPTY:
        return None
    pairs = _unexplained_pairs(contractor.problem, pruned)
    if pruned.status is Status.UNFINISHED or not len(pairs):
        return pruned.box
    return pruned.box if _narrow_in_frames(contractor, pruned.box, pairs, stopped) else None


def _narrow_in_frames(
    contractor: Contractor, box: FloatArray, pairs: IntArray, stopped: Callable[[], bool]
) -> bool:
    """Narrow pairs of a box in frames at the least explained of them; return False if empty."""
    positions = place_problem(contractor.problem, box)
    rows, columns = pairs.T
    width_m2 = box[UPPER, rows, columns] - box[LOWER, rows, columns]
    explained, was_axis = np.zeros(len(pairs)), np.zeros(len(pairs), dtype=np.bool_)
    n_idle = 0
    with until(stopped):
        while n_idle < MOST_IDLE_TESTS and not stopped():
            ratios = np.full(len(pairs), np.inf)
            np.divide(width_m2, explained, out=ratios, where=explained > 0.0)
            is_open = ratios > CLOSED_WIDTH
            candidates = np.flatnonzero(is_open & ~was_axis)
            if not len(candidates):
                break
            axis = candidates[np.lexsort((width_m2[candidates], ratios[candidates]))[-1]]
            was_axis[axis] = True
            others = np.flatnonzero(is_open & np.isin(pairs, pairs[axis]).any(axis=1))
            chosen = np.concatenate([[axis], others[others != axis]])
            found = np.zeros(len(chosen))
            if not contractor.narrow_in_frame(box, positions, pairs[chosen], found):
                return False
            known = np.where(explained[chosen] > 0.0, explained[chosen], np.inf)
            explained[chosen] = np.where(found > 0.0, np.minimum(known, found), explained[chosen])
            before, gains = width_m2[chosen], np.zeros(len(chosen))
            width_m2 = box[UPPER, rows, columns] - box[LOWER, rows, columns]
            np.divide(before - width_m2[chosen], before, out=gains, where=before > 0.0)
            n_idle = n_idle + 1 if gains.max() < LEAST_GAIN else 0
    return True


def split(pruned: Pruned, resolution_m: float, at_gaps: bool = False) -> list[FloatArray]:
    """
    Split a contracted box at a gap, else where it is too wide; return nothing if it is finished.

    Of several gaps it takes the one that leaves the least of its interval: both parts are then
    known well, and contraction decides about them. The widest gaps belong to far points, which are
    badly known yet.
    """
    box = pruned.box
    i, j = pairs_among(box.shape[1])
    low, high, gap_low, gap_high = box[:, i, j]
    width_m, gap_m = np.sqrt(high) - np.sqrt(low), np.sqrt(gap_high) - np.sqrt(gap_low)
    if np.max(width_m, where=high < np.inf, initial=0.0) <= resolution_m:
        return []
    gaps = np.flatnonzero(gap_m > 0.0)
    if len(gaps):
        x = gaps[np.argmin(width_m[gaps] - gap_m[gaps])]
        return cut_at(box, (i[x], j[x]), gap_low[x], gap_high[x])
    is_wide = excess(box, pruned.explained, EXPLAINED_FACTOR, resolution_m)[i, j] > 1.0
    if at_gaps or not is_wide.any():
        return []
    x = np.argmax(np.where(is_wide, high - low, 0.0))
    # Halves of the squared distance separated better than halves of the distance.
    middle = 0.5 * low[x] + 0.5 * high[x]
    return cut_at(box, (i[x], j[x]), middle, middle)


def search(
    problem: Problem,
    budget: Budget,
    within: Sequence[Bounds] | None = None,
    at_gaps: bool = False,
    all_or_nothing: bool = False,
) -> Paving[FloatArray]:
    """
    Cover all placements of a problem by boxes, the widest examined first.

    So an early stop leaves an even cover. With `all_or_nothing`, the search ends as soon as it has
    more boxes than it may examine.
    """
    resolution_m, most = budget.options.resolution, budget.options.max_boxes
    contractor = Contractor(problem, resolution_m)
    whole = contractor.whole()
    if whole is None:
        return Paving(empty=1)

    def examine(box: FloatArray) -> Examined[FloatArray]:
        pruned = contractor.contract(box, budget.is_over)
        if pruned.status is Status.UNFINISHED:
            return Examined(rest=[pruned.box])
        if pruned.status is Status.EMPTY:
            return Examined()
        parts = [] if contractor.is_convex else split(pruned, resolution_m, at_gaps)
        return Examined(parts=parts) if parts else Examined(kept=[pruned.box])

    def watch(cover: Paving[FloatArray], n_waiting: int) -> bool:
        if budget.progress and cover.processed:
            budget.progress(effort(cover, n_waiting, budget.seconds()))
        if all_or_nothing and cover.processed + n_waiting > most:
            return False
        return cover.processed < most and not budget.is_over()

    boxes = [as_box(part) for part in parts_within([(whole[LOWER], whole[UPPER])], within)]
    cover = pave(boxes, examine, watch, lambda box: -_size_m(box))
    if not cover.pending:
        tightened = [tighten(contractor, box, budget.leaves_wide) for box in cover.kept]
        left = [box for box in tightened if box is not None]
        cover.empty += len(cover.kept) - len(left)
        cover.kept = left
    return cover


def effort(cover: Paving[FloatArray], n_pending: int, seconds: float) -> Statistics:
    """Return the effort of a search so far."""
    n_kept = len(cover.kept)
    return Statistics(cover.processed, cover.empty, cover.split, n_kept, n_pending, seconds)


def _size_m(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    upper = box[UPPER]
    return float(np.sum(np.sqrt(upper) - np.sqrt(box[LOWER]), where=upper < math.inf))


def search_share(
    problem: Problem,
    budget: Budget,
    share: float,
    within: Sequence[Bounds] | None = None,
    most_boxes: int | None = None,
    at_gaps: bool = False,
) -> Paving[FloatArray]:
    """Cover the placements of a part of a problem with a share of the remaining budget."""
    part = budget.part(share, most_boxes)
    cover = search(problem, part, within, at_gaps)
    budget.spend(effort(cover, len(cover.pending), part.seconds()))
    return cover


def search_in_one_box(problem: Problem, budget: Budget, share: float = 1.0) -> Paving[FloatArray]:
    """Cover a problem by one box; if that fails, all is pending and costs nothing."""
    part = budget.part(share, 1, is_silent=True)
    cover = search(problem, part)
    if not cover.pending:
        budget.spend(effort(cover, 0, part.seconds()))
        budget.report(Statistics())
    return cover


def accept_pending(cover: Paving[FloatArray], budget: Budget) -> None:
    """Keep the pending boxes of a search unchanged, if enough boxes are left."""
    n_pending = len(cover.pending)
    if budget.keep(n_pending):
        budget.take_back(n_pending)
        cover.kept, cover.pending = cover.kept + cover.pending, []


def contracted(
    problem: Problem,
    budget: Budget,
    within: Sequence[Bounds] | None = None,
    is_tightened: bool = False,
) -> Bounds | None:
    """Contract a problem once, and tighten it if asked; None proves that it has no placement."""
    n_points = problem.n_points
    box = as_box((problem.lower, problem.upper))
    if n_points <= MOST_DENSE and not (n_points > MOST_CONTRACTED and budget.is_over()):
        if not smooth(box):
            return None
    if n_points <= MOST_CONTRACTED:
        contractor = Contractor(problem, budget.options.resolution, is_quick=True)
        pruned = contractor.contract(box, budget.is_over)
        if pruned.status is Status.EMPTY:
            return None
        left = tighten(contractor, pruned.box, budget.leaves_wide) if is_tightened else pruned.box
        # Sides may have bounded a pair, and so all pairs that chains connect through it.
        if left is None or not smooth(left):
            return None
        box = left
    return _common_hull(box, within)


def smoothed(problem: Problem, within: Sequence[Bounds] | None = None) -> Bounds | None:
    """Bound all pairs by chains of known ones; None proves that there is no placement."""
    box = as_box((problem.lower, problem.upper))
    return _common_hull(box, within) if smooth(box) else None


def _common_hull(box: FloatArray, within: Sequence[Bounds] | None) -> Bounds | None:
    """Return the hull of the intersections of a box with others; None if all are empty."""
    hull = box[LOWER].copy(), box[UPPER].copy()
    if within is None:
        return hull
    left = parts_within([hull], within)
    if not left:
        return None
    hull = np.min([low for low, _ in left], axis=0), np.max([high for _, high in left], axis=0)
    if box.shape[1] > MOST_DENSE:
        return hull
    box = as_box(hull)
    if not smooth(box):
        return None
    hull = box[LOWER].copy(), box[UPPER].copy()
    # The triangle inequalities may leave only space between the boxes.
    return hull if parts_within([hull], within) else None
