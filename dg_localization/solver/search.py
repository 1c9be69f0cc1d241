"""
Branch and prune: contract a box, split it where it is ambiguous, until all is told (Section 4).

The paper splits the widest range in the middle. Here a box is split at its largest gap first,
where both halves are likely to hold a solution and none is wasted, and in the middle only when
there is no gap and the box is wider than the measurement errors explain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
import heapq
from itertools import count
import time
from typing import Protocol

import numpy as np

from dg_localization.solver.box import GAP_LOWER, GAP_UPPER, LOWER, UPPER, FloatArray
from dg_localization.solver.contraction import contract, make_workspace
from dg_localization.solver.placements import place
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import SolverOptions, Statistics
from dg_localization.solver.rigidity import explained_widths, is_flexible
from dg_localization.solver.sides import handedness_is_possible, sides_of
from dg_localization.solver.smoothing import smooth_triangles

MAX_SWEEPS = 50
LEAST_GAIN = 0.05
LEAST_GAP = 0.1
"""A gap narrower than this fraction of the resolution is not worth a split."""

EXPLAINED_FACTOR = 3.0
"""How much wider a finished box may be than the first-order effect of the measurement errors."""


class Cancel(Protocol):
    """Whatever tells that nobody wants the answer any more, such as a `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether to stop."""
        ...


@dataclass
class Cover:
    """The boxes that a search kept and those it did not come to, with its effort."""

    kept: list[FloatArray] = field(default_factory=list)
    pending: list[FloatArray] = field(default_factory=list)
    statistics: Statistics = Statistics(0, 0, 0, 0, 0, 0.0)


class Pruner:
    """Contracts the boxes of one problem and decides what becomes of them."""

    def __init__(self, problem: Problem, options: SolverOptions) -> None:
        self._problem = problem
        self._resolution = options.resolution
        self._work = make_workspace(problem.n_points, problem.dimension)
        self._sides = sides_of(problem)
        self._axes = np.array(
            [(a, b) for a in range(problem.n_points) for b in range(a + 1, problem.n_points)],
            dtype=np.int64,
        ).reshape(-1, 2)
        self._simplices = np.array(
            [chirality.points for chirality in problem.chiralities], dtype=np.int64
        ).reshape(-1, problem.dimension + 1)
        self._signs = np.array(
            [chirality.sign for chirality in problem.chiralities], dtype=np.int64
        )
        self._measured = np.isfinite(problem.upper) & ~np.eye(problem.n_points, dtype=bool)
        self._half_widths = 0.5 * (problem.upper - problem.lower)

    def whole(self) -> FloatArray | None:
        """Return the box of the problem itself, None where the triangles prove it to be empty."""
        n_points = self._problem.n_points
        box = np.zeros((4, n_points, n_points))
        box[LOWER] = self._problem.lower
        box[UPPER] = self._problem.upper
        points, distance = self._work.points[0], self._work.distance
        return box if smooth_triangles(box, distance, points, n_points) else None

    def prune(self, box: FloatArray) -> bool:
        """Contract a box in place; False when it is proved to be empty."""
        if not contract(box, self._work, self._sides, self._axes, MAX_SWEEPS, LEAST_GAIN):
            return False
        return len(self._signs) < 2 or handedness_is_possible(box, self._simplices, self._signs)

    def split(self, box: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return the two parts a contracted box should be split into, None when it is finished."""
        upper = np.where(np.isfinite(box[UPPER]), box[UPPER], 0.0)
        widths_m = np.sqrt(upper) - np.sqrt(np.minimum(box[LOWER], upper))
        if widths_m.max() <= self._resolution:
            return None
        gaps_m = np.sqrt(box[GAP_UPPER]) - np.sqrt(box[GAP_LOWER])
        pair = np.unravel_index(np.argmax(gaps_m), gaps_m.shape)
        if gaps_m[pair] > LEAST_GAP * self._resolution:
            return _cut(box, pair, box[GAP_LOWER][pair], box[GAP_UPPER][pair])
        excess = self._excess(box, widths_m)
        pair = np.unravel_index(np.argmax(excess), excess.shape)
        if excess[pair] <= 1.0:
            return None
        middle = (0.5 * (np.sqrt(box[LOWER][pair]) + np.sqrt(box[UPPER][pair]))) ** 2
        return _cut(box, pair, middle, middle)

    def _excess(self, box: FloatArray, widths_m: FloatArray) -> FloatArray:
        """Return how many times wider each range is than it has to be."""
        if np.isfinite(box[UPPER]).all():
            positions = place(box, self._problem.dimension)
            if not is_flexible(positions, self._measured):
                explained = explained_widths(positions, self._measured, self._half_widths)
                distances_m = np.sqrt(0.5 * (box[LOWER] + box[UPPER]))
                tolerated = EXPLAINED_FACTOR * explained + self._resolution * 2.0 * distances_m
                width = box[UPPER] - box[LOWER]
                return np.divide(width, tolerated, out=np.zeros_like(width), where=tolerated > 0.0)
        return widths_m / self._resolution


def _cut(
    box: FloatArray, pair: tuple[np.intp, ...], low_end: float, high_start: float
) -> tuple[FloatArray, FloatArray]:
    """Return the parts of a box below `low_end` and above `high_start` of one pair."""
    i, j = pair
    below, above = box.copy(), box.copy()
    below[UPPER, i, j] = below[UPPER, j, i] = low_end
    above[LOWER, i, j] = above[LOWER, j, i] = high_start
    for part in (below, above):
        part[GAP_LOWER:, i, j] = part[GAP_LOWER:, j, i] = 0.0
    return below, above


def search(
    problem: Problem,
    options: SolverOptions,
    cancel: Cancel | None = None,
    progress: Callable[[Statistics], None] | None = None,
) -> Cover:
    """
    Cover all placements of a problem by boxes.

    Parameters
    ----------
    problem : Problem
        The problem.
    options : SolverOptions
        Resolution and limits.
    cancel : object with ``is_set()``, optional
        Stops the search when set, as a limit would.
    progress : callable, optional
        Called with the statistics so far, once a box.

    Returns
    -------
    Cover
        Kept and pending boxes, which together hold every placement.

    """
    start = time.perf_counter()
    pruner = Pruner(problem, options)
    order = count()
    # The widest box first: an early stop then leaves the most even cover.
    pending: list[tuple[float, int, FloatArray]] = []
    kept: list[FloatArray] = []
    processed = empty = split = 0
    whole = pruner.whole()
    if whole is None:
        processed = empty = 1
    else:
        heapq.heappush(pending, (0.0, next(order), whole))

    def statistics() -> Statistics:
        seconds = time.perf_counter() - start
        return Statistics(processed, empty, split, len(kept), len(pending), seconds)

    while pending and processed < options.max_boxes:
        if time.perf_counter() - start > options.max_seconds or (cancel and cancel.is_set()):
            break
        box = heapq.heappop(pending)[2]
        processed += 1
        if not pruner.prune(box):
            empty += 1
            continue
        parts = pruner.split(box)
        if parts is None:
            kept.append(box)
        else:
            split += 1
            for part in parts:
                heapq.heappush(pending, (-_size(part), next(order), part))
        if progress:
            progress(statistics())
    return Cover(kept, [box for _, _, box in sorted(pending)], statistics())


def _size(box: FloatArray) -> float:
    """Return the sum of the finite widths of a box in m."""
    finite = np.isfinite(box[UPPER])
    return float((np.sqrt(box[UPPER][finite]) - np.sqrt(box[LOWER][finite])).sum())
