# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From a problem to a cover: branch and prune, then tightening of the kept boxes.

Combinations of pieces are contracted once, without a split.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.interval.pave import Paving
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status
from dg_localization.solver.contract.fixed_point import MOST_IDLE_TESTS, Contractor, Pruned
from dg_localization.solver.contract.triangles import smooth
from dg_localization.solver.contract.widths import LEAST_GAIN
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import branch_and_prune, effort, split
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


class _Frames:
    """The unexplained pairs of a box, and the widths that linear programs explained so far."""

    def __init__(self, box: FloatArray, pairs: IntArray) -> None:
        self._box = box
        self._pairs = pairs
        self._explained = np.zeros(len(pairs))
        self._was_axis = np.zeros(len(pairs), dtype=np.bool_)

    def next_frame(self) -> IntArray | None:
        """Return the indices of the pairs for the next frame, its axis first; None at the end."""
        width = self._widths()
        excess = np.full(len(width), np.inf)
        np.divide(width, self._explained, out=excess, where=self._explained > 0.0)
        is_open = excess > CLOSED_WIDTH
        candidates = np.flatnonzero(is_open & ~self._was_axis)
        if not len(candidates):
            return None
        axis = candidates[np.lexsort((width[candidates], excess[candidates]))[-1]]
        self._was_axis[axis] = True
        meets = np.isin(self._pairs, self._pairs[axis]).any(axis=1)
        others = np.flatnonzero(is_open & meets)
        return np.concatenate([[axis], others[others != axis]])

    def narrow(
        self, contractor: Contractor, positions: FloatArray, chosen: IntArray
    ) -> float | None:
        """Narrow some pairs; return the largest relative gain, or None if the box is empty."""
        before = self._widths()[chosen]
        explained = np.zeros(len(chosen))
        if not contractor.narrow_in_frame(self._box, positions, self._pairs[chosen], explained):
            return None
        known = self._explained[chosen]
        least = np.where(known > 0.0, np.minimum(known, explained), explained)
        self._explained[chosen] = np.where(explained > 0.0, least, known)
        gains = np.zeros(len(chosen))
        np.divide(before - self._widths()[chosen], before, out=gains, where=before > 0.0)
        return float(gains.max())

    def _widths(self) -> FloatArray:
        rows, columns = self._pairs.T
        return np.asarray(self._box[UPPER, rows, columns] - self._box[LOWER, rows, columns])


def _unexplained_pairs(problem: Problem, pruned: Pruned) -> IntArray:
    """
    Return the unknown pairs whose width the errors do not explain, widest first.

    To first order the explained width is the width of the exact hull. A narrower interval, like a
    wider one, shows that effects of higher order matter.
    """
    known = np.isinf(problem.upper) & (pruned.explained > 0.0)
    width = pruned.box[UPPER] - pruned.box[LOWER]
    excess = np.divide(width, pruned.explained, out=np.ones_like(width), where=known)
    pairs = np.argwhere(np.triu(np.abs(excess - 1.0) > WELL_EXPLAINED))
    return pairs[np.argsort(-excess[tuple(pairs.T)], kind='stable')]


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
    positions = place_problem(contractor.problem, pruned.box)
    frames = _Frames(pruned.box, pairs)
    n_idle = 0
    with until(stopped):
        while n_idle < MOST_IDLE_TESTS and not stopped():
            chosen = frames.next_frame()
            if chosen is None:
                break
            gain = frames.narrow(contractor, positions, chosen)
            if gain is None:
                return None
            n_idle = n_idle + 1 if gain < LEAST_GAIN else 0
    return pruned.box


def search(
    problem: Problem,
    budget: Budget,
    within: Sequence[Bounds] | None = None,
    at_gaps: bool = False,
    all_or_nothing: bool = False,
) -> Paving[FloatArray]:
    """Cover all placements of a problem by boxes."""
    resolution_m = budget.options.resolution
    contractor = Contractor(problem, resolution_m)
    whole = contractor.whole()
    if whole is None:
        return Paving(empty=1)
    cover = branch_and_prune(
        [as_box(part) for part in parts_within([(whole[LOWER], whole[UPPER])], within)],
        lambda box: contractor.contract(box, budget.is_over),
        lambda pruned: [] if contractor.is_convex else split(pruned, resolution_m, at_gaps),
        budget,
        all_or_nothing,
    )
    if not cover.pending:
        tightened = [tighten(contractor, box, budget.leaves_wide) for box in cover.kept]
        left = [box for box in tightened if box is not None]
        cover.empty += len(cover.kept) - len(left)
        cover.kept = left
    return cover


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
    return _common_hull((box[LOWER].copy(), box[UPPER].copy()), within)


def smoothed(problem: Problem, within: Sequence[Bounds] | None = None) -> Bounds | None:
    """Bound all pairs by chains of known ones; None proves that there is no placement."""
    bounds = _smoothed(problem.lower, problem.upper)
    return _common_hull(bounds, within) if bounds else None


def _common_hull(bounds: Bounds, within: Sequence[Bounds] | None) -> Bounds | None:
    """Return the hull of the intersections of bounds with boxes; None if all are empty."""
    if within is None:
        return bounds
    left = parts_within([bounds], within)
    if not left:
        return None
    lower = np.min([low for low, _ in left], axis=0)
    upper = np.max([high for _, high in left], axis=0)
    if len(lower) > MOST_DENSE:
        return lower, upper
    hull = _smoothed(lower, upper)
    # The triangle inequalities may leave only space between the boxes.
    return hull if hull and parts_within([hull], within) else None


def _smoothed(lower: FloatArray, upper: FloatArray) -> Bounds | None:
    """Return bounds that meet all triangle inequalities; None if no distances do."""
    box = as_box((lower, upper))
    return (box[LOWER].copy(), box[UPPER].copy()) if smooth(box) else None
