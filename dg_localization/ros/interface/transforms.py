# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
An estimate as transforms (REP-105).

A frame has one parent. Where a robot has odometry, that places its body in its odometry frame, so
the estimate places the odometry frame; elsewhere it places the body.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, FrameKind
from dg_localization.fleet.rotations import (
    level_rotations,
    quaternion_of,
    rotation_of_quaternion,
)
from dg_localization.fleet.vocabulary import OdometryReading
from dg_localization.ros.interface.poses import BODY_FRAME, frame_id, unique_pose
from msg_adapters.poses import Transform

# How far odometry is carried on beyond its last pose, at the speed it had.
MOST_CARRIED_S = 0.2
# Between poses that are farther apart a robot may have been anywhere.
MOST_GAP_S = 0.5

Tracks = Mapping[str, Sequence[OdometryReading]]


def transforms(
    estimate: Estimate,
    fixed_frame: str,
    odometry: Tracks,
    bodies: Mapping[str, str],
    awaited: Collection[str] = (),
) -> tuple[Transform, ...]:
    """
    Return the transforms from the frame of the anchors to the robots of an estimate.

    There are some only while one hypothesis is left, in the frame of the anchors, and for robots
    whose heading is known: any other frame moves or drifts with a robot. A frame that more than
    one robot calls its own is left out, since it can have one place only, and so is one that has
    the name of the frame of the anchors. `odometry` is that of the snapshot of the estimate, and
    `bodies` has the names that it gives the frames of bodies. Before odometry that is `awaited`
    delivers, its frame is not known, and the body must not get a second parent.
    """
    if estimate.frame is None or estimate.frame.kind != FrameKind.ANCHORS:
        return ()
    name = frame_id(estimate.frame, fixed_frame)
    tracks = {robot: odometry.get(robot, ()) for robot in estimate.robots}
    children = {
        robot: (track and (track[-1].frame or bodies.get(robot))) or f'{robot}/{BODY_FRAME}'
        for robot, track in tracks.items()
        if track or robot not in awaited
    }
    times = Counter([name.removeprefix('/'), *children.values()])
    found = (
        _transform(estimate, row, name, children[robot], tracks[robot])
        for row, robot in enumerate(estimate.robots)
        if robot in children and times[children[robot]] == 1
    )
    return tuple(transform for transform in found if transform is not None)


def _transform(
    estimate: Estimate, row: int, name: str, child: str, track: Sequence[OdometryReading]
) -> Transform | None:
    """Return the transform to the odometry frame of a robot, or to its body; None for no place."""
    pose = unique_pose(estimate, row, name)
    if pose is None or not estimate.placements[0].heading_known[row]:
        return None
    position_m, rotation = pose.position_xyz, rotation_of_quaternion(pose.orientation_xyzw)
    if track and track[-1].frame:
        body = _body_at(track, pose.stamp_s)
        if body is None:
            return None
        body_m, turn = body
        if estimate.placements[0].positions_m.shape[1] == 2:
            # The plane is that of the odometry frame: a robot on a ramp does not tilt it.
            body_m, turn = body_m * (1.0, 1.0, 0.0), level_rotations(turn[None])[0]
        rotation = rotation @ turn.T
        position_m = position_m - rotation @ body_m
    return Transform(pose.stamp_s, name, child, position_m, quaternion_of(rotation))


def _body_at(
    track: Sequence[OdometryReading], stamp_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return position and rotation of a body in its odometry frame, None where that ends."""
    if len(track) < 2 or not track[0].stamp_s <= stamp_s <= track[-1].stamp_s + MOST_CARRIED_S:
        return None
    after = bisect_left(track, stamp_s, 1, len(track) - 1, key=lambda reading: reading.stamp_s)
    a, b = track[after - 1], track[after]
    if b.stamp_s - a.stamp_s > MOST_GAP_S or a.restarted_s != b.restarted_s:
        return None
    fraction = (stamp_s - a.stamp_s) / (b.stamp_s - a.stamp_s)
    start_m, end_m = a.position_in_frame_m, b.position_in_frame_m
    turn = quaternion_of(a.rotation.T @ b.rotation)
    sine = float(np.linalg.norm(turn[:3]))
    angle_rad = fraction * np.arctan2(sine, turn[3])
    part = np.array([*(np.sin(angle_rad) * turn[:3] / (sine or 1.0)), np.cos(angle_rad)])
    return start_m + fraction * (end_m - start_m), a.rotation @ rotation_of_quaternion(part)
