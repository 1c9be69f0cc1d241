# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""geometry_msgs/Vector3Stamped <-> `BearingReading`, a ray in the observer's body frame."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.geometry import vector_to_message, xyz_from_message
from msg_adapters.headers import header_to_message, stamp_from_message

TYPE_NAME = 'geometry_msgs/msg/Vector3Stamped'


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
    """Read a `geometry_msgs/Vector3Stamped`; the ray is passed on as it is, even a zero one."""
    return BearingReading(
        stamp_s=stamp_from_message(message.header.stamp),
        ray_xyz=xyz_from_message(message.vector),
        frame_id=message.header.frame_id,
    )


def bearing_to_message(reading: BearingReading) -> Any:
    """Write a `geometry_msgs/Vector3Stamped`."""
    from geometry_msgs.msg import Vector3Stamped

    return Vector3Stamped(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        vector=vector_to_message(reading.ray_xyz),
    )
