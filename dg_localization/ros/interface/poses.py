# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
An estimate as poses and transforms (REP-105), and the names of frames.

A frame has one parent. If a robot has odometry, that places its body in its odometry frame, so the
estimate places the odometry frame; otherwise it places the body.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Collection, Mapping

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, FixedFrame, FrameKind, Placement
from dg_localization.fleet.motion import Motion
from dg_localization.fleet.rotations import level_rotations, quaternion_of, rotation_of_quaternion
from dg_localization.fleet.vocabulary import OdometrySample
from msg_adapters import PoseList, UncertainPose
from msg_adapters.poses import Transform

# ROS has no value for an unknown orientation. A zero quaternion is no rotation: viewers accept it,
# and it cannot be mistaken for a heading.
UNKNOWN_ORIENTATION = np.zeros(4)
IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
# ROS has no value for an unknown covariance either. A filter gives no weight to a variance of this
# size, in rad^2, whereas pi^2 would still pull its heading towards zero.
UNKNOWN_VARIANCE_RAD2 = 1e6
# The robot that defines the frame has no error in it. Filters treat a variance of zero as certain,
# and some cannot invert it: one millimeter and one milliradian are small enough.
LEAST_VARIANCE = 1e-6


def feasible_poses(estimate: Estimate, frame_id: str) -> PoseList:
    """
    Return every placement one after the other: pose ``k * n + i`` is robot i in placement k.

    Unknown positions are NaN; the quaternion of an unknown heading is all zeros.
    """
    n_poses = len(estimate.placements) * len(estimate.robots)
    positions = [in_space(placement.positions_m) for placement in estimate.placements]
    orientations = [
        np.where(placement.heading_known[:, None], placement.best_headings[0], UNKNOWN_ORIENTATION)
        for placement in estimate.placements
    ]
    return PoseList(
        stamp_s=estimate.stamp_s,
        frame_id=frame_id,
        positions_m=np.reshape(positions, (n_poses, 3)),
        orientations_xyzw=np.reshape(orientations, (n_poses, 4)),
    )


def unique_pose(
    estimate: Estimate,
    robot: int,
    frame_id: str,
    least_deviation_m: float | None = None,
) -> UncertainPose | None:
    """
    Return the pose of a robot while exactly one hypothesis is left, else None.

    Variances are at least `LEAST_VARIANCE`, which is also the variance of coordinates fixed by the
    plane. An unknown heading is the identity with `UNKNOWN_VARIANCE_RAD2`. If `least_deviation_m`
    states the least standard deviation of a coordinate, the covariance is that of least squares,
    for errors uniform within their bounds. If it is None, or the estimate has no least
    squares, the covariance follows from the bounds.
    """
    if estimate.n_hypotheses != 1 or len(estimate.placements) != 1:
        return None
    placement = estimate.placements[0]
    numbers = placement.positions_m[robot], placement.enclosure_m[robot]
    if not all(np.isfinite(part).all() for part in numbers):
        return None
    known, q = bool(placement.heading_known[robot]), placement.positions_m.shape[1]
    matrix, floor = _enclosing(placement, robot), np.full(6, LEAST_VARIANCE)
    if least_deviation_m is not None and placement.covariances is not None:
        estimated = placement.covariances[robot]
        if np.isfinite(estimated).all():
            matrix, floor[:q] = np.array(estimated), max(LEAST_VARIANCE, least_deviation_m**2)
    turns = slice(5, 6) if q == 2 else slice(3, 6)
    if not known:
        matrix[turns, :] = matrix[:, turns] = 0.0
        matrix[turns, turns] = UNKNOWN_VARIANCE_RAD2 * np.eye(len(matrix[turns]))
    np.fill_diagonal(matrix, np.maximum(matrix.diagonal(), floor))
    return UncertainPose(
        stamp_s=estimate.stamp_s,
        frame_id=frame_id,
        position_xyz=in_space(placement.positions_m[robot]),
        orientation_xyzw=placement.best_headings[0][robot] if known else IDENTITY,
        covariance=matrix,
    )


def _enclosing(placement: Placement, robot: int) -> NDArray[np.float64]:
    """
    Return the greatest covariance within the bounds.

    Its diagonal holds the squares of the greatest distances from the pose to the sides of its
    enclosure: the largest variance of any distribution on the enclosure about the pose.
    """
    position_m = placement.positions_m[robot]
    half_widths_m = np.abs(placement.enclosure_m[robot] - position_m).max(axis=0)
    half_width_rad = float(placement.best_headings[1][robot])
    turns_rad = [0.0, 0.0, half_width_rad] if len(position_m) == 2 else [half_width_rad] * 3
    return np.diag(np.square([*in_space(half_widths_m), *turns_rad]))


