# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""geometry_msgs/PointStamped <-> `ElevationReading`, of which z alone is read."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from msg_adapters.geometry import point_to_message
from msg_adapters.headers import header_to_message, stamp_from_message

TYPE_NAME = 'geometry_msgs/msg/PointStamped'


@dataclass(frozen=True)
class ElevationReading:
    """
    One reading of how high a robot or a sensor is.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    elevation_m : float
        In m, z up (REP-103): a depth is negative.
    frame_id : str
        Frame of the reading.

    """

    stamp_s: float
    elevation_m: float
    frame_id: str = ''


def elevation_from_message(message: Any) -> ElevationReading:
    """Read the z of a `geometry_msgs/PointStamped`."""
    return ElevationReading(
        stamp_s=stamp_from_message(message.header.stamp),
        elevation_m=float(message.point.z),
        frame_id=message.header.frame_id,
    )


def elevation_to_message(reading: ElevationReading) -> Any:
    """Write a `geometry_msgs/PointStamped`."""
    from geometry_msgs.msg import PointStamped

    return PointStamped(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        point=point_to_message(np.array([0.0, 0.0, reading.elevation_m])),
    )
