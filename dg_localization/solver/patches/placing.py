# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One placement of a large piece from the placements of its patches.

Patches are laid against each other by the points that they share, mirrored where that fits better.
Nothing here is rounded outward: whether the placement agrees is decided in `place.proofs`.
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
from dg_localization.solver.place.sparse_placements import misfits_of


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
        misfits, _ = misfits_of(
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
