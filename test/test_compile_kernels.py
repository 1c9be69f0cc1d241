# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The executable that compiles the kernels: what it prints, and when it fails."""

import os
from pathlib import Path
import subprocess
import sys

import pytest

REPOSITORY = Path(__file__).parents[1]


def compile_kernels(*arguments, code=None, **environment):
    command = ['-c', code] if code else ['-m', 'dg_localization.compile_kernels', *arguments]
    return subprocess.run(
        [sys.executable, *command],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        cwd=REPOSITORY,
        timeout=280.0,
    )


def test_ready_kernels_are_reported_with_their_folder():
    numba = pytest.importorskip('numba', reason='numba is not installed')
    if numba.config.DISABLE_JIT:
        pytest.skip('nothing is compiled')
    done = compile_kernels()
    assert done.returncode == 0, done.stderr
    assert 'The kernels are ready after' in done.stdout and 'dg_localization' in done.stdout


def test_progress_is_printed_while_it_goes_on():
    code = """
import sys
from threading import Event
from dg_localization import compile_kernels
from dg_localization.interval import kernels
import dg_localization.fleet
warming = sys.modules['dg_localization.fleet.warm_up']
warming.REPORT_PERIOD_S = 0.01
counts = iter([0, 0, 2, 2, 7])
shown = Event()
compiled = 0
def progress():
    global compiled
    compiled = next(counts, None) if not shown.is_set() else 7
    if compiled is None:
        shown.set()
        compiled = 7
    return kernels.CompileProgress(compiled, 9)
warming.compile_progress = progress
warming.warm_up_status = lambda: f'compiling the solver: {compiled} of 9 kernels'
warming._load_all = lambda: shown.wait(60.0)
raise SystemExit(compile_kernels.main([]))
"""
    pytest.importorskip('numba', reason='numba is not installed')
    done = compile_kernels(code=code, NUMBA_DISABLE_JIT='0')
    assert done.returncode == 0, done.stderr
    lines = [line.partition(',')[0] for line in done.stderr.splitlines()]
    told = 'compiling the solver: {} of 9 kernels'
    assert lines == [told.format(2), told.format(7)]


def test_without_numba_it_says_how_to_install_it():
    code = """
import sys
sys.modules['numba'] = None
from dg_localization.compile_kernels import main
sys.exit(main([]))
"""
    done = compile_kernels(code=code)
    assert done.returncode == 1 and done.stdout == ''
    for text in ('in Python', '100 times slower', 'not installed', 'pip install numba'):
        assert text in done.stderr


def test_switched_off_compiler_is_named():
    pytest.importorskip('numba', reason='numba is not installed')
    done = compile_kernels(NUMBA_DISABLE_JIT='1')
    assert done.returncode == 1 and 'NUMBA_DISABLE_JIT is set' in done.stderr


def test_kernels_that_cannot_be_kept_are_a_failure(tmp_path):
    numba = pytest.importorskip('numba', reason='numba is not installed')
    if numba.config.DISABLE_JIT:
        pytest.skip('nothing is compiled')
    tmp_path.chmod(0o777)
    done = compile_kernels(NUMBA_CACHE_DIR=str(tmp_path))
    assert done.returncode == 1 and f'others may write to {tmp_path}' in done.stderr


def test_warm_up_without_numba_compiles_nothing_and_never_says_so():
    code = """
import sys
sys.modules['numba'] = None
from dg_localization.fleet import solver_warnings, warm_up, warm_up_status
warm_up()
(warning,) = solver_warnings()
assert 'compiling' not in warm_up_status() + warning
assert 'numba is not installed' in warning
"""
    done = compile_kernels(code=code)
    assert done.returncode == 0, done.stderr
