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

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.graph import components_of
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.window.proved import heading_arcs, intersect_arcs
from dg_localization.fleet.window.shape_headings import with_headings
from dg_localization.pairs.cover import arc_around


def join_meeting(placements: Sequence[Placement]) -> tuple[Placement, ...]:
    """
    Return placements, those of which the bounds of all poses meet as one.

    Parameters
    ----------
    placements : sequence of Placement
        In one frame, in the plane.

    Returns
    -------
    tuple of Placement
        In the order of the first of each.

    """
    if len(placements) < 2:
        return tuple(placements)
    components = components_of(_which_meet(placements))
    return tuple(_join([placements[number] for number in together]) for together in components)


def _which_meet(placements: Sequence[Placement]) -> NDArray[np.bool_]:
    """Return which placements, (k, k), have bounds of all poses that meet."""
    enclosures = np.stack([placement.enclosure_m for placement in placements])
    arcs = np.stack([heading_arcs(placement) for placement in placements])
    lower, upper = enclosures[:, :, 0], enclosures[:, :, 1]
    boxes_meet = (lower[:, None] <= upper[None]) & (lower[None] <= upper[:, None])
    _, arcs_meet = intersect_arcs(arcs[:, None], arcs[None])
    return np.asarray(boxes_meet.all(axis=(2, 3)) & arcs_meet.all(axis=2))


def _join(placements: Sequence[Placement]) -> Placement:
    """Return one placement around some: its best point is that of the first."""
    first = placements[0]
    if len(placements) == 1:
        return first
    enclosures = np.stack([placement.enclosure_m for placement in placements])
    landmarks = np.stack([placement.landmark_enclosure_m for placement in placements])
    arcs = np.stack([heading_arcs(placement) for placement in placements])
    around = [arc_around(arcs[:, robot, 0], arcs[:, robot, 1]) for robot in range(arcs.shape[1])]
    unknown = replace(
        first,
        enclosure_m=_around(enclosures),
        landmark_enclosure_m=_around(landmarks),
        lower_m=np.min([placement.lower_m for placement in placements], axis=0),
        upper_m=np.max([placement.upper_m for placement in placements], axis=0),
        orientations_xyzw=np.full_like(first.orientations_xyzw, np.nan),
        heading_half_width_rad=np.full_like(first.heading_half_width_rad, np.pi),
        flexible=any(placement.flexible for placement in placements),
        mirrored=False,
    )
    return with_headings(unknown, np.array(around))


def _around(boxes_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest boxes around some, shapes (k, n, 2, q) and (n, 2, q)."""
    return np.stack([boxes_m[:, :, 0].min(axis=0), boxes_m[:, :, 1].max(axis=0)], axis=1)
