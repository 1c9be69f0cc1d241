# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of distances, by readings, anchors, the size of robots, and triangulation."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, combinations
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.rays import Angles
from dg_localization.fleet.elevations import distance_in_plane_m, squared_rise_m2
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.interval.angles import sine_bounds
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import (
    product_down,
    product_up,
    quotient_down,
    quotient_up,
    sqrt_down,
    sqrt_up,
    squared_distance,
)

FloatArray = NDArray[np.float64]

PairBounds: TypeAlias = tuple[int, int, float, float]
"""Two points with bounds of their squared distance in m^2."""


def given_distances(
    snapshot: Snapshot, dropped: frozenset[LinkKey], remembered: Iterable[PairBounds] = ()
) -> tuple[FloatArray, FloatArray]:
    """Return bounds of all squared distances, from all data except the rays."""
    n_points = len(snapshot.config.points)
    lower, upper = np.zeros((n_points, n_points)), np.full((n_points, n_points), np.inf)
    np.fill_diagonal(upper, 0.0)
    for bounds in chain(_bounds_of_pairs(snapshot, dropped), remembered):
        intersect_pair(lower, upper, *bounds)
    return lower, upper


def share_on_robots(snapshot: Snapshot, lower: FloatArray, upper: FloatArray) -> None:
    """Bound the distances from each point of a robot by those of its other points, in place."""
    for *ends, _, s_upper_m2 in snapshot.mounts.distances:
        apart_m = np.array(sqrt_up(s_upper_m2))
        first, second = (snapshot.config.rows[end] for end in ends)
        for known, bounded in ((first, second), (second, first)):
            reach = Interval(-apart_m, apart_m)
            squared = (Interval(lower[known], upper[known]).sqrt() + reach).square()
            others = np.arange(len(lower)) != known
            lower[bounded, others] = np.maximum(lower[bounded], squared.lower)[others]
            upper[bounded, others] = np.minimum(upper[bounded], squared.upper)[others]
            lower[bounded, bounded] = upper[bounded, bounded] = 0.0
            lower[:, bounded], upper[:, bounded] = lower[bounded], upper[bounded]


def intersect_pair(
    lower: FloatArray, upper: FloatArray, i: int, j: int, s_lower_m2: float, s_upper_m2: float
) -> None:
    """Intersect the bounds of one squared distance with others, in place."""
    lower[i, j] = lower[j, i] = max(lower[i, j], s_lower_m2)
    upper[i, j] = upper[j, i] = min(upper[i, j], s_upper_m2)


def _bounds_of_pairs(snapshot: Snapshot, dropped: frozenset[LinkKey]) -> Iterator[PairBounds]:
    """Yield pairs of points with bounds of their squared distance."""
    rows = snapshot.config.rows
    for reading in snapshot.distances:
        if reading.key not in dropped:
            first, second = reading.key.ends
            squared_m2 = squared_distance(reading.lower_m, reading.upper_m)
            yield rows[first], rows[second], *squared_m2
    yield from snapshot.anchors.distances
    for first, second, s_lower_m2, s_upper_m2 in snapshot.mounts.distances:
        yield rows[first], rows[second], s_lower_m2, s_upper_m2
    yield from _separations(snapshot.config)


def _separations(config: FleetConfig) -> Iterator[PairBounds]:
    """Yield all pairs of robots with the least distance between them."""
    if config.min_separation_m == 0.0:
        return
    elevations_m = [config.elevation_m(robot) for robot in config.robots]
    for i, j in combinations(range(len(config.robots)), 2):
        rise_m2 = squared_rise_m2(elevations_m[i], elevations_m[j])
        apart_m = distance_in_plane_m((config.min_separation_m, math.inf), rise_m2)
        yield i, j, *squared_distance(*apart_m)


def triangulate(lower: FloatArray, upper: FloatArray, angles: Angles) -> None:
    """
    Bound the distances to points that are seen from both ends of a known distance, in place.

    With the angles A at a and B at b, the third angle is pi - A - B, and the law of sines gives
    d_ac = d_ab sin B / sin(A + B).
    """
    unranged = np.isinf(upper)
    if not unranged.any():
        return
    bounds_rad = (bound.tolist() for bound in angles.bounds_rad())
    known = {
        (corner[0], frozenset(corner[1:])): (low, high)
        for corner, low, high in zip(angles.corners.tolist(), *bounds_rad, strict=True)
        if corner[1] != corner[2]
    }
    for (a, ends), at_a in known.items():
        for b in ends:
            (c,) = ends - {b}
            if not unranged[a, c] or unranged[a, b] or lower[a, b] > upper[a, b]:
                continue
            at_b = known.get((b, frozenset((a, c))))
            if at_b is None:
                continue
            base_m = (sqrt_down(lower[a, b]), sqrt_up(upper[a, b]))
            intersect_pair(lower, upper, a, c, *_third_side_m2(base_m, at_a, at_b))


def _third_side_m2(
    base_m: tuple[float, float], at_a: tuple[float, float], at_b: tuple[float, float]
) -> tuple[float, float]:
    """Return bounds of the square of d_ac from d_ab and the angles at a and b."""
    low_sum, high_sum = at_a[0] + at_b[0], min(math.pi, at_a[1] + at_b[1])
    sine_b_low, sine_b_high = sine_bounds(*at_b)
    sine_c_low, sine_c_high = sine_bounds(min(low_sum, math.pi), high_sum)
    d_lower_m = quotient_down(product_down(base_m[0], max(0.0, sine_b_low)), sine_c_high)
    d_upper_m = quotient_up(product_up(base_m[1], sine_b_high), max(0.0, sine_c_low))
    return squared_distance(d_lower_m, d_upper_m)
