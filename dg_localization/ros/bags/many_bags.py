# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Several bags, each localized by a process of its own.

Bags are independent of each other, so that nothing is shared but the files: the answers are the
same whatever the number of processes.
"""

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
import json
from pathlib import Path
import subprocess
import sys
from typing import Any

from dg_localization.ros.bags.report import Table, Tree, as_json, as_markdown, width_text
from dg_localization.ros.bags.writer import write_text, writing
from dg_localization.ros.executables import EXIT_FAILED, UsageError, print_line, print_result

REPORT, ANSWERS = 'report.json', 'answers'
"""What the report of one bag and the bag with its answers are called."""


def localize_many(options: argparse.Namespace, args: Sequence[str]) -> int:
    """Localize several bags, print and write what came of all; return the exit code."""
    bags: dict[str, Path] = {}
    for bag in options.bags:
        name = bag.resolve().stem if bag.is_file() else bag.resolve().name
        if bags.setdefault(name, bag) is not bag:
            raise UsageError(f"two bags are called '{name}'; their answers need different names")
    with writing(options.output):
        options.output.mkdir(parents=True)
    running: list[subprocess.Popen[str]] = []
    # A thread waits for each process.
    with ThreadPoolExecutor(int(options.jobs)) as threads:
        futures = {}
        for name, bag in bags.items():
            arguments = list(_arguments(options, args, bag, options.output / name))
            futures[name] = threads.submit(_localize, name, options.output, arguments, running)
        try:
            for done, future in enumerate(as_completed(futures.values()), start=1):
                print_line(f'{done} of {len(bags)} bags: {future.result()["name"]}')
        except KeyboardInterrupt:
            threads.shutdown(wait=False, cancel_futures=True)
            for process in running:
                process.terminate()
            raise
    outcomes = [future.result() for future in futures.values()]
    if options.report is not None:
        write_text(options.report, MANY_REPORTS[options.report.suffix](outcomes))
    print_result(many_as_markdown(outcomes))
    return max(outcome['exit_code'] for outcome in outcomes)


def _arguments(
    options: argparse.Namespace, args: Sequence[str], bag: Path, folder: Path
) -> Iterator[str]:
    """Yield the arguments of the process that localizes one bag."""
    yield from (str(bag), '-o', str(folder / ANSWERS), '--report', str(folder / REPORT))
    yield from ('--params', str(options.params), '--start', str(options.start))
    if options.duration is not None:
        yield from ('--duration', str(options.duration))
    if options.plot is not None:
        yield from ('--plot', str(folder / options.plot.name))
    if options.truth:
        yield from ('--truth', *options.truth)
    is_of_ros = False
    for argument in args:
        is_of_ros = argument == '--ros-args' or (is_of_ros and argument != '--')
        if is_of_ros:
            yield argument


def _localize(
    name: str, output: Path, arguments: Sequence[str], running: list[subprocess.Popen[str]]
) -> Tree:
    """Localize one bag in a process of its own; return exit code, report and error."""
    (output / name).mkdir()
    report = output / name / REPORT
    # In a session of its own Ctrl-C does not reach it twice, which would end it at once.
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
    # One that a signal ended has a negative code.
    code = process.returncode if process.returncode >= 0 else EXIT_FAILED
    found = json.loads(report.read_text(encoding='utf-8')) if report.exists() else None
    is_told = found and (not code or found['ending'] or found['damage'])
    error = '' if is_told else said
    return {
        'name': name,
        'exit_code': code or (EXIT_FAILED if found is None else 0),
        'error': error,
        'report': found,
    }


def many_as_json(outcomes: Sequence[Tree]) -> str:
    """Return the reports of all bags for programs."""
    return as_json({'bags': list(outcomes)})


def many_as_markdown(outcomes: Sequence[Tree]) -> str:
    """Return the reports of all bags for a person: a line each, and what failed."""
    columns = (
        *('bag', 'ticks', 'with one hypothesis', 'contradictory', 'measurements', 'rejected'),
        *('median width, by robot', 'truth inside', 'ended'),
    )
    rows = [_cells(outcome) for outcome in outcomes]
    return as_markdown(f'{len(outcomes)} bags', [Table(columns, rows)])


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


MANY_REPORTS: Mapping[str, Callable[[Sequence[Tree]], str]] = {
    '.json': many_as_json,
    '.md': many_as_markdown,
}
