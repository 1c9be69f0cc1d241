# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of the squared distances of some pairs of points, kept without an n x n array."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@lru_cache(maxsize=64)
def pairs_among(n_points: int) -> tuple[IntArray, IntArray]:
    """Return the rows and the columns of all pairs of points in their order, read only."""
    rows, columns = np.triu_indices(n_points, 1)
    rows.flags.writeable = columns.flags.writeable = False
    return rows, columns


class PairBounds:
    """
    Bounds of the squared distances of some pairs; all other pairs are unknown.

    Parameters
    ----------
    n_points : int
        The number of points.
    keys : ndarray of int, shape (m,)
        The pairs (i, j), i < j, as i n + j, ascending and each once.
    lower, upper : ndarray, shape (m,)
        Their bounds in m^2.

    """

    def __init__(
        self, n_points: int, keys: IntArray, lower: FloatArray, upper: FloatArray
    ) -> None:
        self.n_points = n_points
        self.keys = keys
        self.lower, self.upper = lower, upper

    @classmethod
    def from_matrices(cls, lower: FloatArray, upper: FloatArray) -> PairBounds:
        """Return the bounds of all known pairs of symmetric matrices, shape (n, n)."""
        n_points = len(lower)
        rows, columns = pairs_among(n_points)
        low, high = lower[rows, columns], upper[rows, columns]
        known = (high < np.inf) | (low > 0.0)
        return cls(n_points, (rows * n_points + columns)[known], low[known], high[known])

    @cached_property
    def pairs(self) -> IntArray:
        """The pairs in their order, the smaller point first, shape (m, 2)."""
        pairs = np.empty((len(self.keys), 2), dtype=np.int64)
        np.divmod(self.keys, self.n_points, out=(pairs[:, 0], pairs[:, 1]))
        return pairs

    @cached_property
    def measured(self) -> IntArray:
        """The pairs that have an upper bound, in their order, shape (k, 2)."""
        return np.ascontiguousarray(self.pairs[np.isfinite(self.upper)])

    def among(self, points: Sequence[int]) -> tuple[FloatArray, FloatArray]:
        """
        Return the bounds of all pairs of some points.

        Parameters
        ----------
        points : sequence of int
            The points, k of them.

        Returns
        -------
        lower, upper : ndarray, shape (k, k)
            New arrays with zero diagonal; ``[0, inf]`` for unknown pairs.

        """
        members = np.array(points, dtype=np.int64)
        lower, upper = np.zeros((2, len(members), len(members)))
        rows, columns = pairs_among(len(members))
        low, high = self.of(members[rows], members[columns])
        lower[rows, columns] = lower[columns, rows] = low
        upper[rows, columns] = upper[columns, rows] = high
        return lower, upper

    def of(self, rows: IntArray, columns: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return the lower and upper bounds of some pairs of different points, shapes (k,)."""
        keys = np.minimum(rows, columns) * self.n_points + np.maximum(rows, columns)
        if not len(self.keys):
            return np.zeros(len(keys)), np.full(len(keys), np.inf)
        places = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        held = self.keys[places] == keys
        return np.where(held, self.lower[places], 0.0), np.where(held, self.upper[places], np.inf)

    def restricted(self, points: Sequence[int]) -> PairBounds:
        """Return the bounds of the pairs of some points, ascending, renumbered by their order."""
        members = np.array(points, dtype=np.int64)
        number = np.full(self.n_points, -1)
        number[members] = np.arange(len(members))
        ends = number[self.pairs]
        inside = (ends >= 0).all(axis=1)
        first, second = ends[inside].T
        keys = first * len(members) + second
        return PairBounds(len(members), keys, self.lower[inside], self.upper[inside])

    def narrowed(
        self, rows: IntArray, columns: IntArray, lower: FloatArray, upper: FloatArray
    ) -> PairBounds:
        """Return these bounds intersected with further ones, also of new pairs."""
        new = np.minimum(rows, columns) * self.n_points + np.maximum(rows, columns)
        keys = np.union1d(self.keys, new)
        low, high = np.zeros(len(keys)), np.full(len(keys), np.inf)
        for some, (least, most) in (
            (self.keys, (self.lower, self.upper)),
            (new, (lower, upper)),
        ):
            places = np.searchsorted(keys, some)
            np.maximum.at(low, places, least)
            np.minimum.at(high, places, most)
        return PairBounds(self.n_points, keys, low, high)
