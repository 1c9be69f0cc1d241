# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What must not change, or change in a known way, when a question is put differently."""

from dataclasses import replace

import numpy as np
import pytest
from solver_cases import random_case

from dg_localization import Chirality, Problem, SideConstraint, SolverOptions, Verdict, solve

SEEDS = range(60)


def cover_of(result):
    """Return all boxes of a result, in order."""
    return [box for hypothesis in result.hypotheses for box in hypothesis.boxes]


def assert_same_cover(result, other, factor=1.0):
    assert result.verdict is other.verdict
    assert len(result.hypotheses) == len(other.hypotheses)
    for box, other_box in zip(cover_of(result), cover_of(other), strict=True):
        assert np.array_equal(factor * box, other_box)


def relabelled(problem, order):
    """Return the problem whose point k is point order[k] of `problem`."""
    new = {int(old): k for k, old in enumerate(order)}
    return Problem(
        problem.lower[np.ix_(order, order)],
        problem.upper[np.ix_(order, order)],
        problem.dimension,
        [
            SideConstraint(tuple(new[p] for p in c.face), new[c.first], new[c.second], c.side)
            for c in problem.sides
        ],
        [Chirality(tuple(new[p] for p in c.points), c.sign) for c in problem.chiralities],
    )


@pytest.mark.parametrize('relative_error', [0.0001, 0.03])
@pytest.mark.parametrize('n_sides', [0, 3])
def test_relabelling_the_fleet_relabels_the_answer(paper_fleet, relative_error, n_sides):
    """The axes are tried in another order, so the hulls agree up to the last sweep's gain."""
    problem = paper_fleet.noisy_problem(relative_error, paper_fleet.SIDES[:n_sides])
    known = solve(problem)
    for seed in range(5):
        order = np.random.default_rng(seed).permutation(problem.n_points)
        result = solve(relabelled(problem, order))
        assert result.verdict is Verdict.COVERED
        assert len(result.hypotheses) == len(known.hypotheses)
        for hypothesis in known.hypotheses:
            lower = hypothesis.lower[np.ix_(order, order)]
            upper = hypothesis.upper[np.ix_(order, order)]
            allowed = 0.25 * (upper - lower) + 1e-6
            assert any(
                np.all(abs(h.lower - lower) <= allowed) and np.all(abs(h.upper - upper) <= allowed)
                for h in result.hypotheses
            )


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
