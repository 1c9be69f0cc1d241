# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels and the same functions in Python give the same bits, and leave no array."""

from functools import partial
import os

from plain_python import in_plain_python, run_python
import pytest
from solver_cases import assert_same, random_case

from benchmarks.problems import fleet
from dg_localization import SolverOptions, solve


@pytest.fixture(scope='module')
def numba():
    return pytest.importorskip('numba')


def check(questions):
    """Ask with compiled kernels and without; return the answers."""
    calls = [partial(solve, *question) for question in questions]
    plain = in_plain_python(calls)
    for call, answer in zip(calls, plain, strict=True):
        assert_same(call(), answer)
    return plain


def test_the_paper_fleet(numba):
    plain = check([(problem,) for problem in (fleet(), fleet(sides=True), fleet(0.03))])
    assert len(plain[0].hypotheses) == 8


def test_random_fleets(numba):
    cases = [random_case(seed, max_points=6) for seed in range(40)]
    check([(c.problem, SolverOptions(c.options.resolution, max_boxes=4)) for c in cases])


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
from dg_localization import Problem, SolverOptions, Verdict, solve
from dg_localization.interval.kernels import COMPILED
assert not COMPILED
positions = np.random.default_rng(3).uniform(0.0, 10.0, (10, 2))
squared = ((positions[:, None] - positions) ** 2).sum(axis=2)
problem = Problem(0.98 * squared, 1.02 * squared, 2)
class Cancel:
    def __init__(self, at):
        self.at, self.looks = at, 0
    def is_set(self):
        self.looks += 1
        return self.looks > self.at
whole = Cancel(10**9)
found = solve(problem, cancel=whole)
assert found.verdict is Verdict.COVERED and found.statistics.processed == 1
assert whole.looks > 45, whole.looks
# The last few looks come after the search.
for at in range(1, whole.looks - 5, whole.looks // 5):
    part = Cancel(at)
    left = solve(problem, cancel=part)
    assert left.verdict is Verdict.OUT_OF_BUDGET and left.statistics.processed == 0, at
    assert part.looks <= at + 3, (at, part.looks)
    (hypothesis,) = left.hypotheses
    outside = ~((hypothesis.lower <= squared) & (squared <= hypothesis.upper))
    assert not outside[~np.eye(10, dtype=bool)].any()
again = solve(problem)
assert np.array_equal(again.hypotheses[0].boxes, found.hypotheses[0].boxes)
"""


def test_looks_within_one_box():
    done = run_python(CODE, NUMBA_DISABLE_JIT='1')
    assert done.returncode == 0, done.stderr
