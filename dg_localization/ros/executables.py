# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executables: their start, errors and exit codes, and shared parts of their command lines.

An executable is a module with a function `main`, which takes the command line and raises if it
cannot continue. Signals and errors become exit codes only here:

- 0: done; for a node, and for `replay`, also when SIGINT, SIGTERM or SIGHUP ends it;
- 1: it could not continue, for example because of a damaged bag;
- 2: an argument or a parameter is wrong;
- 130: SIGINT, SIGTERM or SIGHUP came before the work was done.

Importing rclpy and the messages takes most of a start, so it happens after the signal handlers
are installed: an executable ends without a traceback from its first moment on.
"""

import argparse
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import sys
from types import FrameType, SimpleNamespace
from typing import Any

from dg_localization.optional import install_hint

EXIT_FAILED = 1
EXIT_WRONG_USAGE = 2
# The exit code of a shell for SIGINT: an incomplete answer must not look complete to a script.
EXIT_INTERRUPTED = 130

EXIT_CODES = (
    'Exit codes: 0; 1 where it could not go on, as on a damaged bag; 2 when an argument or a '
    'parameter is wrong; 130 after a signal.'
)
# SIGHUP comes when the terminal is closed or an ssh connection is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class ExecutableError(Exception):
    """An executable cannot continue; the text says why and what to do."""

    exit_code = EXIT_FAILED


class UsageError(ExecutableError):
    """An argument or a parameter is wrong; the text says which, and what would be right."""

    exit_code = EXIT_WRONG_USAGE


class StopRequest:
    """Set by the first signal; a second SIGINT or SIGTERM ends the process at once."""

    def __init__(self) -> None:
        self._is_set = False

    def is_set(self) -> bool:
        """Return whether a signal has arrived."""
        return self._is_set

    def handle(self, signal_number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        # The kernel and the shell both send SIGHUP when a terminal is closed.
        if self._is_set and signal_number != signal.SIGHUP:
            raise KeyboardInterrupt
        self._is_set = True


@contextmanager
def handled_by(handler: Callable[[int, FrameType | None], object]) -> Iterator[None]:
    """Install one handler for all signals, even if SIGINT was ignored; not SIGHUP under nohup."""
    numbers = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, former in zip(numbers, before, strict=True):
            signal.signal(number, former)


@contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Turn signals into a request, since an exception would corrupt files being written."""
    stop = StopRequest()
    with handled_by(stop.handle):
        yield stop


def print_line(text: str) -> None:
    """Print a line for the user to stderr, separate from the output of the executable."""
    print(text, file=sys.stderr, flush=True)


def print_result(text: str) -> None:
    """Print the output of the executable; a closed pipe is no error."""
    try:
        print(text, flush=True)
    except BrokenPipeError:
        # The interpreter flushes its streams at exit, and would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        raise ExecutableError(f'the result cannot be printed: {error.strerror}') from error


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raise `ExecutableError` with the path if it cannot be written, as on a full disk."""
    try:
        yield
    except OSError as error:
        raise ExecutableError(f'{path} cannot be written: {error.strerror or error}') from error


def write_text(path: Path, text: str) -> None:
    """Write a file, such as a report."""
    with writing(path):
        path.write_text(text, encoding='utf-8')


def make_progress(total_s: float) -> Any:
    """Return a progress bar over seconds of a bag, or a stand-in without tqdm."""
    if find_spec('tqdm') is None:
        print_line(f'no progress bar without tqdm: {install_hint("tqdm")}')
        return SimpleNamespace(update=lambda seconds: None, close=lambda: None)
    from tqdm import tqdm

    return tqdm(
        # A sum of floats may exceed the total, and the bar would warn.
        total=total_s + 1e-6,
        unit='s',
        bar_format='{l_bar}{bar}| {n:.1f}/{total:.1f} s of the bag [{elapsed}<{remaining}]',
    )


def number(
    low: float, unit: str, strict: bool = False, high: float = sys.float_info.max
) -> Callable[[str], float]:
    """Return an argument type: a finite number from `low` (excluded if strict) to `high`."""
    wanted = f'a number {"above" if strict else "of at least"} {low:g}{unit}'

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float('nan')
        if not low <= value <= high or (strict and value == low):
            raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
        return value

    return parse


def path_ending_in(endings: Collection[str]) -> Callable[[str], Path]:
    """Return an argument type: a file to write with a given suffix, in an existing folder."""

    def check(text: str) -> Path:
        path = Path(text)
        if path.suffix not in endings:
            raise argparse.ArgumentTypeError(f"'{text}' must end in {' or '.join(endings)}")
        if not path.parent.is_dir():
            raise argparse.ArgumentTypeError(f"'{text}': there is no folder '{path.parent}'")
        return path

    return check


def new_path(text: str) -> Path:
    """Return the argument: a path that does not exist."""
    if Path(text).exists():
        raise argparse.ArgumentTypeError(f"'{text}' exists; name a folder that does not")
    return Path(text)


def existing_file(text: str) -> Path:
    """Return the argument: a file that exists."""
    if not Path(text).is_file():
        raise argparse.ArgumentTypeError(f"'{text}' is no file")
    return Path(text)


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that choose a part of a bag."""
    seconds, add = number(0.0, ' s'), parser.add_argument
    add('--start', type=seconds, default=0.0, metavar='S', help='begin this far into the bag')
    add('--duration', type=seconds, metavar='S', help='read only this much')


def add_fleet(parser: argparse.ArgumentParser) -> None:
    """Add the parameters of the node and the ground truth."""
    add = parser.add_argument
    add('--params', type=existing_file, required=True, metavar='FILE', help='of the node')
    where = (
        "where the robots truly were: poses of each on '/mocap/{robot}/pose', a PoseArray of all "
        'in their order, or a table (.csv, .txt, .tum) with the columns stamp, robot (not in '
        "'truth_{robot}.tum'), x, y, and where they are known z, and yaw or qx, qy, qz, qw"
    )
    add('--truth', nargs='+', default=[], metavar='TRUTH', help=where)


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


localizer = partial(_run, 'node.localizer', 0)
simulate_fleet = partial(_run, 'simulation.simulate_fleet', 0)
replay = partial(_run, 'bags.replay', 0)
localize_bag = partial(_run, 'bags.localize_bag', EXIT_INTERRUPTED)
fit_bounds = partial(_run, 'bags.fit_bounds', EXIT_INTERRUPTED)
survey_anchors = partial(_run, 'bags.survey_anchors', EXIT_INTERRUPTED)
fleet_status = partial(_run, 'fleet_status', 0)
self_test = partial(_run, 'self_test', EXIT_INTERRUPTED)

EXECUTABLES = {name: one for name, one in globals().items() if isinstance(one, partial)}
