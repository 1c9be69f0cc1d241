# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Tightening by linear programs: towards the exact hull, and never into it."""

from itertools import product

import numpy as np
import pytest

from dg_localization import SolverOptions, solve
from dg_localization.solver.box import LOWER, UPPER
from dg_localization.solver.place.placements import MOST_STEPS, place, refine_in_box

RELATIVE_ERROR = 0.03


def extreme_placements(problem, hypothesis):
    """Place the points at every combination of the ends of the measured ranges."""
    n_points = problem.n_points
    measured = np.argwhere(np.triu(np.isfinite(problem.upper), 1))
    box = np.zeros((4, n_points, n_points))
    for choice in product((problem.lower, problem.upper), repeat=len(measured)):
        box[LOWER], box[UPPER] = hypothesis.lower, hypothesis.upper
        for (i, j), bound in zip(measured, choice, strict=True):
            box[: UPPER + 1, [i, j], [j, i]] = bound[i, j]
        start = place(box, problem.dimension, MOST_STEPS)
        open_pairs = np.isinf(problem.upper)
        box[LOWER, open_pairs], box[UPPER, open_pairs] = 0.0, np.inf
        positions = refine_in_box(start, box, MOST_STEPS)
        yield ((positions[:, None] - positions[None]) ** 2).sum(axis=2)


@pytest.fixture(scope='module')
def problem(paper_fleet):
    return paper_fleet.noisy_problem(RELATIVE_ERROR, paper_fleet.SIDES)


def test_the_extremes_are_inside_and_not_far_inside(problem):
    (hypothesis,) = solve(problem, SolverOptions(tighten_seconds=np.inf)).hypotheses
    squared = np.array(list(extreme_placements(problem, hypothesis)))
    outside = np.abs(squared - np.clip(squared, problem.lower, problem.upper))
    reached = squared[outside.max(axis=(1, 2)) < 1e-6]
    assert len(reached) > 100
    assert (hypothesis.lower <= reached.min(axis=0) + 1e-5).all()
    assert (hypothesis.upper >= reached.max(axis=0) - 1e-5).all()
    unknown = np.isinf(problem.upper)
    ratio = (hypothesis.upper - hypothesis.lower)[unknown] / np.ptp(reached, axis=0)[unknown]
    assert ratio.max() < 1.5, ratio


def test_without_sides_every_hypothesis_holds_its_exact_hull(paper_fleet):
    result = solve(paper_fleet.problem(), SolverOptions(tighten_seconds=np.inf))
    assert len(result.hypotheses) == len(paper_fleet.exact_hulls)
    for hull in paper_fleet.exact_hulls:
        (found,) = (
            found
            for found in result.hypotheses
            if all(
                found.lower[pair] <= low and high <= found.upper[pair]
                for pair, (low, high) in hull.items()
            )
        )
        for pair, (low, high) in hull.items():
            assert found.upper[pair] - found.lower[pair] < 1.02 * (high - low), pair


def test_no_box_is_tightened_when_its_time_is_over(problem):
    wide, late, tight = (
        solve(problem, SolverOptions(tighten_seconds=seconds)) for seconds in (0.0, 1e-9, np.inf)
    )
    assert late.verdict is wide.verdict
    assert (late.lower == wide.lower).all() and (late.upper == wide.upper).all()
    assert (tight.upper < wide.upper).any()
