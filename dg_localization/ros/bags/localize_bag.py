# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `localize_bag`: a rosbag2 in, a rosbag2 with every answer out, and a report.

It does in the time of the bag what the node does: the same parameters, the same inputs, the same
estimate at the same rate, the same messages on the same topics. The same bag gives the same bytes
on every run: no limit depends on a clock of the machine. `solver.max_seconds`,
`solver.tighten_seconds` and `conflicts.max_seconds` are not used, `solver.max_boxes` and
`conflicts.max_solves` are.
"""

import argparse
from collections.abc import Sequence
from contextlib import closing
import os
from pathlib import Path
import time

from dg_localization.fleet import solver_warnings, warm_up
from dg_localization.ros.bags.bag import NS_PER_S, Bag, BagError, in_seconds, open_bag
from dg_localization.ros.bags.many_bags import MANY_REPORTS, localize_many
from dg_localization.ros.bags.offline import (
    BagLocalizer,
    Task,
    find_inputs,
    read_task,
    timeline,
)
from dg_localization.ros.bags.page import as_page
from dg_localization.ros.bags.picture import PICTURES, AnswerPicture, check_can_draw
from dg_localization.ros.bags.reading import Reading
from dg_localization.ros.bags.report import (
    Tally,
    Tree,
    as_json,
    as_markdown,
    gap_text,
    inputs_tree,
    parts,
)
from dg_localization.ros.bags.truth import read_truth
from dg_localization.ros.bags.truth_tally import TruthTally
from dg_localization.ros.bags.writer import new_bag, write_text, writing
from dg_localization.ros.executables import (
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    StopRequest,
    UsageError,
    add_fleet,
    add_span,
    make_progress,
    new_path,
    number,
    path_ending_in,
    print_line,
    print_result,
    stop_request,
)
from dg_localization.ros.spinning import own_arguments

PAGE = '.html'
"""The ending of a report with pictures."""


class InterruptedRun(Exception):
    """A signal came before the first answer."""


class BagRun:
    """
    One bag, and all that is made of its answers.

    The inputs are looked for and the truth is read before kernels are compiled for minutes.
    """

    def __init__(self, options: argparse.Namespace, task: Task, bag: Bag) -> None:
        fleet = task.settings.fleet
        self.options, self.task, self.bag = options, task, bag
        self.inputs = find_inputs(task.settings, bag.types)
        self.truth = read_truth(options.truth, task.settings, bag)
        beside = self.truth.of_fleet(fleet) if options.truth else None
        self.tally = Tally(fleet.robots)
        self.compared = TruthTally(beside) if beside else None
        self.picture = None
        if options.plot is not None or (options.report and options.report.suffix == PAGE):
            self.picture = AnswerPicture(fleet, options.bag.resolve().name, beside)

    def localize(self, stop: StopRequest) -> Tree:
        """Localize, write the answers, and return the report."""
        span_ns, gaps_ns = self._span_ns(), list[tuple[int, int]]()
        reading = Reading(self.bag, self.inputs.topics)
        with new_bag(self.options.output) as writer:
            localizer = BagLocalizer(self.task, self.inputs, writer)
            self._answer_all(reading, span_ns, gaps_ns, localizer, stop)
            if stop.is_set() and not self.tally.ticks:
                raise InterruptedRun
        gaps = [tuple(map(self._at_s, gap_ns)) for gap_ns in gaps_ns]
        notices = [*self.bag.notices, *self.inputs.notices, *reading.notices, *self.truth.notices]
        notices += [gap_text(*gap) for gap in gaps]
        ending = f'It ends at {self.tally.last_s:.1f} s: interrupted.' if stop.is_set() else ''
        states = localizer.intake.states(in_seconds(span_ns[1]))
        return {
            'bag': self.options.bag.resolve().name,
            'start_s': self.options.start,
            'end_s': self._at_s(span_ns[1]),
            'rate_hz': self.task.settings.rate_hz,
            'ending': ending,
            # What is wrong with a topic that is an input and a truth is found twice.
            'damage': list(dict.fromkeys((*reading.damage, *self.truth.damage))),
            'max_boxes': self.task.settings.fleet.solver.max_boxes,
            **self.tally.tree(),
            **inputs_tree(
                self.inputs.links, states, localizer.intake.malformed, reading.unreadable
            ),
            'truth': self.compared.tree() if self.compared else None,
            'gaps': [{'first_s': first_s, 'last_s': last_s} for first_s, last_s in gaps],
            'notices': list(dict.fromkeys(notices)),
        }

    def _span_ns(self) -> tuple[int, int]:
        """Return the first and the last time to read."""
        bag, options = self.bag, self.options
        start_ns = bag.start_ns + round(options.start * NS_PER_S)
        end_ns = bag.end_ns
        if options.duration is not None:
            end_ns = min(end_ns, start_ns + round(options.duration * NS_PER_S))
        period_s, span_s = 1.0 / self.task.settings.rate_hz, (end_ns - start_ns) / NS_PER_S
        if span_s < period_s:
            raise BagError(
                f'of {bag.duration_s:.1f} s of the bag {max(0.0, span_s):.1f} s are to be read; '
                f"there must be {period_s:g} s, one period of the parameter 'rate'"
            )
        return start_ns, end_ns

    def _at_s(self, time_ns: int) -> float:
        return (time_ns - self.bag.start_ns) / NS_PER_S

    def _answer_all(
        self,
        reading: Reading,
        span_ns: tuple[int, int],
        gaps_ns: list[tuple[int, int]],
        localizer: BagLocalizer,
        stop: StopRequest,
    ) -> None:
        """Let everything happen in order, and count the answers, until the end or a signal."""
        messages = reading.messages(self.options.start, self.options.duration)
        events = timeline(messages, span_ns, self.task.settings.rate_hz, gaps_ns)
        done_s = self._at_s(span_ns[0])
        with closing(make_progress((span_ns[1] - span_ns[0]) / NS_PER_S)) as progress:
            for time_ns, message in events:
                if stop.is_set():
                    return
                if message is not None:
                    localizer.take(message)
                    continue
                estimate, at_s = localizer.tick(time_ns, stop), self._at_s(time_ns)
                if estimate is None or localizer.snapshot is None:
                    return
                self.tally.add(estimate, at_s, localizer.statuses)
                if self.compared is not None:
                    self.compared.add(estimate, localizer.snapshot, at_s)
                if self.picture is not None:
                    self.picture.add(estimate, localizer.snapshot, at_s)
                progress.update(at_s - done_s)
                done_s = at_s

    def write_report(self, tree: Tree) -> None:
        """Write the report and the picture where the command line says, and print the report."""
        options, text = self.options, as_markdown(tree['bag'], parts(tree))
        if options.report is not None:
            written = as_json(tree) if options.report.suffix == '.json' else text
            if options.report.suffix == PAGE and self.picture is not None:
                written = as_page(tree, self.task.settings.fleet, self.picture.as_svg())
            write_text(options.report, written)
        print_result(text)
        if options.plot is not None and self.picture is not None:
            with writing(options.plot):
                self.picture.draw(options.plot)


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
    parser = argparse.ArgumentParser(
        prog='localize_bag',
        description='Localize a fleet from a rosbag2 as the node would; write a rosbag2.',
        epilog='Other ROS arguments are those of the node: --ros-args -p max_outliers:=1. '
        'Exit codes: 0; 1 when the bag is damaged or of no use; 2 when an argument or a '
        'parameter is wrong; 130 after SIGINT, SIGTERM or SIGHUP.',
    )
    add = parser.add_argument
    add('bags', type=Path, nargs='+', metavar='BAG', help='folder, .db3 or .mcap file')
    add('-o', '--output', type=new_path, required=True, metavar='OUT', help='folder to make')
    add_fleet(parser)
    add_span(parser)
    report = path_ending_in((*MANY_REPORTS, PAGE))
    add('--report', type=report, metavar='FILE', help='.json, .md or, of one bag, .html')
    picture = path_ending_in(PICTURES)
    add('--plot', type=picture, metavar='FILE', help='draw the answers: .png, .svg or .pdf')
    at_once, cores = number(1.0, ''), os.cpu_count() or 1
    add('--jobs', type=at_once, default=cores, metavar='N', help='bags at a time (%(default)s)')
    return parser


def _get_solver_ready() -> None:
    """Load the kernels, or compile them in sight: that takes minutes, and a signal ends it."""
    warm_up(print_line)
    for warning in solver_warnings():
        print_line(warning)


def _localize_one(options: argparse.Namespace, task: Task) -> int:
    """Localize a bag, print and write what came of it; return the exit code."""
    with open_bag(options.bag) as bag:
        run = BagRun(options, task, bag)
        _get_solver_ready()
        with stop_request() as stop:
            began_s = time.perf_counter()
            tree = run.localize(stop)
            took_s = time.perf_counter() - began_s
            run.write_report(tree)
    read_s = run.tally.last_s - options.start
    print_result(
        f'{read_s:.1f} s of the bag took {took_s:.1f} s: {read_s / took_s:.1f} times real time.'
    )
    if tree['ending']:
        return EXIT_INTERRUPTED
    return EXIT_FAILED if tree['damage'] else 0


def main(args: Sequence[str]) -> int:
    """Localize a bag, or several, until their end or a signal; return the exit code."""
    options = make_parser().parse_args(own_arguments(args))
    task = read_task(options.params, args)
    wants_page = options.report is not None and options.report.suffix == PAGE
    if options.plot is not None or wants_page:
        check_can_draw()
    if len(options.bags) > 1 and wants_page:
        raise UsageError('--report: of several bags it is .json or .md')
    try:
        if len(options.bags) > 1:
            _get_solver_ready()
            return localize_many(options, args)
        options.bag = options.bags[0]
        return _localize_one(options, task)
    except (InterruptedRun, KeyboardInterrupt):
        kept = f'{options.output} has the answers so far' if options.output.exists() else ''
        print_line(f'interrupted; {kept or "nothing is written"}')
        return EXIT_INTERRUPTED
