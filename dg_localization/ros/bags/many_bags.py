# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Several bags, each localized by a process of its own.

Bags are independent of each other, so that nothing is shared but the files: the answers are the
same whatever the number of processes.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from dataclasses import asdict, dataclass
import json
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryFile
import threading
from typing import Any

from dg_localization.ros.bags.arguments import shared_arguments
from dg_localization.ros.bags.writer import write_text, writing
from dg_localization.ros.executables import EXIT_FAILED, UsageError
from dg_localization.ros.terminal import (
    LINE_PERIOD_S,
    print_line,
    print_result,
    told_while_waiting,
)

REPORT, ANSWERS = 'report.json', 'answers'
"""What the report of one bag and the bag with its answers are called."""

LOOK_S = 0.1
"""How long to wait for a process before looking whether to stop."""

ERROR_LINES = 5
"""So many lines of what a process says last are shown where it fails."""


@dataclass(frozen=True)
class BagOutcome:
    """
    What became of one bag.

    Attributes
    ----------
    name : str
        What its folder is called.
    exit_code : int
        That of `localize_bag`.
    error : str
        What was said last where there is no report, or it does not say what went wrong.
    report : dict or None
        Its report as JSON has it; None where there is none.

    """

    name: str
    exit_code: int
    error: str
    report: dict[str, Any] | None


def by_name(bags: Sequence[Path]) -> dict[str, Path]:
    """Return bags by what the folder of each is called; two of one name are refused."""
    names = [bag.resolve().stem if bag.is_file() else bag.resolve().name for bag in bags]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two bags are called '{name}'; their answers need different names")
    return dict(zip(names, bags, strict=True))


def localize_many(options: argparse.Namespace, args: Sequence[str]) -> int:
    """Localize several bags, print and write what came of all; return the exit code."""
    bags = by_name(options.bags)
    shared = shared_arguments(options, args)
    stop = threading.Event()
    with writing(options.output):
        options.output.mkdir(parents=True)
    telling = told_while_waiting(f'localizing {len(bags)} bags', LINE_PERIOD_S)
    # A thread waits for each process.
    with ThreadPoolExecutor(options.jobs) as threads, telling:
        futures = {}
        for name, bag in bags.items():
            folder = options.output / name
            # What follows the arguments of ROS would be taken for one of these.
            drawn = ['--plot', str(folder / options.plot.name)] if options.plot else []
            futures[name] = threads.submit(_localize, bag, folder, [*drawn, *shared], stop)
        try:
            for done, future in enumerate(as_completed(futures.values()), start=1):
                print_line(f'{done} of {len(bags)} bags: {_progress_of(future.result())}')
        finally:
            stop.set()
            for future in futures.values():
                future.cancel()
    outcomes = [futures[name].result() for name in bags]
    if options.report is not None:
        write_text(options.report, MANY_REPORTS[options.report.suffix](outcomes))
    print_result(many_as_markdown(outcomes))
    return max(outcome.exit_code for outcome in outcomes)


def _localize(
    bag: Path, folder: Path, arguments: Sequence[str], stop: threading.Event
) -> BagOutcome:
    """Localize one bag in a process of its own."""
    folder.mkdir()
    report = folder / REPORT
    command = [sys.executable, '-m', 'dg_localization.ros', 'localize_bag', str(bag)]
    command += ['-o', str(folder / ANSWERS), '--report', str(report), *arguments]
    with TemporaryFile('w+', encoding='utf-8') as errors:
        # Ctrl-C reaches all processes of a session: one that is told to stop twice stops at once,
        # and leaves a bag that cannot be read.
        process = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True
        )
        while process.poll() is None:
            if stop.is_set():
                process.terminate()
                process.wait()
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_S)
        errors.seek(0)
        said = '\n'.join(errors.read().strip().splitlines()[-ERROR_LINES:])
    # One that a signal ended has a negative code.
    code = process.returncode if process.returncode >= 0 else EXIT_FAILED
    if not report.exists():
        return BagOutcome(folder.name, code or EXIT_FAILED, said, None)
    found = json.loads(report.read_text(encoding='utf-8'))
    is_told = not code or found['ending'] or found['damage']
    last = '' if is_told else ''.join(said.splitlines()[-1:])
    return BagOutcome(folder.name, code, last, found)


def _progress_of(outcome: BagOutcome) -> str:
    if outcome.report is None:
        return f'{outcome.name} failed: {outcome.error}'
    return f'{outcome.name}: {outcome.report["ticks"]} ticks'


def many_as_json(outcomes: Sequence[BagOutcome]) -> str:
    """Return the reports of all bags for programs, and their sums."""
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    tree = {
        'bags': [asdict(outcome) for outcome in outcomes],
        'ticks': sum(report['ticks'] for report in reports),
        'accepted': sum(report['accepted'] for report in reports),
        'rejected': sum(sum(report['rejected'].values()) for report in reports),
        'contradictions': sum(len(report['contradictions']) for report in reports),
    }
    return json.dumps(tree, indent=2, allow_nan=False) + '\n'


def many_as_markdown(outcomes: Sequence[BagOutcome]) -> str:
    """Return the reports of all bags for a person: a line each, and what failed."""
    columns = (
        'bag',
        'ticks',
        'with one hypothesis',
        'contradictory',
        'measurements',
        'rejected',
        'median width, widest robot',
        'truth inside',
        'ended',
    )
    rows = [columns, ['---'] * len(columns), *map(_cells, outcomes)]
    lines = ['| ' + ' | '.join(map(str, row)) + ' |' for row in rows]
    return '\n'.join([f'# {len(outcomes)} bags', '', *lines]) + '\n'


def _cells(outcome: BagOutcome) -> list[Any]:
    """Return the row of one bag."""
    report = outcome.report
    if report is None:
        return [outcome.name, *[''] * 7, ' '.join(outcome.error.split())]
    widths_m = report['median_enclosure_width_m'].values()
    if report['ticks_by_hypotheses'].keys() <= {'0'}:
        width = 'no placement'
    else:
        width = 'not bounded' if None in widths_m else f'{max(widths_m):.2f} m'
    truth = report['truth']
    ended = ' '.join(filter(None, [report['ending'], *report['damage'], outcome.error]))
    return [
        outcome.name,
        report['ticks'],
        report['ticks_by_hypotheses'].get('1', 0),
        sum(found['ticks'] for found in report['contradictions']),
        report['accepted'],
        sum(report['rejected'].values()),
        width,
        f'{truth["held"]} of {truth["compared"]}' if truth else '',
        ended or 'at its end',
    ]


MANY_REPORTS: Mapping[str, Callable[[Sequence[BagOutcome]], str]] = {
    '.json': many_as_json,
    '.md': many_as_markdown,
}
