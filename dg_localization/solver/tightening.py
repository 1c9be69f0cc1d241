"""
Tightening of a finished box towards the exact hull.

A slice off one end of a range is a smaller problem: what contraction proves to be empty of it is
cut off. A slice knows the distance it was cut from, which makes it a measurement like the others,
and near an extreme all measurements are at their own extremes: slices contract far better than
the box they were cut from. The last stretch is left where the slices gain nothing any more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from dg_localization.solver.box import GAP_LOWER, LOWER, UPPER, FloatArray
from dg_localization.solver.contraction import CONTRACTED, EMPTY, UNFINISHED

if TYPE_CHECKING:
    from dg_localization.solver.search import Pair, Pruner

THICKEST_SLICE = 0.5
THINNEST_SLICE = 1.0 / 128.0
"""Fractions of the width of a range."""

PASSES = 2
"""How often each range is shaved: a second time profits from all the others."""

LEAST_SHAVE = 0.3
"""A slice of which less than this fraction is cut off is followed by one half as thick."""


def _shave(
    pruner: Pruner,
    box: FloatArray,
    pair: Pair,
    end: int,
    slices: int,
    stopped: Callable[[], bool],
) -> tuple[bool, int]:
    """Cut off one end of a range what slices prove to be empty; (whether any is left, slices)."""
    i, j = pair
    thickness = THICKEST_SLICE
    used = 0
    while thickness >= THINNEST_SLICE and used < slices and not stopped():
        low, high = box[LOWER, i, j], box[UPPER, i, j]
        thick = thickness * (high - low)
        cut = high - thick if end == UPPER else low + thick
        part = box.copy()
        part[LOWER if end == UPPER else UPPER, [i, j], [j, i]] = cut
        part[GAP_LOWER:, [i, j], [j, i]] = 0.0
        used += 1
        status = pruner.prune_slice(part, pair, stopped)
        if status == UNFINISHED:
            break
        new = cut if status == EMPTY else part[end, i, j]
        shaved = abs(new - box[end, i, j])
        box[end, [i, j], [j, i]] = new
        if box[LOWER, i, j] > box[UPPER, i, j]:
            return False, used
        if shaved < LEAST_SHAVE * thick:
            thickness *= 0.5
    return True, used


def tighten(pruner: Pruner, box: FloatArray, slices: int, stopped: Callable[[], bool]) -> bool:
    """
    Narrow the ranges of a finished box, in place.

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
    bool
        False when the box is proved to hold no placement.

    """
    # Contracted again, the box tells which ranges the errors do not explain.
    status = pruner.prune(box, stopped)
    if status != CONTRACTED:
        return status != EMPTY
    for pair in pruner.unexplained(box) * PASSES:
        for end in (UPPER, LOWER):
            left, used = _shave(pruner, box, pair, end, slices, stopped)
            slices -= used
            if not left:
                return False
    return True