def in_space(points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points of shape (..., 2) or (..., 3) with three coordinates, z = 0 in the plane."""
    missing = 3 - points_m.shape[-1]
    return np.pad(points_m, [(0, 0)] * (points_m.ndim - 1) + [(0, missing)])


BODY_FRAME = 'base_link'
SHAPE_FRAME = 'fleet'


LONGEST_FRAME_ID = 255
"""Longer names from messages are not published, nor are unprintable ones."""


def usable_frame_id(name: str) -> str:
    """Return the name of a frame in a message; empty where it cannot be published."""
    # tf2 has no names with a slash at the beginning; ROS 1 had.
    return name.removeprefix('/') if len(name) <= LONGEST_FRAME_ID and name.isprintable() else ''


def check_frame_id(name: str) -> None:
    """Raise ValueError unless `name` can be the name of a frame."""
    if not name or ' ' in name or usable_frame_id(name) != name:
        raise ValueError(
            "it must be the name of a frame, without blanks or a slash, such as 'map'"
        )


def frame_id(frame: FixedFrame | None, fixed_frame: str) -> str:
    """Return the name of a frame by its kind; `fixed_frame` for None."""
    if frame is None or frame.kind == FrameKind.ANCHORS:
        return fixed_frame
    if frame.kind == FrameKind.ODOMETRY:
        return frame.name
    if frame.kind == FrameKind.HEADING:
        return f'{frame.points[0]}/{BODY_FRAME}'
    return SHAPE_FRAME


Track = tuple[OdometrySample, ...]


def transforms(
    estimate: Estimate,
    fixed_frame: str,
    motion: Motion,
    bodies: Mapping[str, str],
    awaited: Collection[str] = (),
) -> tuple[Transform, ...]:
    """
    Return the transforms from the frame of the anchors to the robots of an estimate.

    They exist only while one hypothesis is left, in the frame of the anchors, and for robots with
    a known heading: any other frame moves or drifts with a robot. A frame name that several robots
    use is left out, since a frame has only one place, and so is the name of the frame of the
    anchors. `motion` is the motion of the snapshot, and `bodies` holds the names of body frames in
    it. Robots whose odometry is still `awaited` are left out: their odometry frame is unknown, and
    the body must not get a second parent.
    """
    if estimate.frame is None or estimate.frame.kind != FrameKind.ANCHORS:
        return ()
    name = frame_id(estimate.frame, fixed_frame)
    tracks = {robot: motion.odometry.get(robot, ()) for robot in estimate.robots}
    children = {
        robot: (track and (track[-1].frame or bodies.get(robot))) or f'{robot}/{BODY_FRAME}'
        for robot, track in tracks.items()
        if track or robot not in awaited
    }
    times = Counter([name.removeprefix('/'), *children.values()])
    found = []
    for row, robot in enumerate(estimate.robots):
        pose, track = unique_pose(estimate, row, name), tracks[robot]
        if pose is None or times[children.get(robot, '')] != 1:
            continue
        if not estimate.placements[0].heading_known[row]:
            continue
        position_m, rotation = pose.position_xyz, rotation_of_quaternion(pose.orientation_xyzw)
        if track and track[-1].frame:
            body = _body_at(track, pose.stamp_s)
            if body is None:
                continue
            body_m, turn = body
            if estimate.placements[0].positions_m.shape[1] == 2:
                # The odometry frame stays level, also while the robot is on a ramp.
                body_m, turn = body_m * (1.0, 1.0, 0.0), level_rotations(turn[None])[0]
            rotation = rotation @ turn.T
            position_m = position_m - rotation @ body_m
        quaternion = quaternion_of(rotation)
        found.append(Transform(pose.stamp_s, name, children[robot], position_m, quaternion))
    return tuple(found)


CARRIED_S = 0.2
"""Time for which odometry is extrapolated beyond its last pose, at its last speed."""

LONGEST_GAP_S = 0.5
"""Poses farther apart in time are not interpolated."""


def _body_at(
    track: Track, stamp_s: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Return position and rotation of a body in its odometry frame; None beyond its track."""
    if len(track) < 2 or not track[0].stamp_s <= stamp_s <= track[-1].stamp_s + CARRIED_S:
        return None
    after = bisect_left(track, stamp_s, 1, len(track) - 1, key=lambda reading: reading.stamp_s)
    a, b = track[after - 1], track[after]
    if b.stamp_s - a.stamp_s > LONGEST_GAP_S or a.restarted_s != track[-1].restarted_s:
        return None
    fraction = (stamp_s - a.stamp_s) / (b.stamp_s - a.stamp_s)
    start_m, end_m = a.position_in_frame_m, b.position_in_frame_m
    turn = quaternion_of(a.rotation.T @ b.rotation)
    sine = float(np.linalg.norm(turn[:3]))
    angle_rad = fraction * np.arctan2(sine, turn[3])
    part = np.array([*(np.sin(angle_rad) * turn[:3] / (sine or 1.0)), np.cos(angle_rad)])
    return start_m + fraction * (end_m - start_m), a.rotation @ rotation_of_quaternion(part)
