# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Angles under which observers see pairs of points, as the contractor of the solver reads them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.rays import RayPairs
from dg_localization.interval.angles import cosine
from dg_localization.interval.arrays import Interval

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Angles:
    """
    Angles under which observers see pairs of points.

    Parameters
    ----------
    corners : numpy.ndarray of int, shape (m, 3)
        The rows of the observer and of the two points.
    low_rad, high_rad : numpy.ndarray, shape (m,)
        Bounds in [0, pi].

    """

    corners: IntArray
    low_rad: FloatArray
    high_rad: FloatArray

    def cosines(self) -> FloatArray:
        """Return bounds of the cosines, shape (m, 2)."""
        bounds = cosine(Interval(self.low_rad, self.high_rad))
        return np.stack([bounds.lower, bounds.upper], axis=1)

    def of(self, points: Sequence[int], n_points: int) -> Angles:
        """Return the angles between some of the `n_points` points, renumbered as listed."""
        row_of = np.full(n_points, -1)
        row_of[list(points)] = np.arange(len(points))
        corners = row_of[self.corners]
        kept = (corners >= 0).all(axis=1)
        return Angles(corners[kept], self.low_rad[kept], self.high_rad[kept])


def angles_of(pairs: Iterable[RayPairs]) -> Angles:
    """Return the angles of the pairs of all observers, without those that say nothing."""
    parts = [_angles_of_observer(observed) for observed in pairs]
    return Angles(
        np.concatenate([np.empty((0, 3), dtype=np.int64), *(part.corners for part in parts)]),
        np.concatenate([np.empty(0), *(part.low_rad for part in parts)]),
        np.concatenate([np.empty(0), *(part.high_rad for part in parts)]),
    )


def _angles_of_observer(pairs: RayPairs) -> Angles:
    """Return the angles between the rays of one observer, without those that say nothing."""
    known = pairs.half_widths_rad < math.pi
    sizes, widths = np.abs(pairs.angles_rad[known]), pairs.half_widths_rad[known]
    return Angles(
        pairs.corners[known],
        np.maximum(sizes - widths, 0.0),
        np.minimum(sizes + widths, math.pi),
    )
