# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bodies: points whose mutual distances and chirality are known without any measurement.

The anchors are the body of the world. What their coordinates say never changes, so it is computed
once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.interval.arrays import Interval, cross, determinant, squared_norm
from dg_localization.interval.bounds import squared_distance, sum_down, sum_up
from dg_localization.solver.problem import Chirality

MAX_CORES = 6
"""How many sets of q anchors are kept as axes of the fixed frame."""


@dataclass(frozen=True)
class AnchorGeometry:
    """
    The anchors of a fleet, by their indices into its points.

    Parameters
    ----------
    boxes : dict of int to Interval
        Bounds of the coordinates of each, in m.
    distances : tuple of (int, int, float, float)
        All pairs with bounds of their squared distance in m^2.
    chiralities : tuple of Chirality
        One, when its sign is certain: the distances fix the others.
    cores : tuple of tuple of int
        Sets of q anchors that certainly span a hyperplane, the largest first.

    """

    boxes: dict[int, Interval]
    distances: tuple[tuple[int, int, float, float], ...]
    chiralities: tuple[Chirality, ...]
    cores: tuple[tuple[int, ...], ...]


def anchor_geometry(config: FleetConfig) -> AnchorGeometry:
    """Return what the coordinates of the anchors say."""
    index = {point: i for i, point in enumerate(config.points)}
    boxes = {
        index[name]: Interval.around(np.array(anchor.coordinates_m), anchor.bound_m)
        if anchor.bound_m > 0.0
        else Interval.point(anchor.coordinates_m)
        for name, anchor in config.anchors.items()
    }
    bounds_m = {index[name]: anchor.bound_m for name, anchor in config.anchors.items()}
    centers = {
        index[name]: Interval.point(anchor.coordinates_m)
        for name, anchor in config.anchors.items()
    }
    return AnchorGeometry(
        boxes=boxes,
        distances=tuple(
            (a, b, *bounded_squared_distance(centers[a] - centers[b], bounds_m[a], bounds_m[b]))
            for a, b in combinations(boxes, 2)
        ),
        chiralities=_chiralities(boxes, config.dimension),
        cores=_cores(boxes, config.dimension),
    )


def bounded_squared_distance(
    difference: Interval, first_bound_m: float, second_bound_m: float
) -> tuple[float, float]:
    """Return bounds in m^2 of the squared distance of two points within bounds of two centers."""
    squared = squared_norm(difference)
    if first_bound_m == second_bound_m == 0.0:
        return max(0.0, float(squared.lower)), float(squared.upper)
    distance = squared.sqrt()
    return squared_distance(
        sum_down(float(distance.lower), -first_bound_m, -second_bound_m),
        sum_up(float(distance.upper), first_bound_m, second_bound_m),
    )


def _chiralities(boxes: dict[int, Interval], dimension: int) -> tuple[Chirality, ...]:
    """Return the chirality of the q + 1 anchors that span most, when it is certain."""
    best, found = 0.0, None
    for points in combinations(boxes, dimension + 1):
        edges = [boxes[point] - boxes[points[0]] for point in points[1:]]
        volume = determinant(Interval.stack(edges, axis=0))
        margin = max(float(volume.lower), -float(volume.upper))
        if margin > best:
            best, found = margin, Chirality(points, volume.sign())
    return () if found is None else (found,)


def _cores(boxes: dict[int, Interval], dimension: int) -> tuple[tuple[int, ...], ...]:
    """Return sets of q anchors that certainly span a hyperplane, the largest first."""
    sizes = {}
    for core in combinations(boxes, dimension):
        edges = [boxes[point] - boxes[core[0]] for point in core[1:]]
        normal = edges[0] if dimension == 2 else cross(edges[0], edges[1])
        size = float(np.maximum(normal.lower, -normal.upper).max())
        if size > 0.0:
            sizes[core] = size
    return tuple(sorted(sizes, key=lambda core: -sizes[core])[:MAX_CORES])


def squared_rise_m2(config: FleetConfig, first: str, second: str) -> tuple[float, float]:
    """Return bounds of the squared difference of the elevations of two points, in m^2."""
    one, other = config.elevation_m(first), config.elevation_m(second)
    if one == other and one[0] == one[1]:
        return 0.0, 0.0
    upper_m = max(sum_up(other[1], -one[0]), sum_up(one[1], -other[0]))
    lower_m = max(sum_down(other[0], -one[1]), sum_down(one[0], -other[1]))
    return squared_distance(lower_m, upper_m)
