"""What the executables share at the terminal: a progress bar, lines for a person, numbers."""

import argparse
from collections.abc import Callable
from importlib.util import find_spec
import sys
from typing import Protocol

from dg_localization.optional import install_hint


class Progress(Protocol):
    """Shows how far a bag has been read."""

    def update(self, seconds: float) -> object:
        """Go on by some seconds of bag time."""

    def close(self) -> None:
        """Leave the line."""


class NoProgress:
    """Stands in for the bar where tqdm is not installed."""

    def update(self, seconds: float) -> None:
        """Show nothing."""

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
        return NoProgress()
    from tqdm import tqdm

    bar: Progress = tqdm(
        # A sum of floats may exceed what they are parts of, and the bar would warn.
        total=total_s + 1e-6,
        unit='s',
        bar_format='{l_bar}{bar}| {n:.1f}/{total:.1f} s of the bag [{elapsed}<{remaining}]',
    )
    return bar


def print_line(text: str) -> None:
    """Print a line for the person at the terminal, apart from what the executable puts out."""
    print(text, file=sys.stderr, flush=True)


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
