# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Kernels that count no references leave no array behind."""

import os

import pytest
from solver_cases import random_case

from dg_localization import solve


def test_all_arrays_are_freed(paper_fleet):
    runtime = pytest.importorskip('numba.core.runtime')
    if os.environ.get('NUMBA_DISABLE_JIT') == '1':
        pytest.skip('nothing is compiled')
    problems = [paper_fleet.problem(), paper_fleet.problem(paper_fleet.SIDES)]
    cases = [random_case(seed, max_points=6) for seed in range(20)]
    runtime._nrt_python.memsys_enable_stats()
    before = runtime.rtsys.get_allocation_stats()
    for problem in problems:
        solve(problem)
    for case in cases:
        case.solve()
    after = runtime.rtsys.get_allocation_stats()
    assert after.mi_alloc > before.mi_alloc
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free
