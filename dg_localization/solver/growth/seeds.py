# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Where growth begins: four points that all measure each other, from which the others are reached.

A point is reached when it measures q points that are reached. Nothing here decides what is true:
any four points may be placed first.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import BoolArray
from dg_localization.solver.problem import Problem

MOST_SEEDS = 2000
"""So many of the best seeds are looked at."""


@kernel
def _tetrahedra(measured: BoolArray, most: int) -> IntArray:
    """Return sets of four points that all measure each other, at most so many."""
    n_points = len(measured)
    found = np.empty((most, 4), dtype=np.int64)
    count = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            if not measured[i, j]:
                continue
            for k in range(j + 1, n_points):
                if not (measured[i, k] and measured[j, k]):
                    continue
                for other in range(k + 1, n_points):
                    if measured[i, other] and measured[j, other] and measured[k, other]:
                        if count == most:
                            return found
                        found[count] = i, j, k, other
                        count += 1
    return found[:count].copy()


@kernel
def _quality(lower: FloatArray, upper: FloatArray, corners: IntArray) -> FloatArray:
    """Return the squared volume of each tetrahedron, over its edges and their errors."""
    quality = np.empty(len(corners))
    gram = np.empty((3, 3))
    for x in range(len(corners)):
        longest, widest = 0.0, 0.0
        for a in range(4):
            for b in range(a + 1, 4):
                i, j = corners[x, a], corners[x, b]
                longest = max(longest, upper[i, j])
                widest = max(widest, upper[i, j] - lower[i, j])
        origin = corners[x, 0]
        for a in range(3):
            for b in range(3):
                i, j = corners[x, a + 1], corners[x, b + 1]
                total = lower[origin, i] + upper[origin, i] + lower[origin, j] + upper[origin, j]
                gram[a, b] = 0.25 * (total - lower[i, j] - upper[i, j])
        volume = (
            gram[0, 0] * (gram[1, 1] * gram[2, 2] - gram[1, 2] * gram[2, 1])
            - gram[0, 1] * (gram[1, 0] * gram[2, 2] - gram[1, 2] * gram[2, 0])
            + gram[0, 2] * (gram[1, 0] * gram[2, 1] - gram[1, 1] * gram[2, 0])
        )
        # An exact one is as good as one known to a thousandth.
        quality[x] = volume / (longest * longest * (widest + 1e-3 * longest))
    return quality


def _reached(neighbors: list[int], seed: int, dimension: int) -> int:
    """Return the points that are reached from a seed; sets of points are the bits of a number."""
    reached, waiting = seed, [x for x in range(len(neighbors)) if not seed >> x & 1]
    while True:
        left = [x for x in waiting if (neighbors[x] & reached).bit_count() < dimension]
        if len(left) == len(waiting):
            return reached
        left_bits = set(left)
        for x in waiting:
            if x not in left_bits:
                reached |= 1 << x
        waiting = left


def best_seed(
    problem: Problem, measured: BoolArray, stopped: Callable[[], bool]
) -> tuple[int, ...] | None:
    """
    Return the four points that most others are reached from, of these the best known ones.

    Parameters
    ----------
    problem : Problem
        A problem in space.
    measured : ndarray of bool, shape (n, n)
        Which pairs are measured.
    stopped : callable
        Whether there is no time left to look for better ones.

    Returns
    -------
    tuple of int or None
        The points; None where no four points all measure each other.

    """
    corners = _tetrahedra(measured, MOST_SEEDS)
    quality = _quality(problem.lower, problem.upper, corners)
    neighbors = [sum(1 << int(y) for y in np.flatnonzero(row)) for row in measured]
    best, best_reached = None, 0
    for x in np.argsort(-quality, kind='stable').tolist():
        if best is not None and stopped():
            break
        seed = sum(1 << int(point) for point in corners[x])
        if quality[x] <= 0.0 or seed & ~best_reached == 0:
            # What it reaches, the best one reaches as well.
            continue
        reached = _reached(neighbors, seed, problem.dimension)
        if reached.bit_count() > best_reached.bit_count():
            best, best_reached = tuple(corners[x].tolist()), reached
    return best
