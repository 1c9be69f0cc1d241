# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The paper's fleet (5.1) and octahedral manipulator (5.2) against the paper and exact truths."""

import json

from joined_cases import solve_as_one
import numpy as np
import pytest
from solver_cases import bounds, covers

from dg_localization import Problem, Side, SideConstraint, SolverOptions, Verdict, solve


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


RESOLUTION = 1e-3
CONVEX = '124|3,5'
"""The side that singles out the convex octahedron; the paper's six leave two postures."""


@pytest.fixture(scope='module')
def truth(shared):
    return json.loads((shared / 'truth/octahedral.json').read_text())


def pair(name):
    return int(name[1]) - 1, int(name[2]) - 1


def same_side(name):
    face, apexes = name.split('|')
    first, second = (int(apex) - 1 for apex in apexes.split(','))
    return SideConstraint(tuple(int(point) - 1 for point in face), first, second, Side.SAME)


def solve_with(truth, sides):
    squared = {
        pair(name): value if name[0] == 's' else value**2
        for names, value in truth['distances'].items()
        for name in names.split(',')
    }
    lower, upper = bounds(
        6, {p: (np.nextafter(s, 0.0), np.nextafter(s, np.inf)) for p, s in squared.items()}
    )
    problem = Problem(lower, upper, dimension=3, sides=[same_side(name) for name in sides])
    return solve(problem, SolverOptions(resolution=RESOLUTION))


def check(result, solutions, most_boxes):
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == len(solutions)
    assert result.statistics.processed <= most_boxes
    for solution in solutions:
        holding = [
            hypothesis
            for hypothesis in result.hypotheses
            if all(
                # The truth is given to 16 digits: it may be a unit outside.
                hypothesis.lower[p] <= value * (1 + 1e-14)
                and value * (1 - 1e-14) <= hypothesis.upper[p]
                for p, value in ((pair(name), solution[name]) for name in ('s15', 's26', 's34'))
            )
        ]
        assert len(holding) == 1
        widths_m = np.sqrt(holding[0].upper) - np.sqrt(holding[0].lower)
        assert widths_m.max() <= RESOLUTION
        assert not holding[0].flexible


@pytest.mark.parametrize(
    ('n_sides', 'n_solutions', 'most_boxes'), [(0, 6, 23), (6, 2, 17), (7, 1, 11)]
)
def test_sides_leave_the_postures_that_agree_with_them(truth, n_sides, n_solutions, most_boxes):
    """Without sides there are six; those of the paper leave two, one more the convex one."""
    sides = [*truth['solutions'][0]['sigma'], CONVEX][:n_sides]
    solutions = truth['solutions']
    if n_sides:
        solutions = [s for s in solutions if set(s['sigma'].values()) == {-1}]
    if CONVEX in sides:
        solutions = [s for s in solutions if s['convex_octahedron']]
    assert len(solutions) == n_solutions
    check(solve_with(truth, sides), solutions, most_boxes)
