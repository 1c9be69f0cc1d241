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
decreasing thickness, until slices cut nothing off. Slices too few for all ends are cut off those
pairs that linear programs leave much wider than they explain.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product

from dg_localization.solver.box import LOWER, UPPER, FloatArray, cut_at
from dg_localization.solver.contract.reduction import SMALL_FLEET
from dg_localization.solver.contract.status import Status
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
"""Fewer slices are not cut."""

MOST_IDLE_SLICES = 50
"""Tightening ends after so many slices in a row that cut nothing off, in a small fleet."""

SLICE_POWER = 2
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

    def _may_go_on(self) -> bool:
        """Return whether slices and time are left, and slices still cut something off."""
        idle = self._idle_slices >= self._most_idle
        return self.slices > 0 and not idle and not self._stopped()

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


def tighten(
    pruner: Pruner, box: FloatArray, slices: int, stopped: Callable[[], bool]
) -> FloatArray | None:
    """Narrow the intervals of a finished box."""
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
    return slicer.box
