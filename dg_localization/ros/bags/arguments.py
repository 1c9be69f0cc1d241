# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The command lines of the executables that read bags."""

import argparse
from collections.abc import Callable, Sequence
import os
from pathlib import Path

from dg_localization.ros.bags.picture import PICTURES
from dg_localization.ros.bags.report import BagReport, as_json, as_markdown
from dg_localization.ros.bags.writer import STORAGES
from dg_localization.ros.terminal import number, path_ending_in

REPORTS: dict[str, Callable[[BagReport], str]] = {'.json': as_json, '.md': as_markdown}
"""What writes a report, by the ending of its file."""

PAGE = '.html'
"""The ending of a report with pictures."""

EXIT_CODES = (
    'Exit codes: 0; 1 when the bag is damaged or of no use; 2 when an argument or a parameter is '
    'wrong; 130 after SIGINT, SIGTERM or SIGHUP.'
)


def _new_path(text: str) -> Path:
    path = Path(text)
    if path.exists():
        raise argparse.ArgumentTypeError(f"'{text}' exists; name a folder that does not")
    return path


def _existing_file(text: str) -> Path:
    path = Path(text)
    if not path.is_file():
        raise argparse.ArgumentTypeError(f"'{text}' is no file")
    return path


def _jobs(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"'{text}' must be an integer of at least 1")
    return int(text)


def add_span(parser: argparse.ArgumentParser) -> None:
    """Add the arguments that choose a part of a bag."""
    seconds = number(0.0, ' s')
    parser.add_argument(
        '--start', type=seconds, default=0.0, metavar='S', help='begin this far into the bag'
    )
    parser.add_argument('--duration', type=seconds, metavar='S', help='read only this much')


def add_fleet(parser: argparse.ArgumentParser) -> None:
    """Add the parameters of the node and the ground truth."""
    parser.add_argument(
        '--params',
        type=_existing_file,
        required=True,
        metavar='FILE',
        help='parameters of the node',
    )
    parser.add_argument(
        '--truth',
        nargs='+',
        default=[],
        metavar='TRUTH',
        help="where the robots truly were: '/mocap/{robot}/pose' with a pose for each robot, a "
        'PoseArray of all in the order of the robots, or a table in text (.csv, .txt, .tum) with '
        'the columns stamp, robot, x, y, and where they are known z, and yaw or qx, qy, qz, qw; '
        "a table of one robot, such as 'truth_{robot}.tum', needs no column robot",
    )


def localize_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line of `localize_bag`."""
    parser = argparse.ArgumentParser(
        prog='localize_bag',
        description='Localize a fleet from a rosbag2 as the node would; write a rosbag2.',
        epilog='Other ROS arguments are those of the node: --ros-args -p max_outliers:=1. '
        + EXIT_CODES,
    )
    parser.add_argument(
        'bags', type=Path, nargs='+', metavar='BAG', help='folder, .db3 or .mcap file'
    )
    parser.add_argument(
        '-o', '--output', type=_new_path, required=True, metavar='OUT', help='folder to make'
    )
    add_fleet(parser)
    add_span(parser)
    parser.add_argument(
        '--storage', choices=STORAGES, default=STORAGES[0], help='of OUT (default %(default)s)'
    )
    parser.add_argument(
        '--report',
        type=path_ending_in((*REPORTS, PAGE)),
        metavar='FILE',
        help='write the report, as .json, .md or, of one bag and with its picture, .html',
    )
    parser.add_argument(
        '--plot',
        type=path_ending_in(PICTURES),
        metavar='FILE',
        help='draw the answers over time, as .png, .svg or .pdf; of several bags each has a file '
        'of this name beside its report',
    )
    parser.add_argument(
        '--inputs', action='store_true', help='copy the messages that were used into OUT'
    )
    parser.add_argument(
        '--jobs',
        type=_jobs,
        default=os.cpu_count() or 1,
        metavar='N',
        help='of several bags, localize so many at a time (default %(default)s)',
    )
    return parser


def shared_arguments(options: argparse.Namespace, args: Sequence[str]) -> list[str]:
    """Return the arguments that are the same for each of several bags."""
    shared = ['--params', str(options.params), '--storage', options.storage]
    shared += ['--start', str(options.start)]
    if options.duration is not None:
        shared += ['--duration', str(options.duration)]
    if options.truth:
        shared += ['--truth', *options.truth]
    if options.inputs:
        shared.append('--inputs')
    is_of_ros = False
    for argument in args:
        is_of_ros = argument == '--ros-args' or (is_of_ros and argument != '--')
        if is_of_ros:
            shared.append(argument)
    return shared
