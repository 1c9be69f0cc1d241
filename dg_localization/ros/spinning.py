# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the executables share of rclpy: its arguments, its start and end, and spinning a node."""

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
# A message waits for up to this long.
BATCH_S = 0.01
# Python handles a signal once the wait for messages, which is no Python, is over.
WAIT_S = 0.2
# One for all: a log call takes the same clock every time. Timers of the clock of a machine would
# be silent for as long as that is set back, and those of a simulated time while it stands still.
STEADY = Clock(clock_type=ClockType.STEADY_TIME)


def at_most_every(period_s: float = REPEATED_S) -> dict[str, Any]:
    """Return what a log call takes to be throttled, also where the clock of the machine is set."""
    return {'throttle_duration_sec': period_s, 'throttle_time_source_type': STEADY}


class BatchExecutor(SingleThreadedExecutor):
    """
    Runs what is ready together, and then waits a little for more.

    To look for what is ready takes rclpy some 0.3 ms of the processor. To do so for each message
    of a simulated clock, which may be a thousand a second, would take a third of a processor.
    """

    def spin_batch(self) -> None:
        """Run everything that is ready; where that is nothing, wait a little for something."""
        began_s = time.monotonic()
        if self._run_ready():
            time.sleep(max(0.0, BATCH_S - (time.monotonic() - began_s)))
        else:
            self.spin_once(timeout_sec=WAIT_S)

    def _run_ready(self) -> bool:
        """Run everything that is ready, and return whether that was anything."""
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
    """Make a sentence of what rclpy raises about arguments, files of parameters or a machine."""
    try:
        yield
    except ParameterException as error:
        raise UsageError(str(error)) from error
    except RuntimeError as error:
        # rclpy has no public class for wrong arguments; what it raises derives from this one.
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
    time to take back what was published.
    """
    with ros_arguments_checked():
        rclpy.init(args=['executable', *args], signal_handler_options=SignalHandlerOptions.NO)
    try:
        yield
    finally:
        rclpy.try_shutdown()


def spin(make_node: Callable[[], Node], args: Sequence[str], usage: str) -> None:
    """Make a node once rclpy runs and spin it until a signal; on ``--help`` print the usage."""
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
    Spin; a callback that raises is reported, and the node goes on.

    Some callbacks are those of rclpy, and raise because of what others send: the one of `/clock`
    for a negative time.
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
