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
import time

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.contract.status import Status
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.result import Statistics


@dataclass
class Cover:
    """The boxes that a search kept, those it did not examine, and its effort."""

    kept: list[FloatArray] = field(default_factory=list)
    pending: list[FloatArray] = field(default_factory=list)
    empty: int = 0
    split: int = 0

    @property
    def processed(self) -> int:
        """The number of boxes that were examined to the end."""
        return self.empty + self.split + len(self.kept)


class Budget:
    """How long a search may go on; the clock starts when this is made."""

    def __init__(self, options: SolverOptions, cancel: Cancel | None = None) -> None:
        self.max_boxes = options.max_boxes
        self._max_seconds = options.max_seconds
        self._tighten_seconds = options.tighten_seconds
        self._cancel = cancel
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Return how long the search has taken so far."""
        return time.perf_counter() - self._start

    def stopped(self) -> bool:
        """Return whether the search has to end."""
        return bool(self._cancel and self._cancel.is_set()) or self.seconds() > self._max_seconds

    def tightening_stopped(self) -> bool:
        """Return whether boxes are to be left as wide as they are."""
        return self.seconds() > self._tighten_seconds or self.stopped()

    def statistics(self, cover: Cover, n_pending: int) -> Statistics:
        """Return the effort so far."""
        n_kept = len(cover.kept)
        return Statistics(
            cover.processed, cover.empty, cover.split, n_kept, n_pending, self.seconds()
        )


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
    progress: Callable[[Statistics], None] | None = None,
) -> Cover:
    """
    Cover all placements in some boxes by smaller boxes; those kept and pending hold every one.

    `split` returns the parts of a contracted box, none when it is finished.
    """
    cover, queue = Cover(), Queue()
    for box in boxes:
        queue.push(box)
    while queue and cover.processed < budget.max_boxes and not budget.stopped():
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
        if progress:
            progress(budget.statistics(cover, len(queue)))
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
