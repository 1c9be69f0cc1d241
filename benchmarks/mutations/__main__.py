# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The mutation check: ``python -m benchmarks.mutations [--only PATTERN ...] [--list]``.

Each mutation is applied to a copy of the repository, and the tests that should notice it run
there. One that no test notices has survived: the tests have a hole. Where a kernel is changed, the
kernels run as plain Python, since any change would compile all of them anew.
"""

from __future__ import annotations

import argparse
from fnmatch import fnmatch
import os
from pathlib import Path
import re
import shutil
import subprocess
import sys
import tempfile
import time

from benchmarks.mutations.table import MUTATIONS, Mutation
from benchmarks.report import machine, table

REPOSITORY = Path(__file__).parents[2]
PACKAGES = ('dg_localization', 'msg_adapters')
COPIED = (*PACKAGES, 'benchmarks', 'test', 'config', 'docs', 'README.md', 'pyproject.toml')
SHORT = {'DG_PROPERTY_PAIRS': '100', 'DG_PROPERTY_FLEETS': '8', 'DG_PROPERTY_PROBLEMS': '200'}
"""Fewer random cases: a break that needs thousands to show has not been caught."""

TIMEOUT_S = 900.0
CAUGHT, SURVIVED, STALE = 'caught', 'SURVIVED', 'STALE'


def copy_repository(folder: Path) -> None:
    """Copy what the tests need, with a link to the recordings beside it."""
    copy = folder / 'repository'
    copy.mkdir()
    for name in COPIED:
        source = REPOSITORY / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns('__pycache__'))
        else:
            shutil.copy(source, copy / name)
    shared = REPOSITORY.parent / 'shared'
    if shared.exists():
        (folder / 'shared').symlink_to(shared)


def run_tests(copy: Path, tests: tuple[str, ...], compiled: bool) -> tuple[bool, str]:
    """Run tests in the copy; return whether they passed, and the first that failed."""
    command = [sys.executable, '-m', 'pytest', '-x', '-q', '-p', 'no:cacheprovider', *tests]
    environment = {**os.environ, **SHORT, 'PYTHONPATH': str(copy)}
    environment['NUMBA_DISABLE_JIT'] = '0' if compiled else '1'
    try:
        run = subprocess.run(
            command, cwd=copy, env=environment, capture_output=True, text=True, timeout=TIMEOUT_S
        )
    except subprocess.TimeoutExpired:
        return False, f'no end within {TIMEOUT_S:.0f} s'
    failed = re.search(r'^(?:FAILED|ERROR) test/(\S+?)(?:\[| - |$)', run.stdout, re.MULTILINE)
    if run.returncode not in (0, 1, 2):
        sys.exit(f'the tests could not be run:\n{run.stdout}\n{run.stderr}')
    return run.returncode == 0, failed.group(1) if failed else ''


def _is_compiled(copy: Path, mutation: Mutation) -> bool:
    """Return whether the compiled kernels that are kept serve: no kernel changes."""
    return '@kernel' not in (copy / mutation.path).read_text(encoding='utf-8')


def check(copy: Path, mutation: Mutation) -> tuple[str, str]:
    """Apply a mutation, run its tests, and take it back; return the outcome and the test."""
    path = copy / mutation.path
    text = path.read_text(encoding='utf-8')
    if text.count(mutation.old) != 1:
        return STALE, f'{text.count(mutation.old)} places to change'
    path.write_text(text.replace(mutation.old, mutation.new), encoding='utf-8')
    try:
        passed, failed = run_tests(copy, mutation.tests, _is_compiled(copy, mutation))
    finally:
        path.write_text(text, encoding='utf-8')
    return (SURVIVED, '') if passed else (CAUGHT, failed)


def main() -> None:
    """Check the mutations and print their table."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.mutations', description=__doc__)
    parser.add_argument(
        '--only', action='append', metavar='PATTERN', help='by file or by what is broken'
    )
    parser.add_argument('--list', action='store_true', help='print the mutations and leave')
    options = parser.parse_args()
    patterns = [f'*{pattern}*' for pattern in options.only or ['']]
    chosen = [m for m in MUTATIONS if any(fnmatch(m.name, pattern) for pattern in patterns)]
    if options.list:
        print('\n'.join(mutation.name for mutation in chosen))
        return
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        copy_repository(Path(folder))
        copy = Path(folder) / 'repository'
        for mutation in chosen:
            begin_s = time.perf_counter()
            outcome, test = check(copy, mutation)
            seconds = time.perf_counter() - begin_s
            room = mutation.path.removeprefix('dg_localization/').removesuffix('.py')
            rows.append([room, mutation.what, outcome, test, f'{seconds:.0f}'])
            print(' | '.join(rows[-1]), file=sys.stderr, flush=True)
        runs = sorted({(test, _is_compiled(copy, one)) for one in chosen for test in one.tests})
        results = [run_tests(copy, (test,), compiled) for test, compiled in runs]
        failed = [first for passed, first in results if not passed]
    print(f'{machine()}\n\n' + table(('file', 'what is broken', '', 'by', 's'), rows))
    caught = sum(row[2] == CAUGHT for row in rows)
    print(f'\n{caught} of {len(rows)} caught; without a mutation the tests', end=' ')
    print(f'FAIL: {failed[0]}' if failed else 'pass')
    sys.exit(0 if not failed and caught == len(rows) else 1)


if __name__ == '__main__':
    main()
