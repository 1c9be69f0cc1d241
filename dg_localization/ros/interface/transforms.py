# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
An estimate as transforms (REP-105).

A frame has one parent. Where a robot has odometry, that places its body in its odometry frame, so
the estimate places the odometry frame; elsewhere it places the body.
"""

from collections import Counter, deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, FrameKind
from dg_localization.fleet.rotations import (
    inverse_quaternion,
    quaternion_product,
    rotation_of_quaternion,
)
from dg_localization.ros.interface.frames import BODY_FRAME, frame_id
from dg_localization.ros.interface.poses import unique_pose
from msg_adapters import OdometryReading, UncertainPose
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
        # An adapter of somebody else may give anything.
        frames = str(reading.frame_id), str(reading.child_frame_id)
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


def transforms(
    estimate: Estimate, fixed_frame: str, odometry: Mapping[str, OdometryPoses]
) -> tuple[Transform, ...]:
    """
    Return the transforms from the frame of the anchors to the robots of an estimate.

    There are some only while one hypothesis is left, in the frame of the anchors, and for robots
    whose heading is known: any other frame moves or drifts with a robot. A frame that more than
    one robot calls its own is left out, since it can have one place only, and so is one that has
    the name of the frame of the anchors.

    Parameters
    ----------
    estimate : Estimate
    fixed_frame : str
        Name of the frame of the anchors.
    odometry : mapping of str to OdometryPoses
        By robot, where it has odometry.

    Returns
    -------
    tuple of Transform

    """
    if estimate.frame is None or estimate.frame.kind != FrameKind.ANCHORS:
        return ()
    name = frame_id(estimate.frame, fixed_frame)
    found = list(_placed(estimate, name, odometry))
    times = Counter(transform.child_frame_id for transform in found)
    return tuple(entry for entry in found if times[entry.child_frame_id] == 1)


def _placed(
    estimate: Estimate, name: str, odometry: Mapping[str, OdometryPoses]
) -> Iterator[Transform]:
    for row, robot in enumerate(estimate.robots):
        pose = unique_pose(estimate, row, name)
        if pose is None or not estimate.placements[0].heading_known[row]:
            continue
        transform = _transform(pose, robot, odometry.get(robot))
        if transform is not None:
            yield transform


def _transform(
    pose: UncertainPose, robot: str, odometry: OdometryPoses | None
) -> Transform | None:
    """Return the transform to the odometry frame of a robot, or to its body."""
    placed, child = RigidPose(pose.position_xyz, pose.orientation_xyzw), f'{robot}/{BODY_FRAME}'
    if odometry is not None and odometry.frame_id:
        body = odometry.at(pose.stamp_s)
        if body is None:
            return None
        placed, child = placed.times(body.inverse()), odometry.frame_id
    elif odometry is not None and odometry.child_frame_id:
        child = odometry.child_frame_id
    if child == pose.frame_id:
        return None
    return Transform(pose.stamp_s, pose.frame_id, child, placed.position_m, placed.xyzw)
