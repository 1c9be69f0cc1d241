# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Use of rclpy by the executables: its arguments, its start and end, and spinning a node."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
import time
import traceback
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import ParameterException
from rclpy.executors import ShutdownException, SingleThreadedExecutor, TimeoutException
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dg_localization.ros.executables import ExecutableError, StopRequest, UsageError, stop_request

REPEATED_S = 5.0
# Greatest time that a message waits.
BATCH_S = 0.01
# Python handles a signal only after the wait for messages, which is native code.
WAIT_S = 0.2
# One clock for all, since a log call must always use the same one. Timers of the system clock
# would be silent after it is set back, and those of a simulated clock while it stands still.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


def at_most_every(period_s: float = REPEATED_S) -> dict[str, Any]:
    """Return arguments that throttle a log call, independent of changes of the system clock."""
    return {'throttle_duration_sec': period_s, 'throttle_time_source_type': STEADY}


class BatchExecutor(SingleThreadedExecutor):
    """
    Runs all ready callbacks together, and then waits a little for more.

    rclpy takes about 0.3 ms of processor time to find ready callbacks. For each message of a
    simulated clock, perhaps a thousand per second, that would take a third of a processor.
    """

    def spin_batch(self) -> None:
        """Run everything that is ready; if nothing is, wait a little."""
        began_s = time.monotonic()
        if self._run_ready():
            time.sleep(max(0.0, BATCH_S - (time.monotonic() - began_s)))
        else:
            self.spin_once(timeout_sec=WAIT_S)

    def _run_ready(self) -> bool:
        """Run everything that is ready, and return whether something was."""
        ran = False
        while True:
            try:
                task, _, _ = self.wait_for_ready_callbacks(timeout_sec=0.0)
            except (TimeoutException, ShutdownException):
                return ran
            ran = True
            task()
            error = task.exception()
            if error is not None:
                raise error


@contextmanager
def ros_arguments_checked() -> Iterator[None]:
    """Convert errors of rclpy about arguments, files of parameters or the machine to sentences."""
    try:
        yield
    except ParameterException as error:
        raise UsageError(str(error)) from error
    except RuntimeError as error:
        # rclpy has no public class for wrong arguments; its errors derive from this one.
        if 'parse' in str(error) or not str(error).startswith('failed to initialize'):
            raise UsageError(f'wrong ROS arguments: {error}') from error
        about_logs = 'log' in str(error)
        advice = '; set ROS_LOG_DIR to a folder that can be written' if about_logs else ''
        raise ExecutableError(f'ROS cannot start: {error}{advice}') from error


def own_arguments(args: Sequence[str]) -> list[str]:
    """Return a command line without its ROS arguments."""
    with ros_arguments_checked():
        return list(remove_ros_args(['executable', *args])[1:])


@contextmanager
def rclpy_running(args: Sequence[str]) -> Iterator[None]:
    """
    Keep rclpy initialized, with signals left to the caller.

    The handlers of rclpy shut the context down at once, in the middle of a callback, and leave no
    time to withdraw published answers.
    """
    with ros_arguments_checked():
        rclpy.init(args=['executable', *args], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


def spin(make_node: Callable[[], Node], args: Sequence[str], usage: str) -> None:
    """Make a node and spin it until a signal; on ``--help`` print the usage."""
    own = own_arguments(args)
    if {'-h', '--help'}.intersection(own):
        print(usage)
        return
    if own:
        raise UsageError(f"'{own[0]}' is no argument of this node; {usage}")
    with rclpy_running(args), stop_request() as stop:
        try:
            node = make_node()
        except ParameterException as error:
            raise UsageError(str(error)) from error
        try:
            _spin_until(stop, node)
        finally:
            node.destroy_node()


def _spin_until(stop: StopRequest, node: Node) -> None:
    """
    Spin; a callback that raises is reported, and the node continues.

    Some callbacks belong to rclpy and raise for messages of others, such as the callback of
    `/clock` for a negative time.
    """
    executor = BatchExecutor()
    executor.add_node(node)
    while not stop.is_set() and node.context.ok():
        try:
            executor.spin_batch()
        except Exception:
            node.get_logger().error(
                f'a callback failed, the node goes on:\n{traceback.format_exc()}',
                **at_most_every(),
            )
