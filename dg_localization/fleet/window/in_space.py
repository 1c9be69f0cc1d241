# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window leaves of a placement in space: robots among anchors, by their pose sets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
import math

import numpy as np

from dg_localization.fleet.estimate import FrameKind, Placement
from dg_localization.fleet.rotations import quaternion_of
from dg_localization.fleet.window.carry import WORLD, Tilt
from dg_localization.fleet.window.pose_sets import PoseSets, poses_within
from dg_localization.fleet.window.shape_headings import (
    KNOWN_HALF_WIDTH_RAD,
    Narrowed,
    with_enclosure,
)
from dg_localization.interval.angles import angle_up


def narrow_in_space(
    placement: Placement, frame: FrameKind, pose_sets: PoseSets, tilts: Mapping[int, Tilt]
) -> Narrowed:
    """
    Return what pose sets leave of a placement in space.

    Parameters
    ----------
    placement : Placement
        Of the moment.
    frame : FrameKind
        Of its coordinates; pose sets are in that of the anchors.
    pose_sets : PoseSets
    tilts : mapping of int to Tilt
        Of the robots that have one.

    Returns
    -------
    Narrowed

    """
    if frame is not FrameKind.ANCHORS:
        return Narrowed(placement)
    enclosure = placement.enclosure_m.copy()
    yaws_rad = {}
    for robot, cover in pose_sets.covers.items():
        part = poses_within(cover, *enclosure[robot])
        if part.empty:
            return Narrowed(None, (WORLD, robot))
        enclosure[robot] = part.hull.lower_m, part.hull.upper_m
        yaws_rad[robot] = part.hull.yaw_rad
    narrowed = with_enclosure(placement, enclosure)
    for robot, (low, high) in yaws_rad.items():
        narrowed = _with_orientation(narrowed, robot, low, high, tilts[robot])
    return Narrowed(narrowed)


def _with_orientation(
    placement: Placement, robot: int, low_rad: float, high_rad: float, tilt: Tilt
) -> Placement:
    """Return a placement with the orientation that yaw and tilt make, where rays tell less."""
    middle = 0.5 * (low_rad + high_rad)
    half_yaw = angle_up(max(high_rad - middle, middle - low_rad))
    # Two rotations one after the other turn by no more than the sum of their angles.
    half = angle_up(half_yaw + tilt.error_rad)
    if not half < min(KNOWN_HALF_WIDTH_RAD, placement.heading_half_width_rad[robot]):
        return placement
    c, s = math.cos(middle), math.sin(middle)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    orientations, half_widths = (
        placement.orientations_xyzw.copy(),
        placement.heading_half_width_rad.copy(),
    )
    orientations[robot], half_widths[robot] = quaternion_of(turn @ tilt.rotation), half
    covariances = placement.covariances
    if covariances is not None:
        # Least squares knows nothing of the window: the bound takes its place.
        covariances = covariances.copy()
        covariances[robot, 3:] = covariances[robot, :, 3:] = 0.0
        covariances[robot, [3, 4, 5], [3, 4, 5]] = half * half
    return replace(
        placement,
        orientations_xyzw=orientations,
        heading_known=~np.isnan(orientations[:, 0]),
        heading_half_width_rad=half_widths,
        covariances=covariances,
    )
