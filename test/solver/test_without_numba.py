# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Compiled kernels and the same functions in Python give the same bounds to the last bit."""

import os
from pathlib import Path
import pickle
import subprocess
import sys

import numpy as np
import pytest
from solver_cases import random_case

from dg_localization import SolverOptions, solve

REPOSITORY = Path(__file__).parents[2]
SOLVE_ALL = """
import pickle, sys
from dg_localization import solve
questions = pickle.load(sys.stdin.buffer)
pickle.dump([solve(*question) for question in questions], sys.stdout.buffer)
"""


def solve_without_numba(questions):
    finished = subprocess.run(
        [sys.executable, '-c', SOLVE_ALL],
        input=pickle.dumps(questions),
        capture_output=True,
        cwd=REPOSITORY,
        env=os.environ | {'NUMBA_DISABLE_JIT': '1'},
        timeout=200,
    )
    assert finished.returncode == 0, finished.stderr.decode()
    return pickle.loads(finished.stdout)


def assert_identical(results, others):
    for index, (result, other) in enumerate(zip(results, others, strict=True)):
        assert result.verdict is other.verdict, index
        assert len(result.hypotheses) == len(other.hypotheses), index
        for hypothesis, twin in zip(result.hypotheses, other.hypotheses, strict=True):
            assert np.array_equal(hypothesis.boxes, twin.boxes), index
            assert (hypothesis.proved, hypothesis.flexible) == (twin.proved, twin.flexible), index


@pytest.fixture(scope='module')
def numba():
    return pytest.importorskip('numba')


def test_the_paper_fleet(numba, paper_fleet):
    questions = [
        (paper_fleet.problem(sides), SolverOptions()) for sides in ((), paper_fleet.SIDES)
    ] + [(paper_fleet.noisy_problem(0.03), SolverOptions())]
    plain = solve_without_numba(questions)
    assert_identical([solve(*question) for question in questions], plain)
    assert len(plain[0].hypotheses) == 8


def test_random_fleets(numba):
    cases = [random_case(seed, max_points=6) for seed in range(40)]
    questions = [(c.problem, SolverOptions(c.options.resolution, max_boxes=4)) for c in cases]
    assert_identical([solve(*question) for question in questions], solve_without_numba(questions))
