# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
An estimate as transforms (REP-105).

A frame has one parent. Where a robot has odometry, that places its body in its odometry frame, so
the estimate places the odometry frame; elsewhere it places the body.
"""

from collections import Counter, deque
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, FrameKind
from dg_localization.fleet.rotations import (
    inverse_quaternion,
    level_rotations,
    quaternion_of,
    quaternion_product,
    rotation_of_quaternion,
)
from dg_localization.ros.interface.poses import BODY_FRAME, frame_id, unique_pose, usable_frame_id
from msg_adapters import OdometryReading
from msg_adapters.transforms import Transform

TRANSFORM_TOPIC = '/tf'
# Some seconds of odometry: longer than an estimate takes.
MOST_POSES = 512
# How far odometry is carried on beyond its last pose, at the speed it had.
MOST_CARRIED_S = 0.2
# Between poses that are farther apart a robot may have been anywhere.
MOST_GAP_S = 0.5


@dataclass(frozen=True, eq=False)
class RigidPose:
    """A position in m, shape (3,), and a unit quaternion, scalar last, of a frame in another."""

    position_m: NDArray[np.float64]
    xyzw: NDArray[np.float64]

    def inverse(self) -> 'RigidPose':
        """Return the pose of the other frame in this one."""
        back = inverse_quaternion(self.xyzw)
        return RigidPose(-rotation_of_quaternion(back) @ self.position_m, back)

    def times(self, other: 'RigidPose') -> 'RigidPose':
        """Return the pose of a frame that has the pose `other` in this one."""
        position_m = self.position_m + rotation_of_quaternion(self.xyzw) @ other.position_m
        return RigidPose(position_m, quaternion_product(self.xyzw, other.xyzw))

    def in_plane(self) -> 'RigidPose':
        """Return the pose without height, roll and pitch."""
        level = level_rotations(rotation_of_quaternion(self.xyzw)[None])[0]
        return RigidPose(np.array([*self.position_m[:2], 0.0]), quaternion_of(level))


def _between(a: RigidPose, b: RigidPose, fraction: float) -> RigidPose:
    """Return the pose on the way from a to b, by slerp; beyond them where it is not in 0 to 1."""
    turn = quaternion_product(inverse_quaternion(a.xyzw), b.xyzw)
    turn = turn if turn[3] >= 0.0 else -turn
    sine = float(np.linalg.norm(turn[:3]))
    angle = fraction * np.arctan2(sine, turn[3])
    axis = turn[:3] / sine if sine > 0.0 else np.zeros(3)
    part = np.array([*(np.sin(angle) * axis), np.cos(angle)])
    return RigidPose(
        a.position_m + fraction * (b.position_m - a.position_m), quaternion_product(a.xyzw, part)
    )


class OdometryPoses:
    """The newest poses of one robot in its odometry frame, and the names of the two frames."""

    def __init__(self) -> None:
        self._stamps_s: deque[float] = deque(maxlen=MOST_POSES)
        self._poses: deque[RigidPose] = deque(maxlen=MOST_POSES)
        self.frame_id = ''
        self.child_frame_id = ''

    def keep(self, reading: OdometryReading, stamp_s: float, restarted_s: float = 0.0) -> None:
        """
        Take one pose, newer than those before.

        Parameters
        ----------
        reading : OdometryReading
        stamp_s : float
        restarted_s : float, optional
            When the odometry last started anew; 0 where it never did.

        """
        frames = _name_of(reading.frame_id), _name_of(reading.child_frame_id)
        is_restarted = bool(self._stamps_s) and self._stamps_s[-1] < restarted_s
        if is_restarted or frames != (self.frame_id, self.child_frame_id):
            # Poses in different frames have nothing between them.
            self._stamps_s.clear()
            self._poses.clear()
        self.frame_id, self.child_frame_id = frames
        xyzw = reading.orientation_xyzw / np.linalg.norm(reading.orientation_xyzw)
        self._stamps_s.append(stamp_s)
        self._poses.append(RigidPose(reading.position_xyz, xyzw))

    def at(self, stamp_s: float) -> RigidPose | None:
        """Return the pose at a time; None where odometry does not reach to it."""
        stamps = np.array(self._stamps_s)
        if len(stamps) < 2 or not stamps[0] <= stamp_s <= stamps[-1] + MOST_CARRIED_S:
            return None
        after = min(max(1, int(np.searchsorted(stamps, stamp_s))), len(stamps) - 1)
        gap_s = stamps[after] - stamps[after - 1]
        if gap_s > MOST_GAP_S:
            return None
        fraction = float((stamp_s - stamps[after - 1]) / gap_s)
        return _between(self._poses[after - 1], self._poses[after], fraction)


def _name_of(frame_id: Any) -> str:
    """Return the name of a frame as tf2 has it; an adapter of somebody else may give anything."""
    return usable_frame_id(str(frame_id))


def transforms(
    estimate: Estimate,
    fixed_frame: str,
    odometry: Mapping[str, OdometryPoses],
    awaited: Collection[str] = (),
) -> tuple[Transform, ...]:
    """
    Return the transforms from the frame of the anchors to the robots of an estimate.

    There are some only while one hypothesis is left, in the frame of the anchors, and for robots
    whose heading is known: any other frame moves or drifts with a robot. A frame that more than
    one robot calls its own is left out, since it can have one place only, and so is one that has
    the name of the frame of the anchors. Where odometry is awaited, its frame is not known, and
    the body must not get a second parent.

    Parameters
    ----------
    estimate : Estimate
    fixed_frame : str
        Name of the frame of the anchors.
    odometry : mapping of str to OdometryPoses
        By robot, where some has come.
    awaited : collection of str
        Robots that have an input of odometry.

    Returns
    -------
    tuple of Transform

    """
    if estimate.frame is None or estimate.frame.kind != FrameKind.ANCHORS:
        return ()
    name = frame_id(estimate.frame, fixed_frame)
    children = {
        robot: _child_of(robot, odometry.get(robot))
        for robot in estimate.robots
        if robot in odometry or robot not in awaited
    }
    times = Counter([name.removeprefix('/'), *children.values()])
    found = (
        _transform(estimate, row, name, children[robot], odometry.get(robot))
        for row, robot in enumerate(estimate.robots)
        if robot in children and times[children[robot]] == 1
    )
    return tuple(transform for transform in found if transform is not None)


def _child_of(robot: str, odometry: OdometryPoses | None) -> str:
    """Return the frame of a robot that has no other parent: its odometry frame, or its body."""
    own = '' if odometry is None else odometry.frame_id or odometry.child_frame_id
    return own or f'{robot}/{BODY_FRAME}'


def _transform(
    estimate: Estimate, row: int, name: str, child: str, odometry: OdometryPoses | None
) -> Transform | None:
    """Return the transform to the odometry frame of a robot, or to its body; None for no place."""
    pose = unique_pose(estimate, row, name)
    if pose is None or not estimate.placements[0].heading_known[row]:
        return None
    placed = RigidPose(pose.position_xyz, pose.orientation_xyzw)
    if odometry is not None and odometry.frame_id:
        body = odometry.at(pose.stamp_s)
        if body is None:
            return None
        if estimate.placements[0].positions_m.shape[1] == 2:
            # The plane is that of the odometry frame: a robot on a ramp does not tilt it.
            body = body.in_plane()
        placed = placed.times(body.inverse())
    return Transform(pose.stamp_s, name, child, placed.position_m, placed.xyzw)
