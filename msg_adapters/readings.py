# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Messages of one reading each <-> plain values.

- sensor_msgs/Range <-> `RangeReading`, with the sentinel values of REP-117;
- geometry_msgs/Vector3Stamped <-> `BearingReading`, a ray in the observer's body frame;
- nav_msgs/Odometry <-> `OdometryReading`, pose only: velocities and covariances are left out;
- geometry_msgs/PointStamped <-> `ElevationReading`, z only.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import header_of, to_cdr, xyz_from_message, xyzw_from_message
from msg_adapters.registry import register_cdr

RANGE = 'sensor_msgs/msg/Range'
BEARING = 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
ELEVATION = 'geometry_msgs/msg/PointStamped'


@dataclass(frozen=True)
class RangeReading:
    """
    One distance reading.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    range_m : float
        Distance in m as reported. REP-117: NaN is no reading, +inf is nothing
        within `max_range_m`, -inf is closer than `min_range_m`.
    min_range_m, max_range_m : float or None
        Limits of the sensor in m; None if the message does not give them.
    variance_m2 : float or None
        Variance in m^2; None if the message does not give it.
    frame_id : str
        Frame of the sensor. It does not identify the target.

    """

    stamp_s: float
    range_m: float
    min_range_m: float | None = None
    max_range_m: float | None = None
    variance_m2: float | None = None
    frame_id: str = ''


def range_from_message(message: Any) -> RangeReading:
    """
    Read a `sensor_msgs/Range`.

    Equal limits of zero and a variance of zero mean "not given", since some
    drivers fill in the range only.

    Parameters
    ----------
    message : sensor_msgs.msg.Range
        Or any object with the same fields; `variance` may be missing, as in
        recordings older than Jazzy.

    """
    limits_given = message.min_range != 0.0 or message.max_range != 0.0
    variance_m2 = float(getattr(message, 'variance', 0.0))
    return RangeReading(
        **header_of(message),
        range_m=float(message.range),
        min_range_m=float(message.min_range) if limits_given else None,
        max_range_m=float(message.max_range) if limits_given else None,
        variance_m2=variance_m2 if variance_m2 != 0.0 else None,
    )


def range_to_cdr(reading: RangeReading) -> bytes:
    """
    Write a serialized `sensor_msgs/Range`.

    `radiation_type` stays at its default: the message has no value for radio.
    The fields are 32 bit floats, so a range of 8 m is rounded to 0.5 micrometers.
    """
    limits_m = reading.min_range_m or 0.0, reading.max_range_m or 0.0
    numbers = 0.0, *limits_m, reading.range_m, reading.variance_m2 or 0.0
    return to_cdr('hBf', (reading.stamp_s, reading.frame_id), 0, numbers)


@dataclass(frozen=True, eq=False)
class BearingReading:
    """
    One direction reading.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    ray_xyz : ndarray, shape (3,)
        Direction in the observer's body frame (x forward, y left, z up, REP-103), of any length.
    frame_id : str
        Frame of the ray.

    """

    stamp_s: float
    ray_xyz: NDArray[np.float64]
    frame_id: str = ''


def bearing_from_message(message: Any) -> BearingReading:
    """Read a `geometry_msgs/Vector3Stamped`; the ray is unchanged, even if it is zero."""
    return BearingReading(**header_of(message), ray_xyz=xyz_from_message(message.vector))


def bearing_to_cdr(reading: BearingReading) -> bytes:
    """Write a serialized `geometry_msgs/Vector3Stamped`."""
    return to_cdr('hd', (reading.stamp_s, reading.frame_id), reading.ray_xyz)


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
        **header_of(message),
        position_xyz=xyz_from_message(pose.position),
        orientation_xyzw=xyzw_from_message(pose.orientation),
        child_frame_id=message.child_frame_id,
    )


def odometry_to_cdr(reading: OdometryReading) -> bytes:
    """Write a serialized `nav_msgs/Odometry` with zero twist and zero covariances."""
    header, rest = (reading.stamp_s, reading.frame_id), np.zeros(36 + 6 + 36)
    pose = reading.position_xyz, reading.orientation_xyzw
    return to_cdr('hsddd', header, reading.child_frame_id, *pose, rest)


@dataclass(frozen=True)
class ElevationReading:
    """
    One reading of the elevation of a robot or a sensor.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    elevation_m : float
        Elevation in m, z up (REP-103): a depth is negative.
    frame_id : str
        Frame of the reading.

    """

    stamp_s: float
    elevation_m: float
    frame_id: str = ''


def elevation_from_message(message: Any) -> ElevationReading:
    """Read the z of a `geometry_msgs/PointStamped`."""
    return ElevationReading(**header_of(message), elevation_m=float(message.point.z))


def elevation_to_cdr(reading: ElevationReading) -> bytes:
    """Write a serialized `geometry_msgs/PointStamped`."""
    return to_cdr('hd', (reading.stamp_s, reading.frame_id), [0.0, 0.0, reading.elevation_m])


range_to_message = register_cdr(RANGE, RangeReading, range_from_message, range_to_cdr)
bearing_to_message = register_cdr(BEARING, BearingReading, bearing_from_message, bearing_to_cdr)
odometry_to_message = register_cdr(
    ODOMETRY, OdometryReading, odometry_from_message, odometry_to_cdr
)
register_cdr(ELEVATION, ElevationReading, elevation_from_message, elevation_to_cdr)
