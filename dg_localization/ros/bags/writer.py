# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A new rosbag2, in .mcap, by the package rosbags: equal messages give equal bytes."""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
import shutil
import sqlite3
from textwrap import wrap
from typing import Any

import numpy as np
from rclpy.qos import QoSProfile

from dg_localization.ros.executables import ExecutableError

COLUMNS = 98

# How rosbag2 writes a duration without limit.
FOREVER = (2**31 - 1, 2**32 - 1)


class BagWriter:
    """Writes serialized messages with an open writer of rosbags; `new_bag` makes one."""

    def __init__(self, writer: Any, path: Path) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.is_empty = True
        self._writer = writer
        self._path = path
        self._types = get_typestore(Stores.ROS2_JAZZY)
        self._connections: dict[str, Any] = {}

    def add_output(self, topic: str, message_class: type, profile: QoSProfile) -> None:
        """Add a topic, offered with `profile` when the bag is played."""
        package = message_class.__module__.partition('.')[0]
        self._connections[topic] = self._writer.add_connection(
            topic,
            f'{package}/msg/{message_class.__name__}',
            typestore=self._types,
            offered_qos_profiles=[_recorded_qos(profile)],
        )

    def write(self, topic: str, time_ns: int, data: bytes) -> None:
        """Write a serialized message on a topic that was added."""
        with writing(self._path):
            self._writer.write(self._connections[topic], time_ns, data)
        self.is_empty = False


@contextmanager
def new_bag(path: Path) -> Iterator[BagWriter]:
    """Make a bag; whatever ends the block, the answers that were written are kept."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    # Version 9 is Jazzy's.
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    with writing(path):
        writer.open()
    bag_writer = BagWriter(writer, path)
    try:
        yield bag_writer
    except BaseException:
        if bag_writer.is_empty:
            writer.abort()
            shutil.rmtree(path, ignore_errors=True)
        else:
            # On a full disk the end cannot be written either; what is there is left as it is.
            with suppress(OSError, sqlite3.Error):
                writer.close()
        raise
    with writing(path):
        writer.close()


def write_text(path: Path, text: str) -> None:
    """Write a file, such as a report."""
    with writing(path):
        path.write_text(text, encoding='utf-8')


def parameters_text(comments: Iterable[str], parameters: Mapping[str, Any]) -> str:
    """Return a file of parameters of the node; sections without any are left out."""
    lines = [
        line for text in comments for line in wrap(f'# {text}', COLUMNS, subsequent_indent='#   ')
    ]
    return '\n'.join([*lines, '/**:', '  ros__parameters:', *_yaml(parameters, '    ')])


def _yaml(tree: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, value in tree.items():
        if isinstance(value, Mapping) and value:
            yield f'{indent}{name}:'
            yield from _yaml(value, f'{indent}  ')
        elif isinstance(value, list) and value and isinstance(value[0], str):
            yield f'{indent}{name}:'
            yield from (f"{indent}  - '{text}'" for text in value)
        elif value or isinstance(value, float):
            yield f'{indent}{name}: {yaml_value(value)}'


def yaml_value(value: Any) -> str:
    """Return a value; a number is read as one with a fraction, and as the same."""
    if isinstance(value, list):
        return f'[{", ".join(map(yaml_value, value))}]'
    return np.format_float_positional(value, trim='0')


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Name what cannot be written: a full disk does not."""
    try:
        yield
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, 'strerror', None) or error
        raise ExecutableError(f'{path} cannot be written: {reason}') from error


def _recorded_qos(profile: QoSProfile) -> Any:
    """Return a profile as a bag keeps it."""
    from rosbags import interfaces

    forever = interfaces.QosTime(*FOREVER)
    return interfaces.Qos(
        history=interfaces.QosHistory.KEEP_LAST,
        depth=profile.depth,
        reliability=interfaces.QosReliability[profile.reliability.name],
        durability=interfaces.QosDurability[profile.durability.name],
        deadline=forever,
        lifespan=forever,
        liveliness=interfaces.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
