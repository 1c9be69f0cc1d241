# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fleets of any size a double can tell: no placement is lost, and no bound becomes NaN."""

import math

import numpy as np
import pytest
from solver_cases import Case, covers, random_case

from dg_localization import Problem, SolverOptions

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
    return Case(
        Problem(*bounds, problem.dimension, problem.sides, problem.chiralities),
        SolverOptions(options.resolution * size, options.max_boxes),
        case.positions * size,
    )


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
