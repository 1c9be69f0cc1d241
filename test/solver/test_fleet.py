# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The paper's fleet (Section 5.1) against the paper and against its exact hulls."""

from joined_cases import solve_as_one
import numpy as np
import pytest
from solver_cases import covers

from dg_localization import SolverOptions, Verdict, solve


def holds_hull(hypothesis, hull):
    return all(
        hypothesis.lower[pair] <= low and high <= hypothesis.upper[pair]
        for pair, (low, high) in hull.items()
    )


def test_the_eight_solutions_are_found_without_a_wasted_box(paper_fleet):
    result = solve(paper_fleet.problem())
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == 8
    done = result.statistics
    assert (done.processed, done.empty, done.kept) == (4, 0, 4), 'one box for each triangle'
    assert all(hypothesis.proved for hypothesis in result.hypotheses)
    assert not any(hypothesis.flexible for hypothesis in result.hypotheses)
    for hull in paper_fleet.exact_hulls:
        assert sum(holds_hull(hypothesis, hull) for hypothesis in result.hypotheses) == 1


@pytest.mark.parametrize('solver', [solve, solve_as_one])
def test_three_sides_leave_the_solution_of_the_paper(paper_fleet, solver):
    result = solver(paper_fleet.problem(paper_fleet.SIDES))
    assert result.verdict is Verdict.COVERED
    assert result.statistics.processed == len(result.pieces), 'nothing is split'
    (hypothesis,) = result.hypotheses
    assert hypothesis.proved and not hypothesis.flexible
    (hull,) = (
        hull
        for hull, solution in zip(paper_fleet.exact_hulls, paper_fleet.solutions, strict=True)
        if solution['in_D3']
    )
    assert holds_hull(hypothesis, hull)
    for pair, (low, high) in paper_fleet.paper_d3.items():
        assert hypothesis.lower[pair] >= low - 0.02, pair
        assert hypothesis.upper[pair] <= high + 0.02, pair


@pytest.mark.parametrize('relative_error', [0.01, 0.03, 0.05])
@pytest.mark.parametrize(('n_sides', 'n_hypotheses'), [(0, 8), (3, 1)])
def test_noise_adds_no_hypothesis(paper_fleet, relative_error, n_sides, n_hypotheses):
    sides = paper_fleet.SIDES[:n_sides]
    result = solve(paper_fleet.noisy_problem(relative_error, sides))
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == n_hypotheses
    assert result.statistics.processed <= 31
    assert all(hypothesis.proved for hypothesis in result.hypotheses)
    for solution in paper_fleet.solutions:
        if solution['in_D3'] or not sides:
            assert covers(result, paper_fleet.squared(solution))


def test_without_sides_every_hypothesis_is_tightened_to_its_exact_hull(paper_fleet):
    result = solve(paper_fleet.problem(), SolverOptions(tighten_seconds=np.inf))
    assert len(result.hypotheses) == len(paper_fleet.exact_hulls)
    for hull in paper_fleet.exact_hulls:
        (found,) = (found for found in result.hypotheses if holds_hull(found, hull))
        for pair, (low, high) in hull.items():
            assert found.upper[pair] - found.lower[pair] < 1.02 * (high - low), pair


def test_no_box_is_tightened_when_its_time_is_over(paper_fleet):
    problem = paper_fleet.noisy_problem(0.03, paper_fleet.SIDES)
    wide, late, tight = (
        solve(problem, SolverOptions(tighten_seconds=seconds)) for seconds in (0.0, 1e-9, np.inf)
    )
    assert late.verdict is wide.verdict
    assert (late.lower == wide.lower).all() and (late.upper == wide.upper).all()
    assert (tight.upper < wide.upper).any()
