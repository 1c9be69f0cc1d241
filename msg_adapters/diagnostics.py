# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""diagnostic_msgs/DiagnosticArray <-> `Diagnostics`."""

from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from msg_adapters.headers import CdrWriter, stamp_from_message
from msg_adapters.registry import register_cdr

TYPE_NAME = 'diagnostic_msgs/msg/DiagnosticArray'


class Level(IntEnum):
    """Level of a status, with the numbers of `diagnostic_msgs/DiagnosticStatus`."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """
    The state of one part of the system.

    Attributes
    ----------
    level : Level
        The level of its state.
    name : str
        The name of the part, unique on the robot.
    message : str
        One sentence.
    hardware_id : str
        The device it belongs to.
    values : dict of str to str
        Values, in the order of display.

    """

    level: Level
    name: str
    message: str
    hardware_id: str = ''
    values: dict[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Diagnostics:
    """States of several parts at one time (`stamp_s`, in s)."""

    stamp_s: float
    statuses: tuple[Status, ...]


def diagnostics_from_message(message: Any) -> Diagnostics:
    """
    Read a `diagnostic_msgs/DiagnosticArray`.

    The level may be a byte string, as in rclpy, or a number, as in `rosbags`.

    Raises
    ------
    ValueError
        If a level is not one of the four the message defines.

    """
    return Diagnostics(
        stamp_s=stamp_from_message(message.header.stamp),
        statuses=tuple(_status_from_message(status) for status in message.status),
    )


def diagnostics_to_cdr(diagnostics: Diagnostics) -> bytes:
    """Write a serialized `diagnostic_msgs/DiagnosticArray`."""
    writer = CdrWriter('hI', (diagnostics.stamp_s, ''), len(diagnostics.statuses))
    for status in diagnostics.statuses:
        texts = status.name, status.message, status.hardware_id
        writer.write('BsssI', status.level, *texts, len(status.values))
        for entry in status.values.items():
            writer.write('ss', *entry)
    return writer.to_bytes()


def _status_from_message(status: Any) -> Status:
    level = status.level[0] if isinstance(status.level, bytes) else status.level
    return Status(
        level=Level(level),
        name=status.name,
        message=status.message,
        hardware_id=status.hardware_id,
        values={entry.key: entry.value for entry in status.values},
    )


register_cdr(TYPE_NAME, Diagnostics, diagnostics_from_message, diagnostics_to_cdr)
