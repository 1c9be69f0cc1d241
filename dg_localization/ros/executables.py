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

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
import os
import signal
import sys
from types import FrameType

EXIT_FAILED = 1
EXIT_WRONG_USAGE = 2
# What a shell makes of SIGINT: half an answer must not look whole to a script.
EXIT_INTERRUPTED = 130

# The last one comes when the terminal is closed, or the connection of ssh is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class ExecutableError(Exception):
    """An executable cannot go on; the text says why and what to do."""

    exit_code = EXIT_FAILED


class UsageError(ExecutableError):
    """An argument or a parameter is wrong; the text says which, and what would be right."""

    exit_code = EXIT_WRONG_USAGE


class StopRequest:
    """Set by the first signal; a second SIGINT or SIGTERM does not wait for a clean end."""

    def __init__(self) -> None:
        self._is_set = False

    def is_set(self) -> bool:
        """Return whether to stop."""
        return self._is_set

    def handle(self, signal_number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        # The kernel and the shell send SIGHUP each when a terminal is closed.
        if self._is_set and signal_number != signal.SIGHUP:
            raise KeyboardInterrupt
        self._is_set = True


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Handle the signals alike, also where a script ignored SIGINT, but SIGHUP not under nohup."""
    numbers = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, former in zip(numbers, before, strict=True):
            signal.signal(number, former)


@contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Turn the signals into a request, where an exception would break what is being written."""
    stop = StopRequest()
    with handled_by(stop.handle):
        yield stop


def print_line(text: str) -> None:
    """Print a line for the person at the terminal, apart from what the executable puts out."""
    print(text, file=sys.stderr, flush=True)


def print_result(text: str) -> None:
    """Print what the executable puts out; a reader that is gone, as of a pipe, is no error."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # The interpreter flushes its streams at its end, and would fail once more.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        raise ExecutableError(f'the result cannot be printed: {error.strerror}') from error


def _run(module: str, interrupted: int, args: Sequence[str] | None = None) -> int:
    """Run `main` of a module of this room with a command line; return the exit code."""
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


localizer = partial(_run, 'node.process', 0)
simulate_fleet = partial(_run, 'simulation.simulate_fleet', 0)
replay = partial(_run, 'bags.replay', 0)
localize_bag = partial(_run, 'bags.localize_bag', EXIT_INTERRUPTED)
fit_bounds = partial(_run, 'bags.fit_bounds', EXIT_INTERRUPTED)
survey_anchors = partial(_run, 'bags.survey_anchors', EXIT_INTERRUPTED)
fleet_status = partial(_run, 'fleet_status', 0)
self_test = partial(_run, 'self_test', EXIT_INTERRUPTED)

EXECUTABLES = {
    'localizer': localizer,
    'simulate_fleet': simulate_fleet,
    'replay': replay,
    'localize_bag': localize_bag,
    'fit_bounds': fit_bounds,
    'survey_anchors': survey_anchors,
    'fleet_status': fleet_status,
    'self_test': self_test,
}
