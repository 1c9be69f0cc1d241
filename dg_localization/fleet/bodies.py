# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bodies: points whose mutual distances and chirality are known without any measurement.

The anchors are the body of the world. Their geometry never changes and is computed once.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import combinations
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.interval.arrays import Interval, cross, determinant, squared_norm
from dg_localization.interval.bounds import (
    sqrt_down,
    sqrt_up,
    squared_distance,
    sum_down,
    sum_up,
)
from dg_localization.solver.problem import Chirality

FloatArray = NDArray[np.float64]
Point = TypeVar('Point', int, str)

MAX_CORES = 6
"""Most sets of q anchors that are kept as axes of the fixed frame."""

MOST_COMPARED = 24
"""Most anchors of which all sets are compared: 10,626 sets of four in space."""


class AnchorGeometry(NamedTuple):
    """
    The anchors of a fleet, by index into its points.

    Parameters
    ----------
    boxes : dict of int to Interval
        Bounds of the coordinates of each anchor, in m.
    distances : tuple of (int, int, float, float)
        All pairs with bounds of their squared distance in m^2.
    chiralities : tuple of Chirality
        At most one, with a certain sign: the distances fix the others.
    cores : tuple of tuple of int
        Sets of q anchors that certainly span a hyperplane, the largest first.

    """

    boxes: dict[int, Interval]
    distances: tuple[tuple[int, int, float, float], ...]
    chiralities: tuple[Chirality, ...]
    cores: tuple[tuple[int, ...], ...]

    @property
    def spanning(self) -> frozenset[int]:
        """The few anchors that span most; all anchors if none certainly span the space."""
        if not self.chiralities:
            return frozenset(self.boxes)
        return frozenset(self.chiralities[0].points).union(*self.cores[:1])

    def among(self, points: Collection[int]) -> AnchorGeometry:
        """Return the geometry of some of the anchors, without their distances."""
        boxes = {point: box for point, box in self.boxes.items() if point in points}
        if not boxes:
            return AnchorGeometry({}, (), (), ())
        return _geometry([*boxes], Interval.stack([*boxes.values()], axis=0))


def anchor_geometry(config: FleetConfig) -> AnchorGeometry:
    """Return the geometry of the anchors from their coordinates."""
    if not config.anchors:
        return AnchorGeometry({}, (), (), ())
    rows = [config.rows[name] for name in config.anchors]
    centers = np.array([anchor.coordinates_m for anchor in config.anchors.values()])
    bounds_m = np.array([anchor.bound_m for anchor in config.anchors.values()])
    distances = squared_distances(rows, centers, bounds_m.tolist())
    return _geometry(rows, boxes_around(centers, bounds_m[:, None]))._replace(distances=distances)


def boxes_around(centers_m: FloatArray, bounds_m: FloatArray) -> Interval:
    """Return boxes around places, rounded outward unless exact."""
    around, is_exact = Interval.around(centers_m, bounds_m), bounds_m == 0.0
    return Interval(
        np.where(is_exact, centers_m, around.lower), np.where(is_exact, centers_m, around.upper)
    )


def _geometry(rows: list[int], boxes: Interval) -> AnchorGeometry:
    """Return the geometry of some anchors from their boxes, without distances."""
    bounds_m = 0.5 * np.max(boxes.upper - boxes.lower, axis=1)
    compared = _well_spread(0.5 * (boxes.lower + boxes.upper), bounds_m)
    return AnchorGeometry(
        boxes={row: boxes[x] for x, row in enumerate(rows)},
        distances=(),
        chiralities=_chiralities(rows, boxes, compared),
        cores=_cores(rows, boxes, compared),
    )


def squared_distances(
    points: Sequence[Point], centers_m: FloatArray, bounds_m: Sequence[float]
) -> tuple[tuple[Point, Point, float, float], ...]:
    """Return all pairs of points within bounds of centers, with bounds of s in m^2."""
    first, second = np.triu_indices(len(points), 1)
    centers = Interval.point(centers_m)
    squared = squared_norm(centers[first] - centers[second])
    found: list[tuple[Point, Point, float, float]] = []
    pairs = combinations(zip(points, bounds_m, strict=True), 2)
    between_m2 = zip(squared.lower.tolist(), squared.upper.tolist(), strict=True)
    for ((i, i_m), (j, j_m)), (lower_m2, upper_m2) in zip(pairs, between_m2, strict=True):
        if i_m or j_m:
            least_m = sum_down(sqrt_down(lower_m2), -i_m, -j_m)
            most_m = sum_up(sqrt_up(upper_m2), i_m, j_m)
            lower_m2, upper_m2 = squared_distance(least_m, most_m)
        found.append((i, j, max(0.0, lower_m2), upper_m2))
    return tuple(found)


def _well_spread(centers: FloatArray, bounds_m: FloatArray) -> list[int]:
    """
    Return the anchors whose sets are compared, at most `MOST_COMPARED`, in their order.

    The first q + 1 span most: each is farthest from the line or plane through the anchors before
    it. Each further one has the greatest distance to the nearest anchor before it. The bound of an
    anchor counts against it.
    """
    if len(centers) <= MOST_COMPARED:
        return list(range(len(centers)))
    chosen = [_farthest(np.linalg.norm(centers - centers.mean(axis=0), axis=1) - bounds_m, [])]
    apart_m = np.linalg.norm(centers - centers[chosen[0]], axis=1)
    off_span = centers - centers[chosen[0]]
    while len(chosen) < MOST_COMPARED:
        spans = len(chosen) <= centers.shape[1]
        far_m = np.linalg.norm(off_span, axis=1) if spans else apart_m
        chosen.append(_farthest(far_m - bounds_m, chosen))
        apart_m = np.minimum(apart_m, np.linalg.norm(centers - centers[chosen[-1]], axis=1))
        axis = off_span[chosen[-1]]
        if spans and axis.any():
            axis = axis / np.linalg.norm(axis)
            off_span = off_span - np.outer(off_span @ axis, axis)
    return sorted(chosen)


def _farthest(far_m: FloatArray, chosen: list[int]) -> int:
    """Return the farthest anchor that is not chosen yet."""
    far_m[chosen] = -np.inf
    return int(np.argmax(far_m))


def _chiralities(rows: list[int], boxes: Interval, compared: list[int]) -> tuple[Chirality, ...]:
    """Return the chirality of the q + 1 anchors that span most, when it is certain."""
    dimension = boxes.lower.shape[1]
    if len(compared) <= dimension:
        return ()
    sets = np.array(list(combinations(compared, dimension + 1)))
    volumes = determinant(boxes[sets[:, 1:]] - boxes[sets[:, :1]])
    best = int(np.argmax(np.maximum(volumes.lower, -volumes.upper)))
    sign = volumes[best].sign()
    return (Chirality(tuple(rows[x] for x in sets[best]), sign),) if sign else ()


def _cores(rows: list[int], boxes: Interval, compared: list[int]) -> tuple[tuple[int, ...], ...]:
    """Return sets of q anchors that certainly span a hyperplane, the largest first."""
    dimension = boxes.lower.shape[1]
    if len(compared) < dimension:
        return ()
    sets = np.array(list(combinations(compared, dimension)))
    edges = boxes[sets[:, 1:]] - boxes[sets[:, :1]]
    normals = edges[:, 0] if dimension == 2 else cross(edges[:, 0], edges[:, 1])
    sizes = np.maximum(normals.lower, -normals.upper).max(axis=1)
    largest = np.argsort(-sizes, kind='stable')[:MAX_CORES]
    return tuple(tuple(rows[x] for x in sets[k]) for k in largest if sizes[k] > 0.0)
