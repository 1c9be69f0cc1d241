# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Poses.

- geometry_msgs/PoseArray <-> `PoseList`;
- geometry_msgs/PoseWithCovarianceStamped <-> `UncertainPose`;
- a list of `Transform`, one for each frame, -> tf2_msgs/TFMessage.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import CdrWriter, header_of, to_cdr, xyz_from_message, xyzw_from_message
from msg_adapters.registry import register_cdr

POSE_ARRAY = 'geometry_msgs/msg/PoseArray'
POSE_WITH_COVARIANCE = 'geometry_msgs/msg/PoseWithCovarianceStamped'


@dataclass(frozen=True, eq=False)
class PoseList:
    """
    Poses in one frame at one time.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id : str
        Frame the poses are given in.
    positions_m : ndarray, shape (k, 3)
        Positions in m.
    orientations_xyzw : ndarray, shape (k, 4)
        Quaternions, scalar last.

    """

    stamp_s: float
    frame_id: str
    positions_m: NDArray[np.float64]
    orientations_xyzw: NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class UncertainPose:
    """
    One pose with a covariance.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id : str
        Frame the pose is given in.
    position_xyz : ndarray, shape (3,)
        Position in m.
    orientation_xyzw : ndarray, shape (4,)
        Quaternion, scalar last.
    covariance : ndarray, shape (6, 6)
        Over x, y, z (m) and the rotations about the fixed x, y, z axes (rad).

    """

    stamp_s: float
    frame_id: str
    position_xyz: NDArray[np.float64]
    orientation_xyzw: NDArray[np.float64]
    covariance: NDArray[np.float64]


def pose_array_from_message(message: Any) -> PoseList:
    """Read a `geometry_msgs/PoseArray`; an empty one gives arrays of shape (0, 3) and (0, 4)."""
    positions = [xyz_from_message(pose.position) for pose in message.poses]
    orientations = [xyzw_from_message(pose.orientation) for pose in message.poses]
    return PoseList(
        **header_of(message),
        positions_m=np.reshape(positions, (-1, 3)),
        orientations_xyzw=np.reshape(orientations, (-1, 4)),
    )


def pose_array_to_cdr(poses: PoseList) -> bytes:
    """
    Write a serialized `geometry_msgs/PoseArray`.

    Raises
    ------
    ValueError
        If there are not as many orientations as positions.

    """
    rows = np.concatenate([poses.positions_m, poses.orientations_xyzw], axis=1)
    return to_cdr('hId', (poses.stamp_s, poses.frame_id), len(rows), rows)


def uncertain_pose_to_cdr(estimate: UncertainPose) -> bytes:
    """
    Write a serialized `geometry_msgs/PoseWithCovarianceStamped`.

    Raises
    ------
    ValueError
        If the covariance is not of shape (6, 6).

    """
    if np.shape(estimate.covariance) != (6, 6):
        raise ValueError(f'covariance has shape {np.shape(estimate.covariance)}, not (6, 6)')
    pose = estimate.position_xyz, estimate.orientation_xyzw
    return to_cdr('hddd', (estimate.stamp_s, estimate.frame_id), *pose, estimate.covariance)


def uncertain_pose_from_message(message: Any) -> UncertainPose:
    """Read a `geometry_msgs/PoseWithCovarianceStamped`."""
    pose = message.pose.pose
    return UncertainPose(
        **header_of(message),
        position_xyz=xyz_from_message(pose.position),
        orientation_xyzw=xyzw_from_message(pose.orientation),
        covariance=np.array(message.pose.covariance, dtype=float).reshape(6, 6),
    )


@dataclass(frozen=True, eq=False)
class Transform:
    """
    The pose of a frame in another frame.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id, child_frame_id : str
        Parent frame and child frame.
    translation_m : ndarray, shape (3,)
        Origin of the child in the parent.
    rotation_xyzw : ndarray, shape (4,)
        Quaternion from child to parent, scalar last.

    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    translation_m: NDArray[np.float64]
    rotation_xyzw: NDArray[np.float64]


def transforms_to_cdr(transforms: Sequence[Transform]) -> bytes:
    """Write a serialized `tf2_msgs/TFMessage`."""
    writer = CdrWriter('I', len(transforms))
    for transform in transforms:
        header, place = (transform.stamp_s, transform.frame_id), transform.translation_m
        writer.write('hsdd', header, transform.child_frame_id, place, transform.rotation_xyzw)
    return writer.to_bytes()


pose_array_to_message = register_cdr(
    POSE_ARRAY, PoseList, pose_array_from_message, pose_array_to_cdr
)
register_cdr(
    POSE_WITH_COVARIANCE, UncertainPose, uncertain_pose_from_message, uncertain_pose_to_cdr
)
