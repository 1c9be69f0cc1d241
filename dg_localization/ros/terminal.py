# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the executables for bags share at the terminal: a progress bar, and types of arguments."""

import argparse
from collections.abc import Callable, Collection
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from dg_localization.optional import install_hint
from dg_localization.ros.executables import print_line


def make_progress(total_s: float) -> Any:
    """Return a bar over seconds of a bag, with `update` and `close`; without tqdm, no bar."""
    if find_spec('tqdm') is None:
        print_line(f'no progress bar without tqdm: {install_hint("tqdm")}')
        return SimpleNamespace(update=lambda seconds: None, close=lambda: None)
    from tqdm import tqdm

    return tqdm(
        # A sum of floats may exceed what they are parts of, and the bar would warn.
        total=total_s + 1e-6,
        unit='s',
        bar_format='{l_bar}{bar}| {n:.1f}/{total:.1f} s of the bag [{elapsed}<{remaining}]',
    )


def number(low: float, unit: str, strict: bool = False) -> Callable[[str], float]:
    """Return an argument type: a finite number of at least `low`, or above it."""
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
    """Return an argument type: a file to write with one of some endings, in a folder that is."""

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
        "where the robots truly were: '/mocap/{robot}/pose' with a pose for each robot, a "
        'PoseArray of all in the order of the robots, or a table (.csv, .txt, .tum) with the '
        'columns stamp, robot, x, y, and where they are known z, and yaw or qx, qy, qz, qw; a '
        "table of one robot, such as 'truth_{robot}.tum', needs no column robot"
    )
    add('--truth', nargs='+', default=[], metavar='TRUTH', help=where)
