# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A node that nobody sees: ROS reads parameters and remappings for nodes only."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import os
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions

from dg_localization.ros.spinning import ros_arguments_checked


@contextmanager
def hidden_localizer(params: Path, arguments: Sequence[str]) -> Iterator[Node]:
    """
    Make a node of the name of the localizer, with its parameters and remappings.

    It is there for some 20 ms, and for nobody else: it must not be taken for the node of that name
    on a fleet at work.

    Parameters
    ----------
    params : Path
        File of parameters.
    arguments : sequence of str
        A command line that may have `--ros-args`, which win over the file.

    Raises
    ------
    UsageError
        If an argument or a parameter is wrong.

    """
    with _environment('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF'):
        context = Context()
        args = ['--ros-args', '--params-file', str(params), '--', *arguments]
        with ros_arguments_checked():
            rclpy.init(args=args, context=context, signal_handler_options=SignalHandlerOptions.NO)
    try:
        with ros_arguments_checked():
            node = Node(
                'localizer', context=context, enable_rosout=False, start_parameter_services=False
            )
        try:
            yield node
        finally:
            node.destroy_node()
    finally:
        context.try_shutdown()


@contextmanager
def _environment(name: str, value: str) -> Iterator[None]:
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]
        if before is not None:
            os.environ[name] = before
