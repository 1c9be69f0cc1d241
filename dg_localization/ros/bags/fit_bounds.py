# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `fit_bounds`: a rosbag2 in, error bounds for the parameters of the node out.

    fit_bounds BAG --params FILE [--truth TOPIC ... | --truth FILE.csv] [--per link|sensor|all]
               [--keep SHARE] [--margin SHARE] [--start S] [--duration S] [--ros-args ...]

With --truth it learns bounds. Without, it keeps the bounds of FILE, widens them for scatter, and
cannot see a bias. It prints a file of parameters with its findings in comments. Give that file to
the node after FILE.
"""

import argparse
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
import tempfile

from dg_localization.calibration.bounds import Choice
from dg_localization.fleet import FleetConfig, LinkKind
from dg_localization.ros.bags.bag import in_seconds, open_bag
from dg_localization.ros.bags.fit import GROUPS, Bounds, LearnedBounds, bounds_of, fit
from dg_localization.ros.bags.offline import Recording, Task, read_task
from dg_localization.ros.bags.report import Tree
from dg_localization.ros.bags.samples import Gatherer
from dg_localization.ros.executables import (
    EXIT_CODES,
    EXIT_FAILED,
    ExecutableError,
    add_fleet,
    add_span,
    number,
    print_line,
    print_result,
)
from dg_localization.ros.interface.intake import Intake
from dg_localization.ros.interface.links import KINDS, STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.settings import parameters_text, yaml_value
from dg_localization.ros.spinning import own_arguments


def collect(task: Task, recording: Recording) -> Gatherer:
    """Return the readings of a bag; print from which messages nothing is learned."""
    gatherer, rejected = Gatherer(task.settings.fleet), Counter[str]()
    intake = Intake(gatherer, task.settings.use_header_stamp, task.settings.ids)
    for message in recording.reading.shown():
        now_s = in_seconds(message.time_ns)
        rejection = intake.take(recording.links[message.topic], message.data, now_s)
        if rejection is not None:
            rejected[rejection.reason.value] += 1
    for notice in recording.notices:
        print_line(notice)
    malformed = sum(wrong.count for wrong in intake.malformed.values())
    if unread := malformed + recording.reading.unreadable.total():
        print_line(f'{unread} messages could not be read')
    if rejected:
        reasons = ', '.join(f'{n} {why}' for why, n in sorted(rejected.items()))
        print_line(f'nothing is learned from {rejected.total()} rejected messages ({reasons})')
    return gatherer


def main(args: Sequence[str]) -> int:
    """Learn bounds from a bag."""
    parser = argparse.ArgumentParser(
        prog='fit_bounds',
        description='Learn the error bounds of ranges, bearings and odometry from a rosbag2, and '
        'print them as parameters of the node. Without --truth it only widens what you state.',
        epilog=EXIT_CODES,
    )
    add = parser.add_argument
    add('bag', type=Path, metavar='BAG', help='folder, .db3 or .mcap file')
    add_fleet(parser)
    add_span(parser)
    add('--per', choices=GROUPS, default='link', help='what has its own bounds (%(default)s)')
    keep, margin = 'share of the readings that they hold at least', 'widen them by this share'
    share = number(0.0, ' and up to 1', strict=True, high=1.0)
    add('--keep', type=share, default=Choice.keep, metavar='SHARE', help=keep)
    add('--margin', type=number(0.0, ''), default=Choice.margin, metavar='SHARE', help=margin)
    options = parser.parse_args(own_arguments(args))
    task = read_task(options.params, args)
    if task.settings.fleet.elevations_m:
        raise ExecutableError(
            'elevations: fit_bounds would learn them as errors of ranges. Leave out elevations.* '
            'and the points above or below the others.'
        )
    with open_bag(options.bag) as bag:
        recording = Recording(options, task.settings, bag)
        gatherer, links = collect(task, recording), [*recording.links.values()]
        learned = fit(gatherer, recording, options.per, Choice(options.keep, options.margin))
        text = bounds_as_yaml(learned, links, options.bag.resolve().name, task.settings.fleet)
    # The parameters have to pass the checks of the node before they are printed.
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / 'bounds.yaml'
        path.write_text(text, encoding='utf-8')
        read_task(options.params, ['--ros-args', '--params-file', str(path), '--', *args])
    for sentence in recording.damage:
        print_line(sentence)
    print_result(text)
    return EXIT_FAILED if recording.damage else 0


# The kinds of measurements of others that a link carries.
MEASURED = {
    LinkKind.RANGE: (LinkKind.RANGE,),
    LinkKind.BEARING: (LinkKind.BEARING,),
    LinkKind.PEERS: (LinkKind.RANGE, LinkKind.BEARING),
}


def bounds_as_yaml(fit: LearnedBounds, links: Sequence[Link], bag: str, fleet: FleetConfig) -> str:
    """Return the text of the file of parameters."""
    comments = [f'Error bounds learned from {bag} by fit_bounds.', *fit.notes]
    comments += _kept_links(fit, links)
    parameters: Tree = {}
    for kind, groups in fit.groups.items():
        for pair in sorted(groups):
            name = '->'.join(filter(None, pair)) or 'all'
            comments.append(f'{kind.value.capitalize()}s, {name}: {groups[pair].text}.')
        group = fit.of_all(kind)
        parameters[kind.value] = group.bounds if group else {}
    parameters |= {'odometry': fit.odometry, 'robot_odometry': fit.robot_odometry}
    parameters['links'] = [text for link in links if (text := _link_text(fit, link, fleet))]
    return parameters_text(comments, parameters)


def _link_text(fit: LearnedBounds, link: Link, fleet: FleetConfig) -> str:
    """Return the text of a link that has its own bounds or was named explicitly, else nothing."""
    bounds = dict(link.overrides)
    for kind in MEASURED.get(link.key.kind, ()):
        bounds |= _learned(fit, kind, link, fleet)
    if link.key in fit.offsets_s:
        bounds[STAMP_OFFSET] = round(link.stamp_offset_s + fit.offsets_s[link.key], 4)
    is_known = {*link.key.ends} <= {*fleet.points, ''}
    if not link.explicit and (bounds == link.overrides or not is_known):
        return ''
    words = [link.topic, link.type_name, link.key.observer, link.key.target]
    words += [
        f'{name}={yaml_value(bounds[name])}'
        for name in KINDS[link.key.kind].overrides
        if name in bounds
    ]
    return ' '.join(filter(None, words))


def _learned(fit: LearnedBounds, kind: LinkKind, link: Link, fleet: FleetConfig) -> Bounds:
    """Return the bounds that a link must state for its ranges or its bearings."""
    group = fit.group_of(kind, link.key.ends)
    stated = {name: value for name, value in link.overrides.items() if name in KINDS[kind].bounds}
    if group is None or (group is fit.of_all(kind) and not stated):
        return {}
    # Bounds that a link did not state were the bounds of all in the file before.
    whole = {**_of_fleet(kind, fleet), **stated}
    if _is_as_stated(fit, kind, link):
        return whole
    return _widest(whole, group.bounds) if fit.is_widened else group.bounds


def _is_as_stated(fit: LearnedBounds, kind: LinkKind, link: Link) -> bool:
    """Return whether a link keeps its stated bounds, since no reading contradicts them."""
    states = not link.overrides.keys().isdisjoint(KINDS[kind].bounds)
    return states and not fit.is_judged(kind, link.key.ends)


def _kept_links(fit: LearnedBounds, links: Iterable[Link]) -> Iterator[str]:
    """Yield a sentence on each link that keeps its bounds while others were learned."""
    for link in links:
        for kind in MEASURED.get(link.key.kind, ()):
            if fit.of_all(kind) and _is_as_stated(fit, kind, link):
                yield f'{link.topic} has no {kind.value} to learn from: its bounds stay as stated.'


def _of_fleet(kind: LinkKind, fleet: FleetConfig) -> Bounds:
    """Return the stated bounds of all ranges or of all bearings."""
    if kind is LinkKind.BEARING:
        return {name: getattr(fleet, field) for name, (_, field) in KINDS[kind].bounds.items()}
    return bounds_of(fleet.range_error, 'range.')


def _widest(stated: Bounds, learned: Bounds) -> Bounds:
    """Return the bounds that contain both the stated and the learned ones."""
    return {
        name: (min if name.startswith('min_') else max)(value, learned.get(name, value))
        for name, value in stated.items()
    }
