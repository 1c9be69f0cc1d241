# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which pairs of a finished box to bound by linear programs, and in which frames.

A frame is made at the pair of which most is unexplained, and serves all open pairs that share a
point with it. A pair is closed when it is hardly wider than its linear program explains. Frames
come to an end when no pair is open, or when some in a row gained nothing: effects of higher order
are then too large for linear programs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.fixed_point import Pruned
from dg_localization.solver.place.hypotheses import place_problem
from dg_localization.solver.problem import Problem
from dg_localization.solver.search.pruning import Pair, Pruner

WELL_EXPLAINED = 0.01
"""An interval this close to the first-order effect of the errors, relatively, is left alone."""

CLOSED_WIDTH = 1.05
"""A pair is closed below this width, over what its linear program explains."""

LEAST_GAIN = 0.1
MOST_IDLE_FRAMES = 10
"""There are no more frames after so many in a row that shorten no interval by this fraction."""


def unexplained_pairs(problem: Problem, pruned: Pruned) -> list[Pair]:
    """
    Return the unknown pairs whose width the errors do not explain, the widest first.

    To first order the explained width is that of the exact hull. An interval that is narrower, as
    well as a wider one, shows that effects of higher order matter.
    """
    excess = _excess(problem, pruned)
    pairs = np.argwhere(np.triu(np.abs(excess - 1.0) > WELL_EXPLAINED)).tolist()
    return sorted(((i, j) for i, j in pairs), key=lambda pair: -excess[pair])


def open_pairs(problem: Problem, pruned: Pruned) -> list[Pair]:
    """Return the unknown pairs much wider than the errors explain, the widest first."""
    excess = _excess(problem, pruned)
    return [pair for pair in unexplained_pairs(problem, pruned) if excess[pair] > CLOSED_WIDTH]


def _excess(problem: Problem, pruned: Pruned) -> FloatArray:
    """Return the widths of the unknown pairs over what errors explain; 1 where that is unknown."""
    known = np.isinf(problem.upper) & (pruned.explained > 0.0)
    width = pruned.box[UPPER] - pruned.box[LOWER]
    return np.divide(width, pruned.explained, out=np.ones_like(width), where=known)


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

    def explain(self, explained: FloatArray) -> None:
        """Write what the linear programs explained, which is less than least squares do."""
        known = self._explained > 0.0
        (i, j), least = self._pairs[known].T, self._explained[known]
        explained[i, j] = explained[j, i] = least

    def _widths(self) -> NDArray[np.float64]:
        rows, columns = self._pairs.T
        return self._box[UPPER, rows, columns] - self._box[LOWER, rows, columns]


def narrow_by_linear_programs(pruner: Pruner, pruned: Pruned, stopped: Callable[[], bool]) -> bool:
    """
    Narrow the unexplained pairs of a box by linear programs, in place; False when it is empty.

    What the errors explain is corrected to what linear programs explain.
    """
    unexplained = unexplained_pairs(pruner.problem, pruned)
    if not unexplained:
        return True
    positions = place_problem(pruner.problem, pruned.box)
    frames = _Frames(pruned.box, np.array(unexplained))
    n_idle = 0
    with until(stopped):
        while n_idle < MOST_IDLE_FRAMES and not stopped():
            chosen = frames.next_frame()
            if chosen is None:
                break
            gain = frames.narrow(pruner, positions, chosen)
            if gain is None:
                return False
            n_idle = n_idle + 1 if gain < LEAST_GAIN else 0
    frames.explain(pruned.explained)
    return True
