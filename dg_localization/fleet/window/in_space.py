# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window leaves of a placement in space: robots among anchors, by their pose sets."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from dg_localization.fleet.estimate import FrameKind, Placement
from dg_localization.fleet.frames.headings import Heading
from dg_localization.fleet.rotations import quaternion_of, rotations_about_z
from dg_localization.fleet.window.carry import WORLD
from dg_localization.fleet.window.paths import Tilt
from dg_localization.fleet.window.pose_sets import PoseSets, poses_within
from dg_localization.fleet.window.shape_headings import (
    Narrowed,
    arc_middle,
    with_enclosure,
    with_orientations,
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
    found = {}
    for robot, cover in pose_sets.covers.items():
        part = poses_within(cover, *enclosure[robot])
        if part.empty:
            return Narrowed(None, (WORLD, robot))
        enclosure[robot] = part.hull.lower_m, part.hull.upper_m
        found[robot] = _orientation(*part.hull.yaw_rad, tilts[robot])
    narrowed = with_enclosure(placement, enclosure)
    return Narrowed(with_orientations(narrowed, found, [3, 4, 5]))


def _orientation(low_rad: float, high_rad: float, tilt: Tilt) -> Heading:
    """Return the orientation that an arc of yaws and a tilt make."""
    middle, half_yaw = arc_middle(low_rad, high_rad)
    turn = rotations_about_z(np.array([middle]))[0]
    # Two rotations one after the other turn by no more than the sum of their angles.
    return Heading(quaternion_of(turn @ tilt.rotation), angle_up(half_yaw + tilt.error_rad))
