# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Messages of drivers that name observer and targets by their own ids.

- uwb_ros/RangeStamped (MILUV): one range, with the ids of both radios;
- px4_msgs/SensorUwb (PX4): one range, with the MAC addresses of both radios as decimal numbers.
  Its stamp counts microseconds since the flight controller started, or in ROS time if its bridge
  synchronizes the clocks. Its angles of arrival are not read: their signs depend on the mounting
  of the radio, which the message does not define;
- nlink_parser/LinktrackNodeframe2, 3 and 5 (Nooploop LinkTrack), from either package that ports
  them: the ranges of one radio to all others. An id there is unique among those of a role only, so
  it is ``ROLE:ID``. Frames 3 and 5 have no header.

Their packages are imported when a message class is needed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from msg_adapters.headers import header_of, header_to_message, message_class
from msg_adapters.registry import Adapter, register


class Form(NamedTuple):
    """
    The names of the fields of a message type; an id is one number or several.

    `row_type` is the type of its `nodes`; without `nodes` it has one range beside the ids.
    """

    observer: tuple[str, ...]
    target: tuple[str, ...]
    distance: str
    row_type: str = ''


ROLE_AND_ID = ('role', 'id')
FORMS = {
    'uwb_ros/msg/RangeStamped': Form(('from_id',), ('to_id',), 'range'),
    'px4_msgs/msg/SensorUwb': Form(('mac',), ('mac_dest',), 'distance'),
    **{
        f'{package}/msg/LinktrackNodeframe{number}': Form(
            ROLE_AND_ID, ROLE_AND_ID, 'dis', f'{package}/msg/LinktrackNode{row}'
        )
        for package in ('nlink_parser', 'nlink_parser_ros2_interfaces')
        for number, row in ((2, 2), (3, 2), (5, 5))
    },
}


@dataclass(frozen=True, eq=False)
class IdentifiedReading:
    """
    The measurements of k targets by one sensor at one time, named by the ids of a driver.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 if the message has no stamp.
    observer_id : str
        The observer; empty if the message does not name it.
    target_ids : tuple of str
        The k targets.
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
    rays_xyz: NDArray[np.float64] = field(default_factory=lambda: np.empty((0, 3)))
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


def _id_of(message: Any, fields: Sequence[str]) -> str:
    """Return an id composed of its numbers."""
    return ':'.join(str(int(getattr(message, name))) for name in fields)


def _set_id(message: Any, fields: Sequence[str], text: str) -> None:
    for name, number in zip(fields, text.split(':'), strict=True):
        setattr(message, name, int(number))


def _read(form: Form, message: Any) -> IdentifiedReading:
    """Read a message, with a header, a time in microseconds, or neither."""
    rows = message.nodes if form.row_type else [message]
    stamp = {'stamp_s': 1e-6 * float(getattr(message, 'timestamp', 0.0))}
    return IdentifiedReading(
        **(header_of(message) if hasattr(message, 'header') else stamp),
        observer_id=_id_of(message, form.observer),
        target_ids=tuple(_id_of(row, form.target) for row in rows),
        ranges_m=np.array([float(getattr(row, form.distance)) for row in rows]),
    )


def _write(type_name: str, form: Form, reading: IdentifiedReading) -> Any:
    """Write a message; raise ValueError if a message of one range has not one target."""
    message = message_class(type_name)()
    if hasattr(message, 'header'):
        message.header = header_to_message(reading.stamp_s, reading.frame_id)
    if hasattr(message, 'timestamp'):
        message.timestamp = round(1e6 * reading.stamp_s)
    _set_id(message, form.observer, reading.observer_id)
    rows = [message]
    if form.row_type:
        rows = message.nodes = [message_class(form.row_type)() for _ in reading.target_ids]
    for row, name, range_m in zip(rows, reading.target_ids, reading.ranges_m, strict=True):
        _set_id(row, form.target, name)
        setattr(row, form.distance, float(range_m))
    return message


for _name, _form in FORMS.items():
    register(
        Adapter(_name, IdentifiedReading, partial(_read, _form), partial(_write, _name, _form))
    )
