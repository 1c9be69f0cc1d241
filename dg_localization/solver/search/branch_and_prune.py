# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Branch and prune: boxes are contracted and split until none is left to examine (Section 4).

The steps that prune and split a box are arguments, so that every strategy shares one loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
import heapq
from itertools import count
import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import (
    GAP_LOWER,
    GAP_UPPER,
    LOWER,
    UPPER,
    FloatArray,
    IntArray,
    Status,
    cut_at,
    sub_box,
)
from dg_localization.solver.contract.fixed_point import LEAST_GAP, Contractor, Goal, Pruned
from dg_localization.solver.contract.linear import groups_of
from dg_localization.solver.contract.local_frames import contract_in_frame
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.triangles import smooth_triangles
from dg_localization.solver.contract.widths import excess
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.budget import Budget

MAX_SWEEPS = 50
"""Most sweeps over all axes."""


def _never() -> bool:
    """Return False: nothing stops the contraction."""
    return False


class Pruner:
    """Prunes the boxes of one problem, one at a time."""

    def __init__(self, problem: Problem, resolution_m: float) -> None:
        self.problem = problem
        self._groups = groups_of(problem.lower, problem.upper)
        self._contractor = Contractor(problem)
        n_axes = max(1, len(self._contractor.axes))
        small = problem.n_points <= SMALL_FLEET
        axes_per_test = n_axes if small else problem.n_points // 2
        self._goal = Goal(resolution_m, EXPLAINED_FACTOR, MAX_SWEEPS, axes_per_test)

    def whole(self) -> FloatArray | None:
        """Return the box of the problem itself, None where the triangles prove it to be empty."""
        n_points = self.problem.n_points
        box = np.zeros((4, n_points, n_points))
        box[LOWER] = self.problem.lower
        box[UPPER] = self.problem.upper
        left = smooth_triangles(box, np.empty_like(box), np.arange(n_points))
        return box if left else None

    def prune(self, box: FloatArray, stopped: Callable[[], bool] = _never) -> Pruned:
        """Contract a box."""
        return self._contractor.contract(box, self._groups, self._goal, stopped)

    def narrow_in_frame(
        self, box: FloatArray, positions: FloatArray, pairs: IntArray, explained: FloatArray
    ) -> bool:
        """
        Narrow unknown pairs of a finished box in place, in the frame of the first of them.

        See `contract_in_frame`; False when the box is proved to hold no placement.
        """
        offsets, members, edge_offsets, edges, errors = self._groups
        group = next(
            g for g in range(len(offsets)) if pairs[0, 0] in members[slice(*offsets[g : g + 2])]
        )
        points = members[offsets[group] : offsets[group + 1]]
        inside = slice(edge_offsets[group], edge_offsets[group + 1])
        local, of_points = sub_box(box, points), np.searchsorted(points, pairs)
        frame = positions[points], edges[inside], errors[inside], of_points, explained
        if not contract_in_frame(local, *frame):
            return False
        (i, j), (x, y) = pairs.T, of_points.T
        box[:, i, j] = box[:, j, i] = local[:, x, y]
        return True


EXPLAINED_FACTOR = 3.0
"""How much wider a finished box may be than the first-order effect of the measurement errors."""


@kernel(borrows=True)
def choose_split(
    box: FloatArray, explained: FloatArray, resolution_m: float
) -> tuple[int, int, float, float]:
    """
    Choose where to split a contracted box: at a gap, else where it is too wide.

    Of several gaps the one is taken that leaves the least of its interval: both parts are then
    known well, and contraction decides about them. The widest gaps are those of far points, about
    which little is known yet.
    """
    n_points = box.shape[1]
    gap_i, gap_j, least_left_m = -1, -1, math.inf
    i, j, widest_m2, widest_m = -1, -1, 0.0, 0.0
    for k in range(n_points):
        for other in range(k + 1, n_points):
            low, high = box[LOWER, k, other], box[UPPER, k, other]
            width_m = math.sqrt(high) - math.sqrt(low)
            if high < np.inf:
                widest_m = max(widest_m, width_m)
            gap_m = math.sqrt(box[GAP_UPPER, k, other]) - math.sqrt(box[GAP_LOWER, k, other])
            if gap_m > LEAST_GAP * resolution_m and (gap_i < 0 or width_m - gap_m < least_left_m):
                gap_i, gap_j, least_left_m = k, other, width_m - gap_m
            times = excess(box, explained, EXPLAINED_FACTOR, resolution_m, k, other)
            if times > 1.0 and high - low > widest_m2:
                i, j, widest_m2 = k, other, high - low
    if widest_m <= resolution_m:
        return -1, -1, 0.0, 0.0
    if gap_i >= 0:
        return gap_i, gap_j, box[GAP_LOWER, gap_i, gap_j], box[GAP_UPPER, gap_i, gap_j]
    if i < 0:
        return -1, -1, 0.0, 0.0
    # Halves of the squared distance separated better than halves of the distance.
    middle = 0.5 * box[LOWER, i, j] + 0.5 * box[UPPER, i, j]
    return i, j, middle, middle


def split(pruned: Pruned, resolution_m: float, at_gaps: bool = False) -> list[FloatArray]:
    """Split a contracted box."""
    box = pruned.box
    i, j, low_end, high_start = choose_split(box, pruned.explained, resolution_m)
    if at_gaps and low_end == high_start:
        return []
    return cut_at(box, (i, j), low_end, high_start) if i >= 0 else []


@dataclass
class Paving:
    """The boxes that a search kept, those it did not examine, and its effort."""

    kept: list[FloatArray] = field(default_factory=list)
    pending: list[FloatArray] = field(default_factory=list)
    empty: int = 0
    split: int = 0

    @property
    def processed(self) -> int:
        """The number of boxes that were examined to the end."""
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

    `split` returns the parts of a contracted box, none when it is finished. Where the cover is of
    no use unless it is complete, the search ends as soon as it has more boxes than it may examine.
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


@kernel(borrows=True)
def _size_m(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    n_points = box.shape[1]
    total = 0.0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if box[UPPER, i, j] < math.inf:
                total += math.sqrt(box[UPPER, i, j]) - math.sqrt(box[LOWER, i, j])
    return total
