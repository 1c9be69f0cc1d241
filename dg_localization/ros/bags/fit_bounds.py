# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `fit_bounds`: a rosbag2 in, error bounds for the parameters of the node out.

    fit_bounds BAG --params FILE [--truth TOPIC ... | --truth FILE.csv] [--per link|sensor|all]
               [--keep SHARE] [--margin SHARE] [--bias LOW HIGH] [--start S] [--duration S]
               [--ros-args ...]

With --truth it learns bounds. Without, it keeps what FILE states, widens it for scatter, and
cannot see a bias. What it prints is a file of parameters: what was found stands in its comments.
It is given to the node beside FILE, after it.
"""

import argparse
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
import tempfile

from dg_localization.calibration.bounds import Choice
from dg_localization.ros.bags.arguments import EXIT_CODES, add_fleet, add_span
from dg_localization.ros.bags.bag import NS_PER_S, Bag, open_bag
from dg_localization.ros.bags.fit_report import as_yaml
from dg_localization.ros.bags.fit_with_truth import fit_with_truth
from dg_localization.ros.bags.fit_without_truth import fit_without_truth
from dg_localization.ros.bags.fitted import Fit
from dg_localization.ros.bags.offline import Inputs, Task, find_inputs, read_task
from dg_localization.ros.bags.reading import Reading
from dg_localization.ros.bags.samples import Collector, Samples
from dg_localization.ros.bags.truth import Truth, choose_truth
from dg_localization.ros.executables import EXIT_FAILED, ExecutableError, UsageError
from dg_localization.ros.spinning import own_arguments
from dg_localization.ros.terminal import (
    make_progress,
    number,
    print_line,
    print_result,
    told_while_waiting,
)

GROUPS = ('link', 'sensor', 'all')


def collect(
    options: argparse.Namespace, task: Task, bag: Bag
) -> tuple[Samples, Truth, Inputs, list[str]]:
    """Return the readings of a bag, the truth, the inputs, and what is wrong with the bag."""
    inputs = find_inputs(task.settings, bag.types)
    truth = choose_truth(options.truth, task.settings, bag)
    collector = Collector(task.settings, inputs, truth)
    reading = Reading(bag, {*inputs.topics, *truth.topics})
    classes = {topic.name: topic.message_class for topic in reading.topics}
    total_s = max(0.0, bag.duration_s - options.start)
    if options.duration is not None:
        total_s = min(total_s, options.duration)
    start_ns, done_s = bag.start_ns + round(options.start * NS_PER_S), 0.0
    with closing(make_progress(total_s)) as progress:
        for message in reading.messages(options.start, options.duration):
            message_class = classes[message.topic]
            assert message_class is not None, 'only topics with a class are read'
            collector.take(message, message_class)
            at_s = min(total_s, (message.time_ns - start_ns) / NS_PER_S)
            progress.update(at_s - done_s)
            done_s = at_s
    for notice in (*bag.notices, *inputs.notices, *reading.notices, *truth.notices):
        print_line(notice)
    if unread := collector.malformed + reading.unreadable.total():
        print_line(f'{unread} messages could not be read')
    if collector.rejected:
        reasons = ', '.join(f'{n} {why}' for why, n in sorted(collector.rejected.items()))
        print_line(
            'nothing is learned of what the localizer does not accept: in '
            f'{collector.rejected.total()} messages ({reasons})'
        )
    return collector.samples, truth, inputs, reading.damage


def check_loads(text: str, options: argparse.Namespace, args: Sequence[str]) -> None:
    """Let the node's own checks read the parameters that are to be printed."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bounds.yaml'
        path.write_text(text, encoding='utf-8')
        read_task(options.params, ['--ros-args', '--params-file', str(path), '--', *args])


def fit(options: argparse.Namespace, task: Task, samples: Samples, truth: Truth) -> Fit:
    """Learn the bounds that the command line asks for."""
    choice = Choice(options.keep, options.margin)
    with told_while_waiting('learning the bounds'):
        if options.truth:
            return fit_with_truth(samples, truth, task.settings, options.per, choice)
        return fit_without_truth(samples, task.settings, options.per, choice, options.bias)


def _share(text: str) -> float:
    value = number(0.0, '', strict=True)(text)
    if value > 1.0:
        raise argparse.ArgumentTypeError(f"'{text}' is not a share, a number above 0 and up to 1")
    return value


def _finite(text: str) -> float:
    return number(-1e9, ' m')(text)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='fit_bounds',
        description='Learn the error bounds of ranges, bearings and odometry from a rosbag2, and '
        'print them as parameters of the node. With --truth it learns bounds. Without, it keeps '
        'what you state, widens it for scatter, and cannot see a bias.',
        epilog=EXIT_CODES,
    )
    parser.add_argument('bag', type=Path, metavar='BAG', help='folder, .db3 or .mcap file')
    add_fleet(parser)
    add_span(parser)
    parser.add_argument(
        '--per', choices=GROUPS, default=GROUPS[0], help='what has bounds of its own (%(default)s)'
    )
    parser.add_argument(
        '--keep',
        type=_share,
        default=Choice.keep,
        metavar='SHARE',
        help='share of the readings that the bounds hold at least (%(default)s)',
    )
    parser.add_argument(
        '--margin',
        type=number(0.0, ''),
        default=Choice.margin,
        metavar='SHARE',
        help='widen them by this share of their width at each end (%(default)s)',
    )
    parser.add_argument(
        '--bias',
        nargs=2,
        type=_finite,
        metavar=('LOW', 'HIGH'),
        help='without --truth: bounds of what all ranges of a pair are off by, in m',
    )
    return parser


def main(args: Sequence[str]) -> int:
    """Learn bounds from a bag."""
    options = make_parser().parse_args(own_arguments(args))
    if options.bias and options.truth:
        raise UsageError('--bias is for recordings without --truth, which shows the bias')
    if options.bias and options.bias[0] > options.bias[1]:
        raise UsageError(f'--bias: {options.bias[0]:g} is above {options.bias[1]:g}')
    task = read_task(options.params, args)
    if task.settings.fleet.elevations_m:
        raise ExecutableError(
            'elevations: fit_bounds compares ranges with distances in the plane; where points are '
            'at different elevations it would learn these as errors. Leave out elevations.* and '
            'the points above or below the others.'
        )
    with open_bag(options.bag) as bag:
        samples, truth, inputs, damage = collect(options, task, bag)
        learned, name = fit(options, task, samples, truth), options.bag.resolve().name
        text = as_yaml(learned, inputs.links, name, task.settings.fleet)
    check_loads(text, options, args)
    for sentence in damage:
        print_line(sentence)
    try:
        print_result(text)
    except OSError as error:
        raise ExecutableError(f'the bounds cannot be written: {error.strerror}') from error
    return EXIT_FAILED if damage else 0
