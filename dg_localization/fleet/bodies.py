"""
Bodies: points whose mutual distances and chirality are known without any measurement.

The anchors are the body of the world. What their coordinates say never changes, so it is computed
once.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
import math

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.interval.arrays import Interval, cross, determinant
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
    centres = {
        index[name]: Interval.point(anchor.coordinates_m)
        for name, anchor in config.anchors.items()
    }
    return AnchorGeometry(
        boxes=boxes,
        distances=tuple(
            (a, b, *_squared_distance(centres[a] - centres[b], bounds_m[a] + bounds_m[b]))
            for a, b in combinations(boxes, 2)
        ),
        chiralities=_chiralities(boxes, config.dimension),
        cores=_cores(boxes, config.dimension),
    )


def squared_bounds(lower_m: float, upper_m: float) -> tuple[float, float]:
    """Return bounds in m^2 of the square of a distance; reversed when `upper_m` is negative."""
    low = math.nextafter(lower_m * lower_m, -math.inf) if lower_m > 0.0 else 0.0
    if upper_m < 0.0:
        # No distance is negative. An empty interval that starts at the least possible number.
        return max(low, math.ulp(0.0)), 0.0
    return max(0.0, low), math.nextafter(upper_m * upper_m, math.inf)


def _squared_distance(vector: Interval, slack_m: float) -> tuple[float, float]:
    """Return bounds in m^2 of the squared length of a vector that is known within a slack."""
    squares = vector.square()
    total = squares[0]
    for axis in range(1, len(squares.lower)):
        total = total + squares[axis]
    if slack_m == 0.0:
        return max(0.0, float(total.lower)), float(total.upper)
    slack_m = math.nextafter(slack_m, math.inf)
    distance = total.sqrt()
    lower_m = math.nextafter(float(distance.lower) - slack_m, -math.inf)
    upper_m = math.nextafter(float(distance.upper) + slack_m, math.inf)
    return squared_bounds(lower_m, upper_m)


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
