# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One placement of a large piece from the placements of its patches.

Patches are laid against each other by the points that they share, mirrored where that fits better.
Then least squares over the known pairs moves all points together; their normal equations are
sparse and solved by conjugate gradients. Nothing here is rounded outward: whether the placement
agrees is decided in `place.proofs`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
import heapq
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.rigid_components import Points

MOST_STEPS = 40
"""Most steps of least squares."""

LEAST_GAIN = 1e-6
"""Least squares ends when a step takes off less than this part of what is left."""

MOST_GRADIENTS = 100
"""Most conjugate gradients of a step."""

LEAST_RESIDUAL = 1e-3
"""The normal equations of a step are solved to this fraction."""


@kernel
def _least_spread(positions: FloatArray) -> float:
    """Return the least squared distance of points, summed up, from a line through their center."""
    center = np.zeros(2)
    for x in range(len(positions)):
        for axis in range(2):
            center[axis] += positions[x, axis] / len(positions)
    first = second = mixed = 0.0
    for x in range(len(positions)):
        along, across = positions[x, 0] - center[0], positions[x, 1] - center[1]
        first += along * along
        second += across * across
        mixed += along * across
    return 0.5 * (first + second - math.sqrt((first - second) ** 2 + 4.0 * mixed * mixed))


class _Layer:
    """Lays patches against each other, those first that are held best; see `laid_together`."""

    def __init__(
        self,
        n_points: int,
        patches: Sequence[tuple[Points, FloatArray]],
        pairs: IntArray,
        lower: FloatArray,
        upper: FloatArray,
    ) -> None:
        self._patches = [(np.array(points), local) for points, local in patches]
        self._pairs, self._lower, self._upper = pairs, lower, upper
        dimension = patches[0][1].shape[1]
        self.positions = np.full((n_points, dimension), np.nan)
        self._placed = np.zeros(n_points, dtype=np.bool_)
        self._holders: list[list[int]] = [[] for _ in range(n_points)]
        for number, (points, _) in enumerate(patches):
            for point in points:
                self._holders[point].append(number)
        order = np.argsort(pairs, axis=None, kind='stable')
        starts = np.searchsorted(pairs.ravel()[order], np.arange(n_points + 1))
        self._pairs_of = [order[a:b] // 2 for a, b in zip(starts[:-1], starts[1:], strict=True)]

    def lay(self, stopped: Callable[[], bool]) -> None:
        """Lay all patches, or as many as there is time for."""
        queue = [(0.0, number) for number in range(len(self._patches))]
        heapq.heapify(queue)
        done = [False] * len(self._patches)
        while queue and not stopped():
            _, number = heapq.heappop(queue)
            members, local = self._patches[number]
            new = members[~self._placed[members]]
            if done[number] or not len(new):
                continue
            done[number] = True
            self.positions[new] = self._laid(members, local)[~self._placed[members]]
            self._placed[new] = True
            for other in {x for point in new.tolist() for x in self._holders[point]}:
                if not done[other]:
                    # What it was worth before stays in the queue, below this.
                    heapq.heappush(queue, (-self._hold(other), other))

    def _hold(self, number: int) -> float:
        """Return how well a patch is held by those of its points that are placed."""
        members, local = self._patches[number]
        shared = local[self._placed[members]]
        if len(shared) <= local.shape[1]:
            return 1e-9 * len(shared)
        return _least_spread(shared)

    def _laid(self, members: IntArray, local: FloatArray) -> FloatArray:
        """Lay a patch against the points that are placed, mirrored where that fits better."""
        placed = self._placed[members]
        if not placed.any():
            return local
        shared, goal = local[placed], self.positions[members[placed]]
        center, goal_center = shared.mean(axis=0), goal.mean(axis=0)
        left, _, right = np.linalg.svd((shared - center).T @ (goal - goal_center))
        mirror = np.ones(len(right))
        mirror[-1] = -1.0
        turns = left @ right, (left * mirror) @ right
        laid = [(local - center) @ turn + goal_center for turn in turns]
        return min(laid, key=lambda positions: self._misfit(members, placed, positions))

    def _misfit(self, members: IntArray, placed: NDArray[np.bool_], laid: FloatArray) -> float:
        """Return how badly new points miss their distances to those that are placed."""
        self.positions[members[~placed]] = laid[~placed]
        numbers = np.concatenate([self._pairs_of[point] for point in members[~placed]])
        misfits, _ = _misfits(
            self.positions, self._pairs[numbers], self._lower[numbers], self._upper[numbers], 0.0
        )
        return float(np.nansum(np.square(misfits)))


def laid_together(
    n_points: int,
    patches: Sequence[tuple[Points, FloatArray]],
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    stopped: Callable[[], bool],
) -> FloatArray:
    """
    Lay the placements of patches against each other.

    Parameters
    ----------
    n_points : int
        The number of points.
    patches : sequence of (tuple of int, ndarray)
        The points of each patch and a placement of them in m, of either chirality.
    pairs : ndarray of int, shape (m, 2)
        Known pairs.
    lower, upper : ndarray, shape (m,)
        Bounds of their squared distances in m^2.
    stopped : callable
        Whether there is no time left; asked before each patch.

    Returns
    -------
    ndarray, shape (n, q)
        Coordinates in m, NaN for points of no patch that was laid.

    """
    layer = _Layer(n_points, patches, pairs, lower, upper)
    layer.lay(stopped)
    return layer.positions


def refined(
    positions: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
    stopped: Callable[[], bool],
) -> FloatArray:
    """
    Move a placement into the bounds of many pairs by least squares.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        Coordinates in m.
    pairs : ndarray of int, shape (m, 2)
        The pairs.
    lower, upper : ndarray, shape (m,)
        Bounds of their squared distances in m^2.
    margin : float
        Least squares aims this fraction of the width of an interval inside its ends.
    stopped : callable
        Whether to stop early.

    Returns
    -------
    ndarray, shape (n, q)
        Better coordinates.

    """
    best = positions
    misfits, slopes = _misfits(best, pairs, lower, upper, margin)
    total, damping = float(misfits @ misfits), 1e-6
    for _ in range(MOST_STEPS):
        if total == 0.0 or stopped():
            break
        step = _step(pairs, misfits, slopes, damping, len(best))
        trial = best - step
        trial_misfits, trial_slopes = _misfits(trial, pairs, lower, upper, margin)
        trial_total = float(trial_misfits @ trial_misfits)
        if trial_total < total:
            if trial_total > (1.0 - LEAST_GAIN) * total:
                break
            best, misfits, slopes = trial, trial_misfits, trial_slopes
            total, damping = trial_total, max(0.1 * damping, 1e-9)
        else:
            damping *= 10.0
            if not damping < 1e3:
                break
    return best


@kernel
def _misfits(
    positions: FloatArray,
    pairs: IntArray,
    lower: FloatArray,
    upper: FloatArray,
    margin: float,
) -> tuple[FloatArray, FloatArray]:
    """Return by how many m the distances of pairs miss their bounds, and their unit vectors."""
    dimension = positions.shape[1]
    misfits = np.zeros(len(pairs))
    slopes = np.zeros((len(pairs), dimension))
    for x in range(len(pairs)):
        i, j = pairs[x, 0], pairs[x, 1]
        squared = 0.0
        for axis in range(dimension):
            squared += (positions[i, axis] - positions[j, axis]) ** 2
        length = np.sqrt(squared)
        low, high = np.sqrt(lower[x]), np.sqrt(upper[x])
        if high < np.inf:
            inward = margin * (high - low)
            low += inward
            high -= inward
        misfits[x] = length - min(max(length, low), high)
        if misfits[x] != 0.0 and length > 0.0:
            for axis in range(dimension):
                slopes[x, axis] = (positions[i, axis] - positions[j, axis]) / length
    return misfits, slopes


@kernel
def _step(
    pairs: IntArray, misfits: FloatArray, slopes: FloatArray, damping: float, n_points: int
) -> FloatArray:
    """Solve the damped normal equations of the misfits by conjugate gradients."""
    dimension = slopes.shape[1]
    step = np.zeros((n_points, dimension))
    rest = np.zeros((n_points, dimension))
    product = np.empty((n_points, dimension))
    for x in range(len(pairs)):
        for axis in range(dimension):
            value = slopes[x, axis] * misfits[x]
            rest[pairs[x, 0], axis] += value
            rest[pairs[x, 1], axis] -= value
    direction = rest.copy()
    size = (rest * rest).sum()
    enough = LEAST_RESIDUAL**2 * size
    for _ in range(MOST_GRADIENTS):
        if size <= enough or size == 0.0:
            break
        for i in range(n_points):
            for axis in range(dimension):
                product[i, axis] = damping * direction[i, axis]
        for x in range(len(pairs)):
            i, j = pairs[x, 0], pairs[x, 1]
            along = 0.0
            for axis in range(dimension):
                along += slopes[x, axis] * (direction[i, axis] - direction[j, axis])
            for axis in range(dimension):
                product[i, axis] += slopes[x, axis] * along
                product[j, axis] -= slopes[x, axis] * along
        length = size / (direction * product).sum()
        new_size = 0.0
        for i in range(n_points):
            for axis in range(dimension):
                step[i, axis] += length * direction[i, axis]
                rest[i, axis] -= length * product[i, axis]
                new_size += rest[i, axis] ** 2
        for i in range(n_points):
            for axis in range(dimension):
                direction[i, axis] = rest[i, axis] + new_size / size * direction[i, axis]
        size = new_size
    return step
