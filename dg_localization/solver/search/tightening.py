# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Tightening of a finished box: linear programs bound the distances that were not measured.

A frame is made at the pair of which most is unexplained, and serves all open pairs that share a
point with it. A pair is closed when it is hardly wider than its linear program explains. Frames
come to an end when no pair is open, or when some in a row gained nothing: effects of higher order
are then too large for linear programs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, Status
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.branch_and_prune import Pruner

WELL_EXPLAINED = 0.01
"""An interval this close to the first-order effect of the errors, relatively, is left alone."""

CLOSED_WIDTH = 1.05
"""A pair is closed below this width, over what its linear program explains."""

LEAST_GAIN = 0.1
MOST_IDLE_FRAMES = 10
"""There are no more frames after this many in a row that shorten no interval by this fraction."""


class _Frames:
    """The unexplained pairs of a box, and what linear programs have explained of them so far."""

    def __init__(self, box: FloatArray, pairs: IntArray) -> None:
        self._box = box
        self._pairs = pairs
        self._explained = np.zeros(len(pairs))
        self._was_axis = np.zeros(len(pairs), dtype=np.bool_)

    def next_frame(self) -> IntArray | None:
        """Return the numbers of the pairs for the next frame, its axis first; None at the end."""
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

    def narrow(self, pruner: Pruner, positions: FloatArray, chosen: IntArray) -> float | None:
        """Narrow some pairs; return the largest relative gain, None when the box is empty."""
        before = self._widths()[chosen]
        explained = np.zeros(len(chosen))
        if not pruner.narrow_in_frame(self._box, positions, self._pairs[chosen], explained):
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
    Return the unknown pairs whose width the errors do not explain, the widest first.

    To first order the explained width is that of the exact hull. An interval that is narrower, as
    well as a wider one, shows that effects of higher order matter.
    """
    known = np.isinf(problem.upper) & (pruned.explained > 0.0)
    width = pruned.box[UPPER] - pruned.box[LOWER]
    excess = np.divide(width, pruned.explained, out=np.ones_like(width), where=known)
    pairs = np.argwhere(np.triu(np.abs(excess - 1.0) > WELL_EXPLAINED))
    return pairs[np.argsort(-excess[tuple(pairs.T)], kind='stable')]


def tighten(pruner: Pruner, box: FloatArray, stopped: Callable[[], bool]) -> FloatArray | None:
    """Return a finished box narrowed by linear programs, None where they prove it empty."""
    if stopped():
        return box
    # Contraction also returns which widths the errors explain.
    pruned = pruner.prune(box, stopped)
    if pruned.status is Status.EMPTY:
        return None
    pairs = _unexplained_pairs(pruner.problem, pruned)
    if pruned.status is Status.UNFINISHED or not len(pairs):
        return pruned.box
    positions = place_problem(pruner.problem, pruned.box)
    frames = _Frames(pruned.box, pairs)
    n_idle = 0
    with until(stopped):
        while n_idle < MOST_IDLE_FRAMES and not stopped():
            chosen = frames.next_frame()
            if chosen is None:
                break
            gain = frames.narrow(pruner, positions, chosen)
            if gain is None:
                return None
            n_idle = n_idle + 1 if gain < LEAST_GAIN else 0
    return pruned.box
