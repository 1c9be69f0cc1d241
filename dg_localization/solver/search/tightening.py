# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Tightening of a finished box towards the exact hull.

First the unknown pairs are bounded by linear programs (`linear_programs`). That comes close to the
linearized hull; effects of higher order remain, and for these there are slices.

A slice is the outermost part of the interval of one pair. Contraction cuts off what it proves to
be empty of it. Within a slice that one distance is nearly known, like a measured one, and near an
extreme of a distance all measured distances are at extremes of their own: a slice contracts far
better than the box it was cut from. Both ends of every interval are trimmed by slices of
decreasing thickness. The remaining slices are thin ones, which are halved across the other pairs
until they are proved empty or hold a placement. Tightening ends early when slices cut nothing off.
Slices too few for all ends are cut off those pairs that linear programs leave much wider than they
explain.
"""

from __future__ import annotations

from collections.abc import Callable
import heapq
from itertools import count, product

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray, cut_at
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.status import Status
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.place.proofs import agrees
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.linear_programs import (
    narrow_by_linear_programs,
    open_pairs,
    unexplained_pairs,
)
from dg_localization.solver.search.pruning import Pair, Pruner

THICKEST_SLICE = 0.5
THINNEST_SLICE = 1.0 / 64.0
"""Fractions of the width of an interval."""

PASSES = 2
"""How often each interval is trimmed; the second time benefits from the other intervals."""

LEAST_CUT = 0.3
"""After a slice of which less than this fraction is cut off, the next is half as thick."""

LEAST_SLICES = 4
"""An end for which fewer slices than this are left is not bisected; fewer in all are not cut."""

MOST_IDLE_SLICES = 50
"""Tightening ends after so many slices in a row that cut nothing off, in a small fleet."""

SLICE_POWER = 4
"""The work of a slice grows with this power of the points: fewer idle ones are accepted."""

LEAST_CUT_OF_INTERVAL = 0.01
"""A smaller cut, as a fraction of the interval, counts as none."""


class _Slicer:
    """Cuts slices off one box, until the number of slices is used up."""

    def __init__(
        self, pruner: Pruner, box: FloatArray, slices: int, stopped: Callable[[], bool]
    ) -> None:
        self._pruner = pruner
        self._stopped = stopped
        self.box = box
        self.slices = slices
        self._idle_slices = 0
        ratio = min(1.0, SMALL_FLEET / pruner.problem.n_points)
        self._most_idle = max(1, round(MOST_IDLE_SLICES * ratio**SLICE_POWER))
        self.most_at_an_end = max(LEAST_SLICES, self._most_idle // 2)
        """Slices that bisect one end: if all are idle, others are left for the next."""

    def trim(self, pair: Pair, end: int) -> bool:
        """Cut slices of decreasing thickness off one end; return whether anything is left."""
        thickness = THICKEST_SLICE
        while thickness >= THINNEST_SLICE and self._may_go_on():
            thick = thickness * self._width(pair)
            part, cut = self._slice(pair, end, thick)
            left = self._contracted(part, pair)
            new = cut if left is None else float(left[end, *pair])
            cut_off = abs(self.box[end, *pair] - new)
            if not self._set_end(pair, end, new):
                return False
            if cut_off < LEAST_CUT * thick:
                thickness *= 0.5
        return True

    def bisect(self, pair: Pair, end: int, slices: int) -> bool:
        """Cut thin slices off one end, each bisected; return whether anything is left."""
        reserve = self.slices - slices
        scale = self.box[UPPER] - self.box[LOWER]
        thick = THINNEST_SLICE * self._width(pair)
        is_empty = True
        while is_empty and self._may_go_on(reserve):
            part, cut = self._slice(pair, end, thick)
            left = self._outermost(part, pair, end, scale, reserve)
            is_empty = left is None
            if not self._set_end(pair, end, cut if left is None else float(left[end, *pair])):
                return False
        return True

    def _outermost(
        self, part: FloatArray, pair: Pair, end: int, scale: FloatArray, reserve: int
    ) -> FloatArray | None:
        """
        Halve a slice across its other pairs; return its outermost part, None when it is empty.

        The outermost part is halved first, until the slices are used up or a part is found to hold
        a placement, so that the slice cannot be empty.
        """
        outward = 1.0 if end == UPPER else -1.0
        order = count()
        parts: list[tuple[float, int, FloatArray]] = []
        candidates = [part]
        while True:
            contracted = (self._contracted(half, pair) for half in candidates)
            left = [half for half in contracted if half is not None]
            for half in left:
                rank = -outward * float(half[end, *pair])
                heapq.heappush(parts, (rank, next(order), half))
            if not parts:
                return None
            if not self._may_go_on(reserve + 1):
                break
            if any(finds_placement(self._pruner.problem, half, pair) for half in left):
                break
            candidates = halves(parts[0][2], pair, scale)
            if not candidates:
                break
            heapq.heappop(parts)
        return parts[0][2]

    def _may_go_on(self, reserve: int = 0) -> bool:
        """Return whether slices and time are left, and slices still cut something off."""
        idle = self._idle_slices >= self._most_idle
        return self.slices > reserve and not idle and not self._stopped()

    def _width(self, pair: Pair) -> float:
        return float(self.box[UPPER, *pair] - self.box[LOWER, *pair])

    def _slice(self, pair: Pair, end: int, thick: float) -> tuple[FloatArray, float]:
        """Return the outermost part of an interval, and where it was cut off."""
        cut = float(self.box[end, *pair]) + (thick if end == LOWER else -thick)
        below, above = cut_at(self.box, pair, cut, cut)
        return (below if end == LOWER else above), cut

    def _contracted(self, part: FloatArray, pair: Pair) -> FloatArray | None:
        """Return a slice after contraction, None when it is empty."""
        self.slices -= 1
        self._idle_slices += 1
        pruned = self._pruner.prune_slice(part, pair, self._stopped)
        return None if pruned.status is Status.EMPTY else pruned.box

    def _set_end(self, pair: Pair, end: int, value: float) -> bool:
        """Move one end of an interval; return whether anything is left."""
        i, j = pair
        if abs(value - self.box[end, i, j]) > LEAST_CUT_OF_INTERVAL * self._width(pair):
            self._idle_slices = 0
        self.box[end, [i, j], [j, i]] = value
        return bool(self.box[LOWER, i, j] <= self.box[UPPER, i, j])


def halves(part: FloatArray, pair: Pair, scale: FloatArray) -> list[FloatArray]:
    """Return the halves of a slice across its relatively widest pair, none where all are exact."""
    width = np.triu(part[UPPER] - part[LOWER], 1)
    relative = np.divide(
        width, scale, out=np.zeros_like(width), where=np.isfinite(width) & (scale > 0.0)
    )
    relative[pair] = 0.0
    i, j = np.unravel_index(np.argmax(relative), relative.shape)
    if relative[i, j] == 0.0:
        return []
    middle = 0.5 * (part[LOWER, i, j] + part[UPPER, i, j])
    return cut_at(part, (int(i), int(j)), middle, middle)


def finds_placement(problem: Problem, box: FloatArray, pair: Pair) -> bool:
    """Return whether a placement is found that agrees, with a pair as long as in the box."""
    positions = place_problem(problem, box)
    squared_m2 = float(((positions[pair[0]] - positions[pair[1]]) ** 2).sum())
    low, high = box[: UPPER + 1, *pair]
    return bool(low <= squared_m2 <= high) and agrees(problem, positions)


def tighten(
    pruner: Pruner, box: FloatArray, slices: int, stopped: Callable[[], bool]
) -> FloatArray | None:
    """
    Narrow the intervals of a finished box.

    Parameters
    ----------
    pruner : Pruner
        Contracts boxes of the problem.
    box : ndarray, shape (4, n, n)
        The box in m^2.
    slices : int
        Most slices to examine.
    stopped : callable
        Whether to stop early; the box is sound all the same.

    Returns
    -------
    ndarray, shape (4, n, n), or None
        The narrower box; None when it is proved to hold no placement.

    """
    if stopped():
        return box
    # Contraction also returns which widths the errors explain.
    pruned = pruner.prune(box, stopped)
    if pruned.status is Status.EMPTY:
        return None
    if pruned.status is Status.UNFINISHED:
        return pruned.box
    if not narrow_by_linear_programs(pruner, pruned, stopped):
        return None
    if slices < LEAST_SLICES:
        return pruned.box
    ends = list(product(unexplained_pairs(pruner.problem, pruned), (UPPER, LOWER)))
    if slices < len(ends):
        ends = list(product(open_pairs(pruner.problem, pruned), (UPPER, LOWER)))
    slicer = _Slicer(pruner, pruned.box, slices, stopped)
    if not all(slicer.trim(pair, end) for pair, end in ends * PASSES):
        return None
    for done, (pair, end) in enumerate(ends):
        share = min(slicer.slices // (len(ends) - done), slicer.most_at_an_end)
        if share >= LEAST_SLICES and not slicer.bisect(pair, end, share):
            return None
    return slicer.box
