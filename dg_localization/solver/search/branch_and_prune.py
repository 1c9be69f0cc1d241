# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Branch and prune: boxes are contracted and split until all are examined (Section 4).

The steps that contract and split a box are arguments, so that all strategies share one loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
import heapq
from itertools import count
import math

import numpy as np

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


@dataclass
class Paving:
    """The kept boxes of a search, the pending ones, and its effort."""

    kept: list[FloatArray] = field(default_factory=list)
    pending: list[FloatArray] = field(default_factory=list)
    empty: int = 0
    split: int = 0

    @property
    def processed(self) -> int:
        """The number of examined boxes."""
        return self.empty + self.split + len(self.kept)

    def statistics(self, n_pending: int, seconds: float) -> Statistics:
        """Return the effort so far."""
        n_kept = len(self.kept)
        return Statistics(self.processed, self.empty, self.split, n_kept, n_pending, seconds)


class Queue:
    """Boxes to examine, the widest first, so that an early stop leaves an even cover."""

    def __init__(self) -> None:
        self._heap: list[tuple[float, int, FloatArray]] = []
        self._order = count()

    def __len__(self) -> int:
        return len(self._heap)

    def push(self, box: FloatArray) -> None:
        """Add a box."""
        heapq.heappush(self._heap, (-_size_m(box), next(self._order), box))

    def pop(self) -> FloatArray:
        """Take the next box."""
        return heapq.heappop(self._heap)[2]

    def boxes(self) -> list[FloatArray]:
        """Return all boxes in their order."""
        return [box for _, _, box in sorted(self._heap)]


def pave(
    boxes: Iterable[FloatArray],
    contract: Callable[[FloatArray], Pruned],
    split: Callable[[Pruned], list[FloatArray]],
    budget: Budget,
    all_or_nothing: bool = False,
) -> Paving:
    """
    Cover all placements in some boxes by smaller boxes; those kept and pending hold every one.

    `split` returns the parts of a contracted box, none if it is finished. With `all_or_nothing`,
    the search ends as soon as it has more boxes than it may examine.
    """
    most = budget.options.max_boxes
    cover, queue = Paving(), Queue()
    for box in boxes:
        queue.push(box)
    while queue and cover.processed < most and not budget.is_over():
        pruned = contract(queue.pop())
        if pruned.status is Status.UNFINISHED:
            queue.push(pruned.box)
            continue
        if pruned.status is Status.EMPTY:
            cover.empty += 1
        elif parts := split(pruned):
            cover.split += 1
            for part in parts:
                queue.push(part)
        else:
            cover.kept.append(pruned.box)
        if budget.progress:
            budget.progress(cover.statistics(len(queue), budget.seconds()))
        if all_or_nothing and cover.processed + len(queue) > most:
            break
    cover.pending = queue.boxes()
    return cover


def _size_m(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    upper = box[UPPER]
    return float(np.sum(np.sqrt(upper) - np.sqrt(box[LOWER]), where=upper < math.inf))
