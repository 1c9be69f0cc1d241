# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fleets of any size lose nothing; scaled by two, or in plain Python, they give the same bits."""

from dataclasses import replace
from functools import partial
import math
import os
import sys

import numpy as np
from plain_python import in_plain_python, run_python
import pytest
from solver_cases import Case, assert_same, covers, random_case

from benchmarks.problems import fleet, fleet_placements
from dg_localization import Problem, SolverOptions, solve

LARGEST = None
"""The exponent at which the longest squared distance is about the largest double."""


def scaled(case, exponent):
    """Return a case 2^exponent times as large; a power of two keeps it exact."""
    if exponent is LARGEST:
        exponent = math.floor(511.5 - 0.5 * math.log2(max(case.squared.max(), 1.0)))
    size = 2.0**exponent
    problem, options = case.problem, case.options
    with np.errstate(over='ignore'):
        bounds = [bound * size * size for bound in (problem.lower, problem.upper)]
    larger = Problem(*bounds, problem.dimension, problem.sides, problem.chiralities)
    options = replace(options, resolution=options.resolution * size)
    return Case(larger, options, case.positions * size)


@pytest.mark.parametrize('exponent', [-490, -300, 300, 440, LARGEST])
def test_no_truth_is_lost(exponent):
    for seed in range(1, 200):
        case = scaled(random_case(seed, max_points=6), exponent)
        result = case.solve()
        assert covers(result, case.squared), seed
        for hypothesis in result.hypotheses:
            assert not np.isnan(hypothesis.boxes).any(), seed
            assert np.isfinite(hypothesis.positions).all(), seed
            assert (hypothesis.upper <= case.problem.upper).all(), seed


@pytest.mark.parametrize('power', [-25, 3, 30])
def test_scaling_by_a_power_of_two_scales_every_bound_exactly(power):
    paper = Case(fleet(), SolverOptions(), fleet_placements()[0])
    for index, case in enumerate([paper, *map(random_case, range(60))]):
        result = case.solve()
        if any(
            0.0 < smallest < 1e-200
            for h in result.hypotheses
            for smallest in (*h.lower.ravel(), *h.upper.ravel())
        ):
            continue  # the step of a bound near zero is absolute
        try:
            assert_same(result, scaled(case, power).solve(), 2.0**power)
        except AssertionError as error:
            error.add_note(f'This was problem {index}.')
            raise


def test_compiled_kernels_and_python_agree_to_the_last_bit():
    pytest.importorskip('numba')
    cases = [random_case(seed, max_points=6) for seed in range(40)]
    questions = [(problem,) for problem in (fleet(), fleet(sides=True), fleet(0.03))]
    questions += [(c.problem, SolverOptions(c.options.resolution, max_boxes=4)) for c in cases]
    calls = [partial(solve, *question) for question in questions]
    for call, plain in zip(calls, in_plain_python(calls), strict=True):
        assert_same(call(), plain)


def test_all_arrays_are_freed():
    runtime = pytest.importorskip('numba.core.runtime')
    if os.environ.get('NUMBA_DISABLE_JIT') == '1':
        pytest.skip('nothing is compiled')
    cases = [random_case(seed, max_points=6) for seed in range(20)]
    runtime._nrt_python.memsys_enable_stats()
    before = runtime.rtsys.get_allocation_stats()
    solve(fleet())
    solve(fleet(sides=True))
    for case in cases:
        case.solve()
    after = runtime.rtsys.get_allocation_stats()
    assert after.mi_alloc > before.mi_alloc
    assert after.mi_alloc - before.mi_alloc == after.mi_free - before.mi_free


# Ten points, all pairs measured: at first one call contracted the box without a look.
CODE = """
import numpy as np
from solver_cases import CancelAfter, holding, squared_distances
from dg_localization import Problem, Verdict, solve
from dg_localization.interval.kernels import COMPILED
assert not COMPILED
squared = squared_distances(np.random.default_rng(3).uniform(0.0, 10.0, (10, 2)))
problem = Problem(0.98 * squared, 1.02 * squared, 2)
whole = CancelAfter(10**9)
found = solve(problem, cancel=whole)
assert found.verdict is Verdict.COVERED and found.statistics.processed == 1
n_looks = 10**9 - whole.left
assert n_looks > 45, n_looks
# The last few looks come after the search.
for at in range(1, n_looks - 5, n_looks // 5):
    part = CancelAfter(at)
    left = solve(problem, cancel=part)
    assert left.verdict is Verdict.OUT_OF_BUDGET and left.statistics.processed == 0, at
    assert -part.left <= 3, (at, part.left)
    assert len(left.hypotheses) == len(holding(left.hypotheses, squared)) == 1
again = solve(problem)
assert np.array_equal(again.hypotheses[0].boxes, found.hypotheses[0].boxes)
"""


def test_looks_within_one_box():
    done = run_python(CODE, NUMBA_DISABLE_JIT='1', PYTHONPATH=os.pathsep.join(sys.path))
    assert done.returncode == 0, done.stderr
