# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Distances that are given: measured, between anchors, and by the size of the robots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import chain, combinations
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.interval.bounds import squared_distance

FloatArray = NDArray[np.float64]

PairBounds: TypeAlias = tuple[int, int, float, float]
"""Two points with bounds of their squared distance in m^2."""


def given_distances(
    snapshot: Snapshot,
    dropped: frozenset[LinkKey],
    rows: Mapping[str, int],
    remembered: Iterable[PairBounds] = (),
) -> tuple[FloatArray, FloatArray]:
    """
    Return bounds of all squared distances, from everything but the rays.

    Parameters
    ----------
    snapshot : Snapshot
    dropped : frozenset of LinkKey
        Links that do not count.
    rows : mapping of str to int
        The row of each point.
    remembered : iterable of PairBounds
        From a window.

    Returns
    -------
    lower, upper : numpy.ndarray, shape (n, n)
        In m^2; reversed where the measurements of a pair contradict each other.

    """
    lower = np.zeros((len(rows), len(rows)))
    upper = np.full((len(rows), len(rows)), np.inf)
    np.fill_diagonal(upper, 0.0)
    given = chain(_bounds_of_pairs(snapshot, dropped, rows), remembered)
    for i, j, s_lower_m2, s_upper_m2 in given:
        intersect_pair(lower, upper, i, j, s_lower_m2, s_upper_m2)
    return lower, upper


def intersect_pair(
    lower: FloatArray, upper: FloatArray, i: int, j: int, s_lower_m2: float, s_upper_m2: float
) -> None:
    """Intersect the bounds of one squared distance with others, in place."""
    lower[i, j] = lower[j, i] = max(lower[i, j], s_lower_m2)
    upper[i, j] = upper[j, i] = min(upper[i, j], s_upper_m2)


def _bounds_of_pairs(
    snapshot: Snapshot, dropped: frozenset[LinkKey], rows: Mapping[str, int]
) -> Iterator[PairBounds]:
    """Yield pairs of points with bounds of their squared distance."""
    for reading in snapshot.distances:
        if reading.key not in dropped:
            ends = rows[reading.key.observer], rows[reading.key.target]
            yield (*ends, *squared_distance(reading.lower_m, reading.upper_m))
    yield from snapshot.anchors.distances
    separation_m2 = squared_distance(snapshot.config.min_separation_m, math.inf)
    if separation_m2[0] > 0.0:
        for i, j in combinations(range(len(snapshot.config.robots)), 2):
            yield i, j, *separation_m2
