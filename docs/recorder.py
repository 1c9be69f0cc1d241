# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A rosbag2 written reading by reading, without ROS: for the examples that convert other recordings.

It takes numpy and the package rosbags.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

NS_PER_S = 1_000_000_000
STORE = get_typestore(Stores.ROS2_JAZZY)
TYPES = STORE.types

RANGE = 'sensor_msgs/msg/Range'
BEARING = 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseStamped'


class Recorder:
    """
    Writes the inputs of the localizer, on the topics that it listens to by default.

    Messages are kept until `write`, which sorts them: a bag must be in the order of time, and the
    readings of a recording may come file by file.
    """

    def __init__(self) -> None:
        self._messages: list[tuple[int, str, str, Any]] = []

    def add_range(
        self, observer: str, target: str, range_m: float, stamp_s: float, received_s: float
    ) -> None:
        """Add a range in m, measured at `stamp_s` and received at `received_s`."""
        # Zero limits are those that were not given.
        message = TYPES[RANGE](_header(stamp_s, observer), 0, 0.0, 0.0, 0.0, range_m, 0.0)
        self._add(f'/{observer}/range/{target}', RANGE, message, received_s)

    def add_bearing(
        self, observer: str, target: str, bearing_rad: float, stamp_s: float, received_s: float
    ) -> None:
        """Add a bearing in the plane, positive to the left."""
        ray = TYPES['geometry_msgs/msg/Vector3'](math.cos(bearing_rad), math.sin(bearing_rad), 0.0)
        message = TYPES[BEARING](_header(stamp_s, observer), ray)
        self._add(f'/{observer}/bearing/{target}', BEARING, message, received_s)

    def add_odometry(
        self, robot: str, place_m: Sequence[float], yaw_rad: float, stamp_s: float
    ) -> None:
        """Add a pose that odometry led to, in the frame where it began."""
        zeros = np.zeros(36)
        zero = TYPES['geometry_msgs/msg/Vector3'](0.0, 0.0, 0.0)
        message = TYPES[ODOMETRY](
            _header(stamp_s, f'{robot}/odom'),
            robot,
            TYPES['geometry_msgs/msg/PoseWithCovariance'](_pose(place_m, yaw_rad), zeros),
            TYPES['geometry_msgs/msg/TwistWithCovariance'](
                TYPES['geometry_msgs/msg/Twist'](zero, zero), zeros
            ),
        )
        self._add(f'/{robot}/odom', ODOMETRY, message, stamp_s)

    def add_truth(
        self, robot: str, place_m: Sequence[float], yaw_rad: float, stamp_s: float
    ) -> None:
        """Add where a robot truly was; the localizer does not listen to that."""
        message = TYPES[POSE](_header(stamp_s, 'map'), _pose(place_m, yaw_rad))
        self._add(f'/{robot}/truth', POSE, message, stamp_s)

    def write(self, path: Path) -> None:
        """Write the bag, a folder that does not exist."""
        connections: dict[str, Any] = {}
        with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
            for time_ns, topic, type_name, message in sorted(self._messages, key=itemgetter(0)):
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, type_name, typestore=STORE)
                data = STORE.serialize_cdr(message, type_name)
                writer.write(connections[topic], time_ns, data)

    def _add(self, topic: str, type_name: str, message: Any, received_s: float) -> None:
        self._messages.append((round(received_s * NS_PER_S), topic, type_name, message))


def _header(stamp_s: float, frame_id: str) -> Any:
    stamp = TYPES['builtin_interfaces/msg/Time'](*divmod(round(stamp_s * NS_PER_S), NS_PER_S))
    return TYPES['std_msgs/msg/Header'](stamp, frame_id)


def _pose(place_m: Sequence[float], yaw_rad: float) -> Any:
    x, y, *rest = map(float, place_m)
    turn = TYPES['geometry_msgs/msg/Quaternion'](
        0.0, 0.0, math.sin(yaw_rad / 2.0), math.cos(yaw_rad / 2.0)
    )
    point = TYPES['geometry_msgs/msg/Point'](x, y, *rest or (0.0,))
    return TYPES['geometry_msgs/msg/Pose'](point, turn)


def anchors_yaml(anchors_m: Iterable[tuple[str, Sequence[float]]], bound_m: float) -> str:
    """Return the anchors as parameters of the localizer, indented for `ros__parameters`."""
    anchors = list(anchors_m)
    names = ', '.join(f"'{name}'" for name, _ in anchors)
    lines = ['    anchors:', f'      names: [{names}]', f'      bound: {bound_m}']
    for name, place_m in anchors:
        places = ', '.join(f'{value:.6f}' for value in map(float, place_m))
        lines.append(f'      {name}: {{position: [{places}]}}')
    return '\n'.join(lines) + '\n'
