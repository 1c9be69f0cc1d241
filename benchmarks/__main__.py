# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The command line: ``python -m benchmarks [--quick] [--only NAME ...]``."""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
from functools import partial
import sys
import time

try:
    import scipy  # noqa: F401
    from tqdm import tqdm
except ImportError as error:
    sys.exit(f"{error.name} is not installed; the benchmarks need pip install '.[bench]'")

from benchmarks import startup, truth
from benchmarks.cases import Case, all_cases
from benchmarks.contest import (
    FULL,
    QUICK,
    SOLVER,
    Effort,
    Row,
    isolated,
    prepare,
    rows as rows_of_solver,
)
from benchmarks.methods import classical_mds, codac_contractors, multistart, scip
from benchmarks.problems import dietmaier_file
from benchmarks.report import case_report, figures_report, machine, summary
from dg_localization.fleet import warm_up

OTHERS = {other.NAME: other for other in (codac_contractors, multistart, classical_mds, scip)}
STARTUP = 'start-up'
FORMULATIONS = 4
"""The most that another method shows of a case."""
GRACE = 10.0
"""Seconds after its limit until a method is taken to hang."""


NOTE = (
    'Times are medians (minima) of warm runs. Ours is a call of solve, with placements and their '
    "proofs;\nCodac's is its search alone. Widths are those of unknown pairs over the exact hull "
    'or the linearized\nbound: the largest ratio (the median).'
)


def arguments() -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks', description=__doc__)
    parser.add_argument(
        '--quick', action='store_true', help='the short cases only, and little time for the others'
    )
    parser.add_argument(
        '--only',
        action='append',
        metavar='NAME',
        help='only the cases of this name (wildcards allowed, may be repeated)',
    )
    parser.add_argument('--list', action='store_true', help='print the names and leave')
    return parser.parse_args()


def contest(case: Case, effort: Effort, progress: tqdm) -> list[Row]:
    """Run all methods on a case."""
    prepare(case)
    methods = {SOLVER: rows_of_solver}
    methods |= {name: OTHERS[name].rows for name in case.others if not OTHERS[name].missing()}
    rows: list[Row] = []
    for name, method in methods.items():
        progress.set_postfix_str(f'{case.name}: {name}')
        patience = case.max_seconds if name == SOLVER else FORMULATIONS * effort.others
        run = partial(method, case, effort)
        rows += isolated(run, name, effort.measuring + patience + GRACE)
    return rows


def selected(cases: list[Case], patterns: list[str] | None, quick: bool) -> list[Case]:
    """Return the cases that were asked for, or leave with a message when there are none."""
    if patterns is None:
        return [case for case in cases if case.quick or not quick]
    names = [*(case.name for case in cases), STARTUP]
    for pattern in patterns:
        if not any(fnmatch(name, pattern) for name in names):
            sys.exit(f'no case is called {pattern!r}; there are: {", ".join(names)}')
    return [case for case in cases if any(fnmatch(case.name, pattern) for pattern in patterns)]


def print_preamble() -> None:
    """Say what is measured where, and what is missing."""
    print(f'{machine()}\n\n{NOTE}\n')
    for other in OTHERS.values():
        if other.missing():
            print(f'left out: {other.missing()}')
    if not dietmaier_file().exists():
        print(f"left out: Dietmaier's platform, {dietmaier_file()} is not there")
    begin = time.perf_counter()
    warm_up()
    seconds = time.perf_counter() - begin
    print(f'kernels loaded, or compiled for the first time, in {seconds:.1f} s\n', flush=True)


def main() -> None:
    """Run the cases and print their tables."""
    started = time.perf_counter()
    options = arguments()
    cases = all_cases()
    if options.list:
        print('\n'.join([*(case.name for case in cases), STARTUP]))
        return
    full = not options.quick
    cases = selected(cases, options.only, options.quick)
    print_preamble()
    results = []
    with tqdm(cases, unit='case', disable=None) as progress:
        for case in progress:
            rows = contest(case, FULL if full else QUICK, progress)
            results.append((case, rows))
            progress.write(case_report(case, rows))
    patterns = options.only or (['*'] if full else [])
    if any(fnmatch(STARTUP, pattern) for pattern in patterns):
        print(figures_report(STARTUP, [*startup.figures(), *truth.figures()]))
    if len(results) > 1:
        print('### summary\n\n' + summary(results))
    print(f'\n{time.perf_counter() - started:.0f} s in all')


if __name__ == '__main__':
    main()
