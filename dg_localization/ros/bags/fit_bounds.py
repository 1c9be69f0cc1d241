# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `fit_bounds`: a rosbag2 in, error bounds for the parameters of the node out.

    fit_bounds BAG --params FILE [--truth TOPIC ... | --truth FILE.csv] [--per link|sensor|all]
               [--keep SHARE] [--margin SHARE] [--start S] [--duration S] [--ros-args ...]

With --truth it learns bounds. Without, it keeps what FILE states, widens it for scatter, and
cannot see a bias. What it prints is a file of parameters: what was found stands in its comments.
It is given to the node beside FILE, after it.
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
import tempfile

from dg_localization.calibration.bounds import Choice
from dg_localization.ros.bags.bag import NS_PER_S, Bag, in_seconds, open_bag
from dg_localization.ros.bags.fit import GROUPS, fit
from dg_localization.ros.bags.fit_report import as_yaml
from dg_localization.ros.bags.offline import Inputs, Task, find_inputs, read_task
from dg_localization.ros.bags.reading import Reading
from dg_localization.ros.bags.samples import Gatherer
from dg_localization.ros.bags.truth import read_truth
from dg_localization.ros.executables import (
    EXIT_FAILED,
    ExecutableError,
    print_line,
    print_result,
)
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.spinning import own_arguments
from dg_localization.ros.terminal import add_fleet, add_span, make_progress, number


def collect(
    options: argparse.Namespace, task: Task, bag: Bag, inputs: Inputs
) -> tuple[Gatherer, list[str]]:
    """Return the readings of a bag and what is wrong with it; print what is not learned of."""
    gatherer, rejected = Gatherer(task.settings.fleet), Counter[str]()
    intake = Intake(gatherer, task.settings.use_header_stamp, task.settings.ids)
    links = {link.topic: link for link in inputs.links}
    reading = Reading(bag, inputs.topics)
    done_ns = bag.start_ns + round(options.start * NS_PER_S)
    total_s = bag.duration_s - options.start
    with closing(make_progress(max(0.0, min(total_s, options.duration or total_s)))) as progress:
        for message in reading.messages(options.start, options.duration):
            now_s = in_seconds(message.time_ns)
            rejection = intake.take(links[message.topic], message.data, now_s)
            if rejection is not None:
                rejected[rejection.reason.value] += 1
            progress.update((message.time_ns - done_ns) / NS_PER_S)
            done_ns = message.time_ns
    for notice in (*bag.notices, *inputs.notices, *reading.notices):
        print_line(notice)
    malformed = sum(wrong.count for wrong in intake.malformed.values())
    if unread := malformed + reading.unreadable.total():
        print_line(f'{unread} messages could not be read')
    if rejected:
        reasons = ', '.join(f'{n} {why}' for why, n in sorted(rejected.items()))
        print_line(
            'nothing is learned of what the localizer does not accept: in '
            f'{rejected.total()} messages ({reasons})'
        )
    return gatherer, reading.damage


def check_loads(text: str, options: argparse.Namespace, args: Sequence[str]) -> None:
    """Let the node's own checks read the parameters that are to be printed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bounds.yaml'
        path.write_text(text, encoding='utf-8')
        read_task(options.params, ['--ros-args', '--params-file', str(path), '--', *args])


def _share(text: str) -> float:
    value = number(0.0, '', strict=True)(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a share, a number above 0 and up to 1")
    return value


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='fit_bounds',
        description='Learn the error bounds of ranges, bearings and odometry from a rosbag2, and '
        'print them as parameters of the node. With --truth it learns bounds. Without, it keeps '
        'what you state, widens it for scatter, and cannot see a bias.',
        epilog='Exit codes: 0; 1 when the bag is damaged or of no use; 2 when an argument or a '
        'parameter is wrong; 130 after a signal.',
    )
    add = parser.add_argument
    add('bag', type=Path, metavar='BAG', help='folder, .db3 or .mcap file')
    add_fleet(parser)
    add_span(parser)
    add('--per', choices=GROUPS, default='link', help='what has its own bounds (%(default)s)')
    keep, margin = 'share of the readings that they hold at least', 'widen them by this share'
    add('--keep', type=_share, default=Choice.keep, metavar='SHARE', help=keep)
    add('--margin', type=number(0.0, ''), default=Choice.margin, metavar='SHARE', help=margin)
    return parser


def main(args: Sequence[str]) -> int:
    """Learn bounds from a bag."""
    options = make_parser().parse_args(own_arguments(args))
    task = read_task(options.params, args)
    if task.settings.fleet.elevations_m:
        raise ExecutableError(
            'elevations: fit_bounds compares ranges with distances in the plane; where points are '
            'at different elevations it would learn these as errors. Leave out elevations.* and '
            'the points above or below the others.'
        )
    with open_bag(options.bag) as bag:
        inputs = find_inputs(task.settings, bag.types)
        truth = read_truth(options.truth, task.settings, bag)
        for notice in truth.notices:
            print_line(notice)
        gatherer, damage = collect(options, task, bag, inputs)
        beside = truth.of_fleet(task.settings.fleet) if options.truth else None
        links = {link.key for link in inputs.links}
        choice = Choice(options.keep, options.margin)
        learned = fit(gatherer, beside, links, options.per, choice)
        text = as_yaml(learned, inputs.links, options.bag.resolve().name, task.settings.fleet)
    check_loads(text, options, args)
    # What is wrong with the bag is wrong with the truth in it, too.
    for sentence in dict.fromkeys((*damage, *truth.damage)):
        print_line(sentence)
    print_result(text)
    return EXIT_FAILED if damage or truth.damage else 0
