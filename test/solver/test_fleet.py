# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The paper's fleet (5.1) and octahedral manipulator (5.2) against the paper and exact truths."""

import json

from joined_cases import solve_as_one
import numpy as np
import pytest
from solver_cases import covers, squared_distances

from benchmarks.problems import (
    CONVEX,
    OCTAHEDRAL_SIDES,
    OCTAHEDRAL_UNKNOWN_M2,
    fleet,
    fleet_placements,
    octahedral,
)
from dg_localization import SolverOptions, Verdict, solve


@pytest.fixture(scope='module')
def truth(shared):
    return json.loads((shared / 'truth/fleet.json').read_text())


@pytest.fixture(scope='module')
def exact_hulls(truth):
    return [by_pair(solution['hull']) for solution in truth['solutions']]


def by_pair(named):
    """Return values by pair of points, of values by name such as 's13'."""
    return {(int(name[1]) - 1, int(name[2]) - 1): value for name, value in named.items()}


def holds_hull(hypothesis, hull):
    return all(
        hypothesis.lower[pair] <= low and high <= hypothesis.upper[pair]
        for pair, (low, high) in hull.items()
    )


def test_the_eight_solutions_are_found_without_a_wasted_box(exact_hulls):
    result = solve(fleet())
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == 8
    done = result.statistics
    assert (done.processed, done.empty, done.kept) == (4, 0, 4), 'one box for each triangle'
    assert all(hypothesis.proved for hypothesis in result.hypotheses)
    assert not any(hypothesis.flexible for hypothesis in result.hypotheses)
    for hull in exact_hulls:
        assert sum(holds_hull(hypothesis, hull) for hypothesis in result.hypotheses) == 1


@pytest.mark.parametrize('solver', [solve, solve_as_one])
def test_three_sides_leave_the_solution_of_the_paper(truth, exact_hulls, solver):
    result = solver(fleet(sides=True))
    assert result.verdict is Verdict.COVERED
    assert result.statistics.processed == len(result.pieces), 'nothing is split'
    (hypothesis,) = result.hypotheses
    assert hypothesis.proved and not hypothesis.flexible
    (number,) = (k for k, solution in enumerate(truth['solutions']) if solution['in_D3'])
    assert holds_hull(hypothesis, exact_hulls[number])
    for pair, (low, high) in by_pair(truth['paper_D3']).items():
        assert hypothesis.lower[pair] >= low - 0.02, pair
        assert hypothesis.upper[pair] <= high + 0.02, pair


@pytest.mark.parametrize('relative_error', [0.01, 0.03, 0.05])
@pytest.mark.parametrize(('sides', 'n_hypotheses'), [(False, 8), (True, 1)])
def test_noise_adds_no_hypothesis(relative_error, sides, n_hypotheses):
    result = solve(fleet(relative_error, sides))
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == n_hypotheses
    assert result.statistics.processed <= 31
    assert all(hypothesis.proved for hypothesis in result.hypotheses)
    # The first one is that of the paper.
    for positions in fleet_placements()[:n_hypotheses]:
        assert covers(result, squared_distances(positions))


def test_without_sides_every_hypothesis_is_tightened_to_its_exact_hull(exact_hulls):
    result = solve(fleet(), SolverOptions(tighten_seconds=np.inf))
    assert len(result.hypotheses) == len(exact_hulls)
    for hull in exact_hulls:
        (found,) = (found for found in result.hypotheses if holds_hull(found, hull))
        for pair, (low, high) in hull.items():
            assert found.upper[pair] - found.lower[pair] < 1.02 * (high - low), pair


def test_no_box_is_tightened_when_its_time_is_over():
    wide, late, tight = (
        solve(fleet(0.03, sides=True), SolverOptions(tighten_seconds=seconds))
        for seconds in (0.0, 1e-9, np.inf)
    )
    assert late.verdict is wide.verdict
    assert (late.lower == wide.lower).all() and (late.upper == wide.upper).all()
    assert (tight.upper < wide.upper).any()


RESOLUTION = 1e-3


@pytest.mark.parametrize(
    ('sides', 'numbers', 'most_boxes'),
    [
        ((), (0, 1, 2, 3, 4, 5), 23),
        (OCTAHEDRAL_SIDES, (1, 3), 17),
        ((*OCTAHEDRAL_SIDES, CONVEX), (3,), 11),
    ],
)
def test_sides_leave_the_postures_that_agree_with_them(sides, numbers, most_boxes):
    """Without sides there are six; those of the paper leave two, one more the convex one."""
    result = solve(octahedral(sides), SolverOptions(resolution=RESOLUTION))
    assert result.verdict is Verdict.COVERED
    assert len(result.hypotheses) == len(numbers)
    assert result.statistics.processed <= most_boxes
    for number in numbers:
        known = zip(((0, 4), (1, 5), (2, 3)), OCTAHEDRAL_UNKNOWN_M2[number], strict=True)
        hull = {pair: (value * (1 + 1e-14), value * (1 - 1e-14)) for pair, value in known}
        # The truth is given to 16 digits: it may be a unit outside.
        (found,) = (found for found in result.hypotheses if holds_hull(found, hull))
        widths_m = np.sqrt(found.upper) - np.sqrt(found.lower)
        assert widths_m.max() <= RESOLUTION
        assert not found.flexible
