# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Branch and prune on distances: boxes are contracted and split until all are examined (Section 4).

The steps that contract and split a box are arguments: strategies differ in these.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
import math

import numpy as np

from dg_localization.interval.pave import Examined, Paving, pave
from dg_localization.solver.box import (
    LOWER,
    UPPER,
    FloatArray,
    Status,
    cut_at,
)
from dg_localization.solver.contract.fixed_point import EXPLAINED_FACTOR, Pruned
from dg_localization.solver.contract.widths import excess
from dg_localization.solver.pair_bounds import pairs_among
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.budget import Budget


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


def branch_and_prune(
    boxes: Iterable[FloatArray],
    contract: Callable[[FloatArray], Pruned],
    split: Callable[[Pruned], list[FloatArray]],
    budget: Budget,
    all_or_nothing: bool = False,
) -> Paving[FloatArray]:
    """
    Cover all placements in some boxes by smaller boxes, the widest box first.

    So an early stop leaves an even cover. `split` returns the parts of a contracted box, none if
    it is finished. With `all_or_nothing`, the search ends as soon as it has more boxes than it may
    examine.
    """
    most = budget.options.max_boxes

    def examine(box: FloatArray) -> Examined[FloatArray]:
        pruned = contract(box)
        if pruned.status is Status.UNFINISHED:
            return Examined(rest=[pruned.box])
        if pruned.status is Status.EMPTY:
            return Examined()
        parts = split(pruned)
        return Examined(parts=parts) if parts else Examined(kept=[pruned.box])

    def watch(cover: Paving[FloatArray], n_waiting: int) -> bool:
        if budget.progress and cover.processed:
            budget.progress(effort(cover, n_waiting, budget.seconds()))
        if all_or_nothing and cover.processed + n_waiting > most:
            return False
        return cover.processed < most and not budget.is_over()

    return pave(boxes, examine, watch, lambda box: -_size_m(box))


def effort(cover: Paving[FloatArray], n_pending: int, seconds: float) -> Statistics:
    """Return the effort of a search so far."""
    n_kept = len(cover.kept)
    return Statistics(cover.processed, cover.empty, cover.split, n_kept, n_pending, seconds)


def _size_m(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    upper = box[UPPER]
    return float(np.sum(np.sqrt(upper) - np.sqrt(box[LOWER]), where=upper < math.inf))
