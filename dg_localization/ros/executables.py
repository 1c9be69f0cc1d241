# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executables: how each of them starts, fails and ends.

An executable is a module with a function `main`, which takes the command line and raises when it
cannot go on. This is the one place that makes signals and errors an exit code:

- 0: done; for a node, and for `replay`, also when SIGINT, SIGTERM or SIGHUP ends it;
- 1: it could not go on, for example because of a damaged bag;
- 2: an argument or a parameter is wrong;
- 130: SIGINT, SIGTERM or SIGHUP came before the work was done.

Importing rclpy and the messages is most of a start, so it happens after the signals are taken
care of: an executable ends without a traceback from its first moment on.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
import signal
import sys

from dg_localization.ros.signals import handled_by
from dg_localization.ros.terminal import open_closed_streams, print_line

EXIT_FAILED = 1
EXIT_WRONG_USAGE = 2
# What a shell makes of SIGINT: half an answer must not look whole to a script.
EXIT_INTERRUPTED = 130


class ExecutableError(Exception):
    """An executable cannot go on; the text says why and what to do."""

    exit_code = EXIT_FAILED


class UsageError(ExecutableError):
    """An argument or a parameter is wrong; the text says which, and what would be right."""

    exit_code = EXIT_WRONG_USAGE


def localizer(args: Sequence[str] | None = None) -> int:
    """Run the node `localizer`; return the exit code."""
    return _run('node.process', args)


def simulate_fleet(args: Sequence[str] | None = None) -> int:
    """Run the node `simulate_fleet`; return the exit code."""
    return _run('simulation.simulate_fleet', args)


def replay(args: Sequence[str] | None = None) -> int:
    """Run `replay`; return the exit code."""
    return _run('bags.replay', args)


def localize_bag(args: Sequence[str] | None = None) -> int:
    """Run `localize_bag`; return the exit code."""
    return _run('bags.localize_bag', args, interrupted=EXIT_INTERRUPTED)


def fit_bounds(args: Sequence[str] | None = None) -> int:
    """Run `fit_bounds`; return the exit code."""
    return _run('bags.fit_bounds', args, interrupted=EXIT_INTERRUPTED)


def fleet_status(args: Sequence[str] | None = None) -> int:
    """Run `fleet_status`; return the exit code."""
    return _run('fleet_status', args)


def self_test(args: Sequence[str] | None = None) -> int:
    """Run `self_test`; return the exit code."""
    return _run('self_test', args, interrupted=EXIT_INTERRUPTED)


EXECUTABLES = {
    function.__name__: function
    for function in (
        localizer,
        simulate_fleet,
        replay,
        localize_bag,
        fit_bounds,
        fleet_status,
        self_test,
    )
}


def _run(module: str, args: Sequence[str] | None, interrupted: int = 0) -> int:
    """
    Import a module of this room and run its `main`.

    Parameters
    ----------
    module : str
        Its name within this room.
    args : sequence of str, optional
        The command line without the name of the executable; that of the process by default.
    interrupted : int
        The exit code after a signal.

    Returns
    -------
    int
        The exit code.

    """
    open_closed_streams()
    try:
        with handled_by(signal.default_int_handler):
            main: Callable[[Sequence[str]], int]
            main = import_module(f'dg_localization.ros.{module}').main
            return main(sys.argv[1:] if args is None else args)
    except ExecutableError as error:
        print_line(str(error))
        return error.exit_code
    except KeyboardInterrupt:
        return interrupted
