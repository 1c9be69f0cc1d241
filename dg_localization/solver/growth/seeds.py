# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Where growth begins: four points that all measure each other, from which the others are reached.

A point is reached when it measures q points that are reached. Nothing here decides what is true:
any four points may be placed first.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import combinations, islice

import numpy as np

from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import BoolArray
from dg_localization.solver.problem import Problem

MOST_SEEDS = 2000
"""So many seeds are looked at."""


def _tetrahedra(neighbors: list[set[int]]) -> Iterator[tuple[int, ...]]:
    """Yield sets of four points that all measure each other."""
    for i, near in enumerate(neighbors):
        for j, k, other in combinations(sorted(x for x in near if x > i), 3):
            if k in neighbors[j] and other in neighbors[j] and other in neighbors[k]:
                yield i, j, k, other


def _qualities(lower: FloatArray, upper: FloatArray, corners: IntArray) -> FloatArray:
    """Return the squared volume of each tetrahedron, over its edges and their errors."""
    low, high = (bounds[corners[:, :, None], corners[:, None]] for bounds in (lower, upper))
    middle = 0.5 * (low + high)
    gram = 0.5 * (middle[:, 1:, :1] + middle[:, :1, 1:] - middle[:, 1:, 1:])
    longest, widest = high.max(axis=(1, 2)), (high - low).max(axis=(1, 2))
    # An exact one is as good as one known to a thousandth; edges may be zero or huge.
    with np.errstate(all='ignore'):
        gram /= longest[:, None, None]
        return np.asarray(np.linalg.det(gram) * longest / (widest + 1e-3 * longest))


def _reached(neighbors: list[set[int]], seed: tuple[int, ...], dimension: int) -> set[int]:
    """Return the points that are reached from a seed."""
    reached, waiting = set(seed), set(range(len(neighbors))) - set(seed)
    while new := {x for x in waiting if len(neighbors[x] & reached) >= dimension}:
        reached |= new
        waiting -= new
    return reached


def best_seed(
    problem: Problem, measured: BoolArray, stopped: Callable[[], bool]
) -> tuple[int, ...] | None:
    """Return the four points that most others are reached from, of these the best known ones."""
    neighbors = [set(np.flatnonzero(row).tolist()) for row in measured]
    corners = np.array(list(islice(_tetrahedra(neighbors), MOST_SEEDS)), dtype=np.int64)
    corners = corners.reshape(-1, 4)
    quality = _qualities(problem.lower, problem.upper, corners)
    best, best_reached = None, set[int]()
    for x in np.argsort(-quality, kind='stable').tolist():
        if best is not None and (stopped() or len(best_reached) == len(neighbors)):
            break
        seed = tuple(corners[x].tolist())
        if not quality[x] > 0.0 or best_reached.issuperset(seed):
            # What it reaches, the best one reaches as well.
            continue
        reached = _reached(neighbors, seed, problem.dimension)
        if len(reached) > len(best_reached):
            best, best_reached = seed, reached
    return best
