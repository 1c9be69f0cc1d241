# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The warm-up: afterwards no estimate waits for a kernel."""

import os
from pathlib import Path
import sys

from plain_python import run_python
import pytest

# Without numba there is nothing to compile.
pytest.importorskip('numba', reason='numba is not installed')


CODE = """
import sys
import histories
from numba.core.dispatcher import Dispatcher
from benchmarks.pieces import TABLES
from dg_localization import SolverOptions, solve
from dg_localization.fleet import warm_up

def compiled():
    modules = [m for name, m in list(sys.modules.items()) if name.startswith('dg_localization.')]
    values = [value for module in modules for value in vars(module).values()]
    kernels = {value for value in values if isinstance(value, Dispatcher)}
    return {k.py_func.__qualname__: len(k.signatures) for k in kernels if k.signatures}

warm_up()
before = compiled()
for seed in range(1, 4):
    for dimension in (2, 3):
        histories.play_seed(seed, dimension)
rows = [row for table in TABLES.values() for row in table if row.n_points in (20, 50)]
for row in rows:
    for hypothesis in solve(row.problem(0), SolverOptions(max_seconds=0.2)).hypotheses:
        hypothesis.proved, hypothesis.upper
assert before and compiled() == before, set(compiled().items()) - set(before.items())
"""


def test_estimates_and_solutions_compile_nothing():
    path = os.pathsep.join([str(Path(__file__).parent), *sys.path])
    done = run_python(CODE, PYTHONPATH=path)
    assert done.returncode == 0, done.stderr
