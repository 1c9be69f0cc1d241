# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""nav_msgs/Odometry <-> `OdometryReading`, pose only: velocities and covariances are left out."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.geometry import pose_to_message, xyz_from_message, xyzw_from_message
from msg_adapters.headers import header_to_message, stamp_from_message

TYPE_NAME = 'nav_msgs/msg/Odometry'


@dataclass(frozen=True, eq=False)
class OdometryReading:
    """
    One odometry pose.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    position_xyz : ndarray, shape (3,)
        Position in the odometry frame in m.
    orientation_xyzw : ndarray, shape (4,)
        Quaternion, scalar last, as reported: not normalized, not checked.
    frame_id, child_frame_id : str
        Odometry frame and body frame.

    """

    stamp_s: float
    position_xyz: NDArray[np.float64]
    orientation_xyzw: NDArray[np.float64]
    frame_id: str = ''
    child_frame_id: str = ''


def odometry_from_message(message: Any) -> OdometryReading:
    """Read a `nav_msgs/Odometry`."""
    pose = message.pose.pose
    return OdometryReading(
        stamp_s=stamp_from_message(message.header.stamp),
        position_xyz=xyz_from_message(pose.position),
        orientation_xyzw=xyzw_from_message(pose.orientation),
        frame_id=message.header.frame_id,
        child_frame_id=message.child_frame_id,
    )


def odometry_to_message(reading: OdometryReading) -> Any:
    """Write a `nav_msgs/Odometry` with zero twist and zero covariances."""
    from geometry_msgs.msg import PoseWithCovariance
    from nav_msgs.msg import Odometry

    pose = pose_to_message(reading.position_xyz, reading.orientation_xyzw)
    return Odometry(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        child_frame_id=reading.child_frame_id,
        pose=PoseWithCovariance(pose=pose),
    )
