# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The octahedral manipulator (Section 5.2): six postures of a rigid fleet in space."""

import json

import numpy as np
import pytest
from solver_cases import bounds

from dg_localization import Problem, Side, SideConstraint, SolverOptions, Verdict, solve

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


def test_all_six_postures(truth):
    check(solve_with(truth, []), truth['solutions'], most_boxes=23)


def test_the_six_sides_leave_two_postures(truth):
    sides = truth['solutions'][0]['sigma']
    solutions = [s for s in truth['solutions'] if set(s['sigma'].values()) == {-1}]
    assert len(solutions) == 2
    check(solve_with(truth, sides), solutions, most_boxes=17)


def test_a_seventh_side_leaves_the_convex_one(truth):
    sides = [*truth['solutions'][0]['sigma'], CONVEX]
    solutions = [s for s in truth['solutions'] if s['convex_octahedron']]
    assert len(solutions) == 1
    check(solve_with(truth, sides), solutions, most_boxes=11)
