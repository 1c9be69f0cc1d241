# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fleets of any size: no placement is lost, and a power of two scales every bound exactly."""

from dataclasses import replace
import math

import numpy as np
import pytest
from solver_cases import Case, assert_same, covers, random_case

from benchmarks.problems import fleet, fleet_placements
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
        replace(options, resolution=options.resolution * size),
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
