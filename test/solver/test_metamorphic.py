# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What must not change, or change in a known way, when a question is put differently."""

from dataclasses import replace

import numpy as np
import pytest
from solver_cases import random_case

from dg_localization import Problem, SolverOptions, solve

SEEDS = range(60)


def cover_of(result):
    """Return all boxes of a result, in order."""
    return [box for hypothesis in result.hypotheses for box in hypothesis.boxes]


def assert_same_cover(result, other, factor=1.0):
    assert result.verdict is other.verdict
    assert len(result.hypotheses) == len(other.hypotheses)
    for box, other_box in zip(cover_of(result), cover_of(other), strict=True):
        assert np.array_equal(factor * box, other_box)


@pytest.mark.parametrize('power', [-25, 3, 30])
def test_scaling_by_a_power_of_two_scales_every_bound_exactly(paper_fleet, power):
    scale = 2.0**power
    problems = [(paper_fleet.problem(), SolverOptions())] + [
        (case.problem, case.options) for case in map(random_case, SEEDS)
    ]
    for index, (problem, options) in enumerate(problems):
        scaled = Problem(
            problem.lower * scale**2,
            problem.upper * scale**2,
            problem.dimension,
            problem.sides,
            problem.chiralities,
        )
        result = solve(problem, options)
        if any(
            0.0 < smallest < 1e-200
            for h in result.hypotheses
            for smallest in (*h.lower.ravel(), *h.upper.ravel())
        ):
            continue  # the step of a bound near zero is absolute
        other = solve(scaled, replace(options, resolution=options.resolution * scale))
        try:
            assert_same_cover(result, other, scale**2)
        except AssertionError as error:
            error.add_note(f'This was problem {index}.')
            raise
