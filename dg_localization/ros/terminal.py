# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What the executables share at the terminal: a progress bar, lines for a person, numbers.

Nobody need be there to read: output to a closed terminal or a broken pipe goes nowhere, and the
work goes on.
"""

import argparse
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager, suppress
from importlib.util import find_spec
import os
from pathlib import Path
import sys
from threading import Event, Thread
import time
from typing import Any, Protocol, TextIO

from dg_localization.optional import install_hint

LINE_PERIOD_S = 10.0
WAIT_PERIOD_S = 2.0


class Progress(Protocol):
    """Shows how far a bag has been read."""

    def update(self, seconds: float) -> None:
        """Go on by some seconds of bag time."""

    def close(self) -> None:
        """Leave the line."""


class ProgressBar:
    """
    A bar by tqdm, until nobody reads it any more.

    Parameters
    ----------
    total_s : float
        Length of the bar.

    """

    def __init__(self, total_s: float) -> None:
        try:
            self._bar = _make_bar(total_s)
        except OSError:
            discard(sys.stderr)
            self._bar = _make_bar(total_s)

    def update(self, seconds: float) -> None:
        """Go on by some seconds of bag time."""
        self._show(lambda bar: bar.update(seconds))

    def close(self) -> None:
        """Leave the line."""
        self._show(lambda bar: bar.close())

    def _show(self, change: Callable[[Any], object]) -> None:
        try:
            change(self._bar)
        except OSError:
            self._bar.disable = True
            discard(sys.stderr)


def _make_bar(total_s: float) -> Any:
    from tqdm import tqdm

    return tqdm(
        # A sum of floats may exceed what they are parts of, and the bar would warn.
        total=total_s + 1e-6,
        unit='s',
        bar_format='{l_bar}{bar}| {n:.1f}/{total:.1f} s of the bag [{elapsed}<{remaining}]',
    )


class ProgressLines:
    """
    Stands in for the bar where tqdm is not installed: a line now and then.

    Parameters
    ----------
    total_s : float
        Length of the bag.

    """

    def __init__(self, total_s: float) -> None:
        self._total_s = total_s
        self._passed_s = 0.0
        self._printed_s = time.monotonic()

    def update(self, seconds: float) -> None:
        """Go on by some seconds of bag time."""
        self._passed_s += seconds
        now_s = time.monotonic()
        if now_s - self._printed_s >= LINE_PERIOD_S:
            self._printed_s = now_s
            print_line(f'{self._passed_s:.1f}/{self._total_s:.1f} s of the bag')

    def close(self) -> None:
        """Do nothing."""


def make_progress(total_s: float) -> Progress:
    """
    Make a progress bar over seconds of bag time.

    Parameters
    ----------
    total_s : float
        Length of the bar.

    """
    if find_spec('tqdm') is None:
        print_line(f'no progress bar without tqdm: {install_hint("tqdm")}')
        return ProgressLines(total_s)
    return ProgressBar(total_s)


def print_line(text: str) -> None:
    """Print a line for the person at the terminal, apart from what the executable puts out."""
    with suppress(OSError):
        _print(text, sys.stderr)


@contextmanager
def told_while_waiting(
    text: str | Callable[[], str], period_s: float = WAIT_PERIOD_S
) -> Iterator[None]:
    """
    Print what is done in a block, and for how long, now and then while it takes long.

    For what has no end that is known before. A function returns the whole line, or nothing.
    """
    ended, began_s = Event(), time.monotonic()

    def tell() -> None:
        while not ended.wait(period_s):
            if isinstance(text, str):
                print_line(f'{text}: {time.monotonic() - began_s:.0f} s')
            elif line := text():
                print_line(line)

    thread = Thread(target=tell, name='told while waiting', daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def print_result(text: str) -> None:
    """
    Print what the executable puts out.

    Raises
    ------
    OSError
        If it cannot be written though somebody wants it, as on a full disk.

    """
    with suppress(BrokenPipeError):
        _print(text, sys.stdout)


def _print(text: str, stream: TextIO) -> None:
    try:
        print(text, file=stream, flush=True)
    except OSError:
        discard(stream)
        raise


def discard(stream: TextIO) -> None:
    """Send what a stream still holds, and all that follows, nowhere."""
    # The interpreter flushes its streams at its end, and would fail once more.
    with suppress(OSError, ValueError), open(os.devnull, 'wb') as nowhere:
        os.dup2(nowhere.fileno(), stream.fileno())


def open_closed_streams() -> None:
    """
    Open the standard streams that the process was started without (`2>&-`).

    A file that is opened later would get their number, and what libraries print there would go
    into the file.
    """
    for number_of_stream in range(3):
        try:
            os.fstat(number_of_stream)
        except OSError:
            # The lowest number that is free, which is this one.
            os.open(os.devnull, os.O_RDWR)
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, 'w', encoding='utf-8'))


def number(low: float, unit: str, strict: bool = False) -> Callable[[str], float]:
    """
    Return an argument type: a finite number above, or not below, `low`.

    Parameters
    ----------
    low : float
        The limit.
    unit : str
        As it is to follow the limit in the message; empty for none.
    strict : bool
        Whether `low` itself is refused.

    """
    wanted = f'a number {"above" if strict else "of at least"} {low:g}{unit}'

    def parse(text: str) -> float:
        try:
            value = float(text)
        except ValueError:
            value = float('nan')
        if not low <= value < float('inf') or (strict and value == low):
            raise argparse.ArgumentTypeError(f"'{text}' is not {wanted}")
        return value

    return parse


def path_ending_in(endings: Collection[str]) -> Callable[[str], Path]:
    """
    Return an argument type: the path of a file to write.

    Parameters
    ----------
    endings : collection of str
        One of which it must have, such as '.png'; its folder must be there.

    """

    def check(text: str) -> Path:
        path = Path(text)
        if path.suffix not in endings:
            raise argparse.ArgumentTypeError(f"'{text}' must end in {' or '.join(endings)}")
        if not path.parent.is_dir():
            raise argparse.ArgumentTypeError(f"'{text}': there is no folder '{path.parent}'")
        return path

    return check
