# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `localize_bag`: a rosbag2 in, a rosbag2 with every answer out, and a report.

It does the work of the node in the time of the bag: the same parameters, the same inputs, the same
estimate at the same rate, the same messages on the same topics. The same bag gives the same bytes
on every run: no limit depends on a clock of the machine. Of several bags each is localized by a
process of its own: nothing is shared but the files. `solver.max_seconds`,
`solver.tighten_seconds` and `conflicts.max_seconds` are not used, `solver.max_boxes` and
`conflicts.max_solves` are.
"""

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
import json
import os
from pathlib import Path
import subprocess
import sys
import time
from typing import Any

from dg_localization.fleet import solver_warnings, warm_up
from dg_localization.ros.bags.bag import NS_PER_S, Bag, in_seconds, open_bag
from dg_localization.ros.bags.offline import BagLocalizer, BagWriter, Recording, Task, read_task
from dg_localization.ros.bags.picture import PICTURES, AnswerPicture, as_page, check_can_draw
from dg_localization.ros.bags.report import (
    Sheet,
    Tally,
    Tree,
    as_json,
    as_markdown,
    gap_text,
    inputs_tree,
    parts,
    width_text,
)
from dg_localization.ros.bags.truth_tally import TruthTally
from dg_localization.ros.executables import (
    EXIT_CODES,
    EXIT_FAILED,
    EXIT_INTERRUPTED,
    StopRequest,
    UsageError,
    add_fleet,
    add_span,
    new_path,
    number,
    path_ending_in,
    print_line,
    print_result,
    stop_request,
    write_text,
    writing,
)
from dg_localization.ros.spinning import own_arguments

PAGE = '.html'
"""The suffix of a report with pictures."""

REPORT, ANSWERS = 'report.json', 'answers'
"""Names of the report of one of several bags, and of the bag with its answers."""


class BagRun:
    """
    One bag, and the outputs made from its answers.

    Inputs are found and the truth is read first, before kernels are compiled for minutes.
    """

    def __init__(self, options: argparse.Namespace, task: Task, bag: Bag) -> None:
        fleet = task.settings.fleet
        self.options, self.task, self.bag = options, task, bag
        self.recording = Recording(options, task.settings, bag)
        self.tally, truth = Tally(fleet.robots), self.recording.truth
        self.compared = TruthTally(truth) if truth else None
        is_drawn = options.plot is not None or (options.report and options.report.suffix == PAGE)
        title = options.bag.resolve().name
        self.picture = AnswerPicture(fleet, title, truth) if is_drawn else None
        self.others = [one for one in (self.compared, self.picture) if one is not None]

    def localize(self, stop: StopRequest) -> Tree:
        """Localize, write the answers, and return the report."""
        span_ns, gaps_ns = self.recording.span_ns(), list[tuple[int, int]]()
        settings, recording = self.task.settings, self.recording
        with BagWriter(self.options.output) as writer:
            localizer = BagLocalizer(self.task, recording, writer)
            for time_ns, message in recording.timeline(gaps_ns):
                if stop.is_set():
                    break
                if message is not None:
                    localizer.take(message)
                    continue
                answer, at_s = localizer.tick(time_ns, stop), self._at_s(time_ns)
                if answer is None:
                    break
                estimate, snapshot, statuses = answer
                self.tally.add(estimate, at_s, statuses)
                for other in self.others:
                    other.add(estimate, snapshot, at_s)
            if stop.is_set() and not self.tally.ticks:
                raise KeyboardInterrupt
        gaps = [tuple(map(self._at_s, gap_ns)) for gap_ns in gaps_ns]
        ending = f'It ends at {self.tally.last_s:.1f} s: interrupted.' if stop.is_set() else ''
        return {
            'bag': self.options.bag.resolve().name,
            'start_s': self.options.start,
            'end_s': self._at_s(span_ns[1]),
            'rate_hz': settings.rate_hz,
            'ending': ending,
            'damage': recording.damage,
            'max_boxes': settings.fleet.solver.max_boxes,
            **self.tally.tree(),
            **inputs_tree(recording, localizer.intake, in_seconds(span_ns[1])),
            'truth': self.compared.tree() if self.compared else None,
            'gaps': [{'first_s': first_s, 'last_s': last_s} for first_s, last_s in gaps],
            'notices': [*recording.notices, *(gap_text(*gap) for gap in gaps)],
        }

    def _at_s(self, time_ns: int) -> float:
        return (time_ns - self.bag.start_ns) / NS_PER_S

    def write_report(self, tree: Tree) -> None:
        """Write the report and the picture as the command line asks, and print the report."""
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


def localize_many(options: argparse.Namespace, args: Sequence[str]) -> int:
    """Localize several bags, print and write the results; return the exit code."""
    bags: dict[str, Path] = {}
    for bag in options.bags:
        name = bag.resolve().stem if bag.is_file() else bag.resolve().name
        if bags.setdefault(name, bag) is not bag:
            raise UsageError(f"two bags are called '{name}'; their answers need different names")
    with writing(options.output):
        options.output.mkdir(parents=True)
    running: list[subprocess.Popen[str]] = []
    shared = ['--params', str(options.params), '--start', str(options.start)]
    shared += ['--duration', str(options.duration)] if options.duration is not None else []
    shared += ['--truth', *options.truth] if options.truth else []
    is_of_ros = False
    for argument in args:
        is_of_ros = argument == '--ros-args' or (is_of_ros and argument != '--')
        shared += [argument] if is_of_ros else []
    # One thread waits for each process.
    with ThreadPoolExecutor(int(options.jobs)) as threads:
        futures = []
        for name, bag in bags.items():
            folder = options.output / name
            own = [str(bag), '-o', str(folder / ANSWERS), '--report', str(folder / REPORT)]
            own += ['--plot', str(folder / options.plot.name)] if options.plot else []
            futures.append(threads.submit(_localize, folder, [*own, *shared], running))
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                print_line(f'{done} of {len(bags)} bags: {future.result()["name"]}')
        except KeyboardInterrupt:
            threads.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            raise
    outcomes = [future.result() for future in futures]
    text = many_as_markdown(outcomes)
    if options.report is not None:
        is_json = options.report.suffix == '.json'
        write_text(options.report, as_json({'bags': outcomes}) if is_json else text)
    print_result(text)
    return max(outcome['exit_code'] for outcome in outcomes)


def _localize(folder: Path, arguments: Sequence[str], running: list[Any]) -> Tree:
    """Localize one bag in a separate process; return exit code, report and error."""
    folder.mkdir()
    report = folder / REPORT
    # In a session of its own it gets Ctrl-C only once: a second signal ends it at once.
    process = subprocess.Popen(
        [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', *arguments],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    running.append(process)
    _, errors = process.communicate()
    said = ''.join(errors.strip().splitlines()[-1:])
    # The code of a process that a signal ended is negative.
    code = process.returncode if process.returncode >= 0 else EXIT_FAILED
    found = json.loads(report.read_text(encoding='utf-8')) if report.exists() else None
    is_told = found and (not code or found['ending'] or found['damage'])
    error = '' if is_told else said
    return {
        'name': folder.name,
        'exit_code': code or (EXIT_FAILED if found is None else 0),
        'error': error,
        'report': found,
    }


def many_as_markdown(outcomes: Sequence[Tree]) -> str:
    """Return a readable report on all bags: one line for each, and the failures."""
    columns = (
        *('bag', 'ticks', 'with one hypothesis', 'contradictory', 'measurements', 'rejected'),
        *('median width, by robot', 'truth inside', 'ended'),
    )
    rows = [_cells(outcome) for outcome in outcomes]
    return as_markdown(f'{len(outcomes)} bags', [Sheet(columns, rows)])


def _cells(outcome: Tree) -> list[Any]:
    """Return the row of one bag."""
    report = outcome['report']
    if report is None:
        return [outcome['name'], *[''] * 7, outcome['error']]
    truth = report['truth']
    return [
        outcome['name'],
        report['ticks'],
        report['ticks_by_hypotheses'].get('1', 0),
        sum(found['ticks'] for found in report['contradictions']),
        report['accepted'],
        sum(report['rejected'].values()),
        ', '.join(width_text(report, robot) for robot in report['median_enclosure_width_m']),
        f'{truth["held"]} of {truth["compared"]}' if truth else '',
        ' '.join(filter(None, [report['ending'], *report['damage'], outcome['error']]))
        or 'at its end',
    ]


def _get_solver_ready() -> None:
    """Load the kernels, or compile them for minutes and say so; a signal ends it."""
    warm_up(print_line)
    for warning in solver_warnings():
        print_line(warning)


def _localize_one(options: argparse.Namespace, task: Task) -> int:
    """Localize a bag, print and write the results; return the exit code."""
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
    parser = argparse.ArgumentParser(
        prog='localize_bag',
        description='Localize a fleet from a rosbag2 as the node would; write a rosbag2.',
        epilog=f'ROS arguments are those of the node: --ros-args -p rate:=1.0. {EXIT_CODES}',
    )
    add = parser.add_argument
    add('bags', type=Path, nargs='+', metavar='BAG', help='folder, .db3 or .mcap file')
    add('-o', '--output', type=new_path, required=True, metavar='OUT', help='folder to make')
    add_fleet(parser)
    add_span(parser)
    report = path_ending_in(('.json', '.md', PAGE))
    add('--report', type=report, metavar='FILE', help='.json, .md or, of one bag, .html')
    picture = path_ending_in(PICTURES)
    add('--plot', type=picture, metavar='FILE', help='draw the answers: .png, .svg or .pdf')
    at_once, cores = number(1.0, ''), os.cpu_count() or 1
    add('--jobs', type=at_once, default=cores, metavar='N', help='bags at a time (%(default)s)')
    options = parser.parse_args(own_arguments(args))
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
    except KeyboardInterrupt:
        kept = f'{options.output} has the answers so far' if options.output.exists() else ''
        print_line(f'interrupted; {kept or "nothing is written"}')
        return EXIT_INTERRUPTED
