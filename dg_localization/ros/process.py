"""How an executable starts, and how it ends on SIGINT and SIGTERM: exit code 0, no traceback."""

from collections.abc import Callable
import sys

import rclpy
from rclpy.exceptions import ParameterException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

RCLError = rclpy_implementation.RCLError
UnknownROSArgsError = rclpy_implementation.UnknownROSArgsError


class WrongParameterError(ValueError):
    """A parameter of a node has a value that is not allowed."""


def run_node(make_node: Callable[[], Node], args: list[str] | None = None) -> int:
    """
    Make a node and spin it until SIGINT or SIGTERM.

    Parameters
    ----------
    make_node : callable
        Called without arguments once rclpy is initialized.
    args : list of str, optional
        Command line; that of the process by default.

    Returns
    -------
    int
        Exit code: 0, or 1 after telling which parameter or argument is wrong.

    """
    try:
        rclpy.init(args=args)
    except RCLError as error:
        # A file of parameters that is missing or no YAML, or an argument that is none.
        print(error, file=sys.stderr)
        return 1
    try:
        node = make_node()
        try:
            rclpy.spin(node)
        finally:
            node.destroy_node()
    except (WrongParameterError, ParameterException) as error:
        print(error, file=sys.stderr)
        return 1
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except RCLError:
        # The signal shuts the context down under whatever a callback is publishing.
        if rclpy.ok():
            raise
    finally:
        rclpy.try_shutdown()
    return 0
