# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Headers and the pieces of geometry_msgs, shared by every message family."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import CdrWriter

_NS_PER_S = 1_000_000_000


def stamp_from_message(stamp: Any) -> float:
    """
    Return a `builtin_interfaces/Time` in seconds.

    A double resolves 0.24 microseconds at today's UNIX times.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Or any object with the same fields, such as the one `rosbags` decodes to.

    Returns
    -------
    float
        Seconds since the epoch of the clock; 0.0 for a header nobody filled in. Seconds below zero
        are as the message states them: they are before any measurement that counts.

    Raises
    ------
    ValueError
        If its nanoseconds make a second or more: the other seconds cannot be relied on either.

    """
    if not 0 <= stamp.nanosec < _NS_PER_S:
        raise ValueError(
            f'nanosec {stamp.nanosec} of the stamp (sec {stamp.sec}) is not allowed, it must be '
            f'at least 0 and below {_NS_PER_S}'
        )
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def stamp_to_message(stamp_s: float) -> Any:
    """
    Return seconds as a `builtin_interfaces/Time`, rounded to the nearest nanosecond.

    Raises
    ------
    ValueError
        If the stamp is not finite.

    """
    from builtin_interfaces.msg import Time

    sec, nanosec = _split('stamp', stamp_s)
    return Time(sec=sec, nanosec=nanosec)


def _split(name: str, time_s: float) -> tuple[int, int]:
    """Return whole seconds and the nanoseconds that remain."""
    if not abs(time_s) < float('inf'):
        raise ValueError(f'{name} {time_s} s is not finite')
    return divmod(round(time_s * _NS_PER_S), _NS_PER_S)


def write_header(writer: CdrWriter, stamp_s: float, frame_id: str) -> None:
    """
    Write a `std_msgs/Header` with the given stamp (s) and frame.

    Raises
    ------
    ValueError
        If the stamp is not finite.

    """
    write_time(writer, 'stamp', stamp_s)
    writer.string(frame_id)


def write_time(writer: CdrWriter, name: str, time_s: float) -> None:
    """Write a `builtin_interfaces/Time` or `Duration`; `name` is for the error."""
    sec, nanosec = _split(name, time_s)
    writer.int32(sec)
    writer.uint32(nanosec)


def header_to_message(stamp_s: float, frame_id: str) -> Any:
    """Return a `std_msgs/Header` with the given stamp (s) and frame."""
    from std_msgs.msg import Header

    return Header(stamp=stamp_to_message(stamp_s), frame_id=frame_id)


def xyz_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Point or Vector3 as an array of shape (3,)."""
    return np.array([message.x, message.y, message.z], dtype=float)


def xyzw_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Quaternion as an array of shape (4,), scalar last, not normalized."""
    return np.array([message.x, message.y, message.z, message.w], dtype=float)


def point_to_message(xyz: NDArray[np.float64]) -> Any:
    """Return an array of shape (3,) as a Point."""
    from geometry_msgs.msg import Point

    x, y, z = xyz
    return Point(x=float(x), y=float(y), z=float(z))


def vector_to_message(xyz: NDArray[np.float64]) -> Any:
    """Return an array of shape (3,) as a Vector3."""
    from geometry_msgs.msg import Vector3

    x, y, z = xyz
    return Vector3(x=float(x), y=float(y), z=float(z))


def pose_to_message(position_xyz: NDArray[np.float64], xyzw: NDArray[np.float64]) -> Any:
    """Return a position of shape (3,) and a quaternion of shape (4,), scalar last, as a Pose."""
    from geometry_msgs.msg import Pose, Quaternion

    x, y, z, w = xyzw
    return Pose(
        position=point_to_message(position_xyz),
        orientation=Quaternion(x=float(x), y=float(y), z=float(z), w=float(w)),
    )
