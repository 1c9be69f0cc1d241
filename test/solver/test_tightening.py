# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Tightening: towards the exact hull, and never into it."""

from itertools import product

import numpy as np
import pytest
from solver_cases import bounds

from dg_localization import SolverOptions, solve
from dg_localization.solver.box import LOWER, UPPER
from dg_localization.solver.contract.groups import groups_of, with_measured_pair
from dg_localization.solver.place.placements import MOST_STEPS, place, refine_in_box
from dg_localization.solver.search.pruning import Pruner

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
def tightened(paper_fleet):
    problem = paper_fleet.noisy_problem(RELATIVE_ERROR, paper_fleet.SIDES)
    (hypothesis,) = solve(problem, SolverOptions(tighten_slices=2000)).hypotheses
    return problem, hypothesis


def test_the_extremes_are_inside_and_not_far_inside(tightened):
    problem, hypothesis = tightened
    squared = np.array(list(extreme_placements(problem, hypothesis)))
    outside = np.abs(squared - np.clip(squared, problem.lower, problem.upper))
    reached = squared[outside.max(axis=(1, 2)) < 1e-6]
    assert len(reached) > 100
    assert (hypothesis.lower <= reached.min(axis=0) + 1e-5).all()
    assert (hypothesis.upper >= reached.max(axis=0) - 1e-5).all()
    unknown = np.isinf(problem.upper)
    ratio = (hypothesis.upper - hypothesis.lower)[unknown] / np.ptp(reached, axis=0)[unknown]
    assert ratio.max() < 1.05, ratio


def test_it_is_worth_its_slices(tightened):
    problem, hypothesis = tightened
    unknown = np.isinf(problem.upper)
    widths = []
    for slices in (0, 20, 200):
        (found,) = solve(problem, SolverOptions(tighten_slices=slices)).hypotheses
        widths.append((found.upper - found.lower)[unknown].sum())
    widths.append((hypothesis.upper - hypothesis.lower)[unknown].sum())
    assert sorted(widths, reverse=True) == widths
    assert widths[-1] < 0.95 * widths[0]


def test_no_more_slices_than_allowed_are_examined(paper_fleet, monkeypatch):
    examined = []
    prune_slice = Pruner.prune_slice
    monkeypatch.setattr(
        Pruner, 'prune_slice', lambda *args: examined.append(1) or prune_slice(*args)
    )
    problem = paper_fleet.noisy_problem(RELATIVE_ERROR, paper_fleet.SIDES)
    for slices in (1, 3, 7, 150):
        examined.clear()
        solve(problem, SolverOptions(tighten_slices=slices))
        # Up to three there are linear programs only.
        assert (len(examined) > 0) == (slices > 3)
        assert len(examined) <= slices


def test_without_sides_every_hypothesis_comes_close_to_its_exact_hull(paper_fleet):
    result = solve(paper_fleet.problem(), SolverOptions(tighten_slices=200))
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


def test_no_box_is_tightened_when_its_time_is_over(paper_fleet):
    problem = paper_fleet.noisy_problem(RELATIVE_ERROR, paper_fleet.SIDES)
    wide, late, tight = (
        solve(problem, options)
        for options in (
            SolverOptions(),
            SolverOptions(tighten_slices=20, tighten_seconds=1e-9),
            SolverOptions(tighten_slices=20),
        )
    )
    assert late.verdict is wide.verdict
    assert (late.lower == wide.lower).all() and (late.upper == wide.upper).all()
    assert (tight.upper < wide.upper).any()


def test_a_pair_of_two_groups_is_in_none():
    groups = groups_of(*bounds(4, {(0, 3): (1.0, 1.0), (1, 2): (1.0, 1.0)}))
    for pair in ((1, 3), (3, 1), (0, 2)):
        assert with_measured_pair(groups, pair) is groups
