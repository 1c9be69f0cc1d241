# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Messages of drivers that name who measured whom by ids of their own.

- uwb_ros/RangeStamped (MILUV): one range, with the ids of both radios;
- px4_msgs/SensorUwb (PX4): one range, with the MAC addresses of both radios. Its angles of arrival
  are not read: their signs depend on how the radio is mounted, which the message does not settle;
- nlink_parser/LinktrackNodeframe2, 3 and 5 (Nooploop LinkTrack), from either package that ports
  them: the ranges of one radio to all others. An id there is unique among those of a role only.

Their packages are looked up when a message class is asked for.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import header_of, header_to_message, message_class
from msg_adapters.registry import Adapter, register

RANGE_STAMPED = 'uwb_ros/msg/RangeStamped'
SENSOR_UWB = 'px4_msgs/msg/SensorUwb'
NODE_FRAMES = {
    f'{package}/msg/LinktrackNodeframe{number}': f'{package}/msg/LinktrackNode{row}'
    for package in ('nlink_parser', 'nlink_parser_ros2_interfaces')
    for number, row in ((2, 2), (3, 2), (5, 5))
}


def _no_rays() -> NDArray[np.float64]:
    return np.empty((0, 3))


@dataclass(frozen=True, eq=False)
class IdentifiedReading:
    """
    What one sensor measured of k others at one time, who are named by the ids of a driver.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the message has no stamp.
    observer_id : str
        Who measured; empty where the message does not say so.
    target_ids : tuple of str
        Who was measured, k of them.
    ranges_m : ndarray, shape (k,)
        Distances in m, with the sentinels of REP-117; NaN is no reading.
    rays_xyz : ndarray, shape (k, 3)
        Directions in the frame of the sensor, x forward, y left, z up, of any length; NaN is no
        reading.
    frame_id : str
        Frame of the sensor, as the driver names it.

    """

    stamp_s: float
    observer_id: str
    target_ids: tuple[str, ...]
    ranges_m: NDArray[np.float64]
    rays_xyz: NDArray[np.float64] = field(default_factory=_no_rays)
    frame_id: str = ''

    def __post_init__(self) -> None:
        n_targets = len(self.target_ids)
        if len(self.rays_xyz) == 0:
            object.__setattr__(self, 'rays_xyz', np.full((n_targets, 3), np.nan))
        if self.ranges_m.shape != (n_targets,) or self.rays_xyz.shape != (n_targets, 3):
            shapes = f'{self.ranges_m.shape} and {self.rays_xyz.shape}'
            raise ValueError(
                f'{n_targets} ids need as many ranges and rays, not of shapes {shapes}'
            )


def range_stamped_from_message(message: Any) -> IdentifiedReading:
    """Read a `uwb_ros/RangeStamped`; the ids are the numbers of the radios."""
    return IdentifiedReading(
        **header_of(message),
        observer_id=str(int(message.from_id)),
        target_ids=(str(int(message.to_id)),),
        ranges_m=np.array([float(message.range)]),
    )


def range_stamped_to_message(reading: IdentifiedReading) -> Any:
    """Write a `uwb_ros/RangeStamped`; raise ValueError if there is not exactly one target."""
    message = message_class(RANGE_STAMPED)()
    message.header = header_to_message(reading.stamp_s, reading.frame_id)
    (target_id,), (range_m,) = reading.target_ids, reading.ranges_m
    message.from_id, message.to_id = int(reading.observer_id), int(target_id)
    message.range = float(range_m)
    return message


def sensor_uwb_from_message(message: Any) -> IdentifiedReading:
    """
    Read a `px4_msgs/SensorUwb`; the ids are the MAC addresses as decimal numbers.

    The stamp counts microseconds since the flight controller started, or in ROS time where its
    bridge synchronizes the clocks.
    """
    return IdentifiedReading(
        stamp_s=1e-6 * float(message.timestamp),
        observer_id=str(int(message.mac)),
        target_ids=(str(int(message.mac_dest)),),
        ranges_m=np.array([float(message.distance)]),
    )


def sensor_uwb_to_message(reading: IdentifiedReading) -> Any:
    """Write a `px4_msgs/SensorUwb`; raise ValueError if there is not exactly one target."""
    message = message_class(SENSOR_UWB)()
    message.timestamp = round(1e6 * reading.stamp_s)
    (target_id,), (range_m,) = reading.target_ids, reading.ranges_m
    message.mac, message.mac_dest = int(reading.observer_id), int(target_id)
    message.distance = float(range_m)
    return message


def node_frame_from_message(message: Any) -> IdentifiedReading:
    """
    Read a `LinktrackNodeframe`; an id is ``ROLE:ID``, by the numbers in the message.

    Not all of these frames have a header.
    """
    has_header = hasattr(message, 'header')
    return IdentifiedReading(
        **(header_of(message) if has_header else {'stamp_s': 0.0}),
        observer_id=_role_and_id(message),
        target_ids=tuple(_role_and_id(node) for node in message.nodes),
        ranges_m=np.array([node.dis for node in message.nodes], dtype=float),
    )


def _role_and_id(message: Any) -> str:
    return f'{int(message.role)}:{int(message.id)}'


def node_frame_writer(type_name: str) -> Callable[[IdentifiedReading], Any]:
    """Return the function that writes a `LinktrackNodeframe` of one type."""

    def write(reading: IdentifiedReading) -> Any:
        message = message_class(type_name)()
        message.role, message.id = map(int, reading.observer_id.split(':'))
        if hasattr(message, 'header'):
            message.header = header_to_message(reading.stamp_s, reading.frame_id)
        for target_id, range_m in zip(reading.target_ids, reading.ranges_m, strict=True):
            node = message_class(NODE_FRAMES[type_name])()
            node.role, node.id = map(int, target_id.split(':'))
            node.dis = float(range_m)
            message.nodes.append(node)
        return message

    return write


for _type_name, _read, _write in (
    (RANGE_STAMPED, range_stamped_from_message, range_stamped_to_message),
    (SENSOR_UWB, sensor_uwb_from_message, sensor_uwb_to_message),
    *((name, node_frame_from_message, node_frame_writer(name)) for name in NODE_FRAMES),
):
    register(Adapter(_type_name, IdentifiedReading, _read, _write))
