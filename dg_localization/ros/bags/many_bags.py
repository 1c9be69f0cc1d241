# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Several bags, each localized by a process of its own: on this machine, or on those of a cluster.

Bags are independent of each other, so that nothing is shared but the files. The workers of a Dask
cluster read the bags and write the answers under the paths that are given here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
import json
from pathlib import Path
import shutil
import subprocess
import sys
from tempfile import TemporaryFile
import threading
from typing import Any

from dg_localization.optional import install_hint
from dg_localization.ros.executables import EXIT_FAILED, ExecutableError, UsageError
from dg_localization.ros.terminal import LINE_PERIOD_S, print_line, told_while_waiting

REPORT = 'report.json'
"""What the report of one bag is called, beside its answers."""

ANSWERS = 'answers'
"""What the bag with the answers is called."""

LOOK_S = 0.1
"""How long to wait for a process before looking whether to stop."""

MOST_ERROR_LINES = 5
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
    report : dict or None
        Its report as JSON has it; None where there is none.
    error : str
        What was said last where there is no report, or it does not say what went wrong.

    """

    name: str
    exit_code: int
    report: dict[str, Any] | None
    error: str


def by_name(bags: Sequence[Path]) -> dict[str, Path]:
    """
    Return bags by what the folder of each is called.

    Raises
    ------
    UsageError
        If two bags would be given the same folder.

    """
    names = [bag.resolve().stem if bag.is_file() else bag.resolve().name for bag in bags]
    for name in names:
        if names.count(name) > 1:
            raise UsageError(f"two bags are called '{name}'; their answers need different names")
    return dict(zip(names, bags, strict=True))


def localize_many(
    bags: Mapping[str, Path],
    output: Path,
    arguments: Sequence[str],
    jobs: int,
    scheduler: str | None,
    picture: str | None = None,
) -> list[BagOutcome]:
    """
    Localize several bags.

    Parameters
    ----------
    bags : mapping of str to Path
        The bags, by what the folder of each is called.
    output : Path
        A folder to make, with a folder for each bag.
    arguments : sequence of str
        The other arguments of `localize_bag`, the same for all.
    jobs : int
        How many bags to localize at a time on this machine.
    scheduler : str or None
        The address of a Dask scheduler; this machine does the work without one.
    picture : str, optional
        What the picture of each bag is called, beside its report; none is drawn without.

    Returns
    -------
    list of BagOutcome
        In the order of the bags.

    Raises
    ------
    UsageError
        If there is no such scheduler.

    """
    stop = threading.Event()
    # No event reaches another machine: what runs there is left to end.
    localize = _localize if scheduler else partial(_localize, stopped=stop.is_set)
    outcomes: dict[str, BagOutcome] = {}
    telling = told_while_waiting(f'localizing {len(bags)} bags', LINE_PERIOD_S)
    with _executor(jobs, scheduler) as executor, telling:
        output.mkdir(parents=True)
        futures = {}
        for name, bag in bags.items():
            folder = (output / name).resolve()
            # What follows the arguments of ROS would be taken for one of these.
            drawn = ['--plot', str(folder / picture)] if picture else []
            given = [*drawn, *arguments]
            futures[executor.submit(localize, bag.resolve(), folder, given)] = name
        try:
            for done, future in enumerate(as_completed(futures), start=1):
                name = futures[future]
                outcomes[name] = _outcome_of(future, name)
                print_line(f'{done} of {len(bags)} bags: {_progress_of(outcomes[name])}')
        finally:
            stop.set()
            for future in futures:
                future.cancel()
        return [outcomes[name] for name in bags]


def _outcome_of(future: Future[BagOutcome], name: str) -> BagOutcome:
    """Return what became of a bag, also where the worker that had it is lost."""
    try:
        return future.result()
    except Exception as error:  # of a task that is lost, whatever its executor raises
        return BagOutcome(name, EXIT_FAILED, None, f'{type(error).__name__}: {error}')


@contextmanager
def _executor(jobs: int, scheduler: str | None) -> Iterator[Executor]:
    """Return who takes the tasks: a thread waits for each process here."""
    if scheduler is None:
        with ThreadPoolExecutor(jobs) as threads:
            yield threads
        return
    try:
        from distributed import Client
    except ImportError:
        raise ExecutableError(
            f'--scheduler needs the package distributed; {install_hint("distributed")}'
        ) from None
    try:
        client = Client(scheduler)
    except (OSError, ValueError) as error:
        text = f"--scheduler '{scheduler}': no Dask scheduler answers: {error}"
        raise UsageError(text) from None
    if not client.scheduler_info()['workers']:
        print_line(f'the Dask scheduler {scheduler} has no workers; waiting for some')
    with client, client.get_executor(pure=False) as executor:
        yield executor


def _never() -> bool:
    return False


def _localize(
    bag: Path,
    folder: Path,
    arguments: Sequence[str],
    stopped: Callable[[], bool] = _never,
) -> BagOutcome:
    """Localize one bag in a process of its own, where this is called."""
    if folder.exists():
        # A cluster repeats what a lost worker had begun.
        shutil.rmtree(folder)
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
            if stopped():
                process.terminate()
                process.wait()
            with suppress(subprocess.TimeoutExpired):
                process.wait(LOOK_S)
        errors.seek(0)
        said = '\n'.join(errors.read().strip().splitlines()[-MOST_ERROR_LINES:])
    # One that a signal ended has a negative code.
    code = process.returncode if process.returncode >= 0 else EXIT_FAILED
    if not report.exists():
        return BagOutcome(folder.name, code or EXIT_FAILED, None, said)
    found = json.loads(report.read_text(encoding='utf-8'))
    is_told = not code or found['ending'] or found['damage']
    last = '' if is_told else ''.join(said.splitlines()[-1:])
    return BagOutcome(folder.name, code, found, last)


def _progress_of(outcome: BagOutcome) -> str:
    """Return a line about one bag."""
    if outcome.report is None:
        return f'{outcome.name} failed: {outcome.error}'
    return f'{outcome.name}: {outcome.report["ticks"]} ticks'


def many_as_json(outcomes: Sequence[BagOutcome]) -> str:
    """Return the reports of all bags for programs, and their sums."""
    reports = [outcome.report for outcome in outcomes if outcome.report is not None]
    tree = {
        'bags': [
            {
                'name': outcome.name,
                'exit_code': outcome.exit_code,
                'error': outcome.error,
                'report': outcome.report,
            }
            for outcome in outcomes
        ],
        'ticks': sum(report['ticks'] for report in reports),
        'accepted': sum(report['accepted'] for report in reports),
        'rejected': sum(sum(report['rejected'].values()) for report in reports),
        'contradictions': sum(len(report['contradictions']) for report in reports),
    }
    return json.dumps(tree, indent=2, allow_nan=False) + '\n'


def many_as_markdown(outcomes: Sequence[BagOutcome]) -> str:
    """Return the reports of all bags for a person: a line each, and what failed."""
    lines = [
        f'# {len(outcomes)} bags',
        '',
        '| bag | ticks | with one hypothesis | contradictory | measurements | rejected '
        '| median width, widest robot | truth inside | ended |',
        '|---|---|---|---|---|---|---|---|---|',
    ]
    lines += [_row(outcome) for outcome in outcomes]
    return '\n'.join(lines) + '\n'


def _row(outcome: BagOutcome) -> str:
    """Return the line of one bag."""
    report = outcome.report
    if report is None:
        return f'| {outcome.name} | | | | | | | | {" ".join(outcome.error.split())} |'
    widths_m = report['median_enclosure_width_m'].values()
    if report['ticks_by_hypotheses'].keys() <= {'0'}:
        width = 'no placement'
    else:
        width = 'not bounded' if None in widths_m else f'{max(widths_m):.2f} m'
    truth = report['truth']
    cells = (
        outcome.name,
        report['ticks'],
        report['ticks_by_hypotheses'].get('1', 0),
        sum(found['ticks'] for found in report['contradictions']),
        report['accepted'],
        sum(report['rejected'].values()),
        width,
        f'{truth["held"]} of {truth["compared"]}' if truth else '',
        ' '.join(filter(None, [report['ending'], *report['damage'], outcome.error]))
        or 'at its end',
    )
    return f'| {" | ".join(map(str, cells))} |'


MANY_REPORTS: dict[str, Callable[[Sequence[BagOutcome]], str]] = {
    '.json': many_as_json,
    '.md': many_as_markdown,
}
