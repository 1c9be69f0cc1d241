# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Placements that meet are one hypothesis.

A robot that crosses the line through two others passes from a placement to its mirror image. On
the line the two are the same, and close to it bounds do not tell them apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.graph import components_of
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.frames.finders import FittedPlacement
from dg_localization.fleet.window.proved import heading_arcs, intersect_arcs
from dg_localization.fleet.window.shape_headings import with_headings
from dg_localization.poses.cover import arc_around

MOST_COMPARED = 40
"""Placements of more robots are not joined: the time grows with the cube of their number."""


def join_meeting(fitted: Sequence[FittedPlacement]) -> tuple[Placement, ...]:
    """
    Return placements, those that meet as one.

    Parameters
    ----------
    fitted : sequence of FittedPlacement
        In one frame, in the plane.

    Returns
    -------
    tuple of Placement
        In the order of the first of each.

    """
    if len(fitted) < 2:
        return tuple(one.placement for one in fitted)
    components = components_of(_which_meet([one.placement for one in fitted]))
    joined = [_join([fitted[number] for number in together]) for together in components]
    return tuple(
        # What its image met is another hypothesis now.
        replace(one, mirrored=one.mirrored and (together[0] - 1,) in components)
        for one, together in zip(joined, components, strict=True)
    )


def _which_meet(placements: Sequence[Placement]) -> NDArray[np.bool_]:
    """Return which placements, (k, k), may be one and the same: bounds and sides allow it."""
    enclosures = np.stack([placement.enclosure_m for placement in placements])
    arcs = np.stack([heading_arcs(placement) for placement in placements])
    lower, upper = enclosures[:, :, 0], enclosures[:, :, 1]
    boxes_meet = (lower[:, None] <= upper[None]) & (lower[None] <= upper[:, None])
    _, arcs_meet = intersect_arcs(arcs[:, None], arcs[None])
    meets = np.asarray(boxes_meet.all(axis=(2, 3)) & arcs_meet.all(axis=2))
    for first, second in np.argwhere(np.triu(meets, 1)):
        shared = _shapes_meet(placements[first], placements[second])
        meets[first, second] = meets[second, first] = shared
    return meets


def _shapes_meet(first: Placement, second: Placement) -> bool:
    """
    Return whether one shape may turn into the other within the bounds of both.

    Boxes around robots far from the origin of a frame meet easily. Distances depend on no frame:
    those of both must meet, and three robots that lie the other way round must come in line.
    """
    if len(first.lower_m) > MOST_COMPARED:
        return False
    least_m = np.maximum(first.lower_m, second.lower_m)
    most_m = np.minimum(first.upper_m, second.upper_m)
    if np.any(least_m > most_m):
        return False
    triples = np.array([*combinations(range(len(least_m)), 3)], int).reshape(-1, 3)
    turned = _areas_m2(first, triples) * _areas_m2(second, triples) < 0.0
    return bool(_may_be_in_line(least_m, most_m, triples[turned]).all())


def _areas_m2(placement: Placement, triples: NDArray[np.int_]) -> NDArray[np.float64]:
    """Return twice the signed areas of triangles; NaN where a robot is not placed."""
    corners_m = placement.positions_m[triples]
    first, second = corners_m[:, 1] - corners_m[:, 0], corners_m[:, 2] - corners_m[:, 0]
    return np.asarray(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])


def _may_be_in_line(
    least_m: NDArray[np.float64], most_m: NDArray[np.float64], triples: NDArray[np.int_]
) -> NDArray[np.bool_]:
    """Return which triples may be in line, by bounds of all distances."""
    may = np.zeros(len(triples), bool)
    for turn in range(3):
        end, middle, other = np.roll(triples, turn, axis=1).T
        shortest_m = least_m[end, middle] + least_m[middle, other]
        longest_m = most_m[end, middle] + most_m[middle, other]
        may |= (least_m[end, other] <= longest_m) & (shortest_m <= most_m[end, other])
    return may


def _join(fitted: Sequence[FittedPlacement]) -> Placement:
    """Return one placement around some: its best point is the one that fits best."""
    best = min(fitted, key=lambda one: one.cost).placement
    if len(fitted) == 1:
        return best
    placements = [one.placement for one in fitted]
    enclosures = np.stack([placement.enclosure_m for placement in placements])
    landmarks = np.stack([placement.landmark_enclosure_m for placement in placements])
    arcs = np.stack([heading_arcs(placement) for placement in placements])
    around = [arc_around(arcs[:, robot, 0], arcs[:, robot, 1]) for robot in range(arcs.shape[1])]
    unknown = replace(
        best,
        enclosure_m=_around(enclosures),
        landmark_enclosure_m=_around(landmarks),
        lower_m=np.min([placement.lower_m for placement in placements], axis=0),
        upper_m=np.max([placement.upper_m for placement in placements], axis=0),
        orientations_xyzw=np.full_like(best.orientations_xyzw, np.nan),
        heading_half_width_rad=np.full_like(best.heading_half_width_rad, np.pi),
        flexible=any(placement.flexible for placement in placements),
        mirrored=False,
        covariances=_covariances_of_all(placements, best),
    )
    return with_headings(unknown, np.array(around))


def _covariances_of_all(
    placements: Sequence[Placement], best: Placement
) -> NDArray[np.float64] | None:
    """Return the second moments of some placements about the best one, (n, 6, 6)."""
    moments = []
    for placement in placements:
        if placement.covariances is None:
            return None
        steps = np.zeros(placement.covariances.shape[:2])
        steps[:, :2] = placement.positions_m - best.positions_m
        if placement.fitted_yaws_rad is not None and best.fitted_yaws_rad is not None:
            turns = np.angle(np.exp(1j * (placement.fitted_yaws_rad - best.fitted_yaws_rad)))
            steps[:, 5] = np.where(np.isnan(turns), 0.0, turns)
        moments.append(placement.covariances + steps[:, :, None] * steps[:, None])
    return np.asarray(np.mean(moments, axis=0))


def _around(boxes_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest boxes around some, shapes (k, n, 2, q) and (n, 2, q)."""
    return np.stack([boxes_m[:, :, 0].min(axis=0), boxes_m[:, :, 1].max(axis=0)], axis=1)
