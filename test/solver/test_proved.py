# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A proved placement meets the measurements, and lies in its own hypothesis."""

import numpy as np
import pytest

from dg_localization import Chirality, Problem, SolverOptions, solve

ROUNDING = 1e-9
N_PROBLEMS = 120


def drawn_problem(rng):
    """Draw points of a small fleet, which may have several placements, and its bounds."""
    n_points, dimension = rng.integers(4, 8), int(rng.choice([2, 3]))
    points_m = rng.uniform(-3.0, 3.0, (n_points, dimension))
    if rng.random() < 0.4:
        points_m[:, -1] *= 0.05
    squared_m2 = ((points_m[:, None] - points_m) ** 2).sum(axis=-1)
    error = rng.choice([0.0, 0.003, 0.01, 0.03, 0.08])
    measured = np.triu(rng.random((n_points, n_points)) < rng.choice([0.6, 0.7, 0.85, 1.0]), 1)
    measured |= measured.T
    lower = np.where(measured, squared_m2 * (1.0 - error) ** 2, 0.0)
    upper = np.where(measured, squared_m2 * (1.0 + error) ** 2, np.inf)
    np.fill_diagonal(upper, 0.0)
    return Problem(lower, upper, dimension=dimension), squared_m2


def drawn_within(rng, problem, squared_m2):
    """Draw a box that leaves less room to one pair."""
    lower, upper = problem.lower.copy(), problem.upper.copy()
    i, j = rng.choice(len(lower), 2, replace=False)
    low, high = lower[i, j], upper[i, j]
    if not np.isfinite(high):
        low, high = 0.3 * squared_m2[i, j], 2.0 * squared_m2[i, j]
    width = rng.uniform(0.02, 0.3) * (high - low)
    start = rng.uniform(low, high - width)
    lower[[i, j], [j, i]], upper[[i, j], [j, i]] = start, start + width
    return lower, upper


def assert_in_its_hypothesis(hypothesis, lower, upper):
    positions_m = hypothesis.positions
    squared_m2 = ((positions_m[:, None] - positions_m) ** 2).sum(axis=-1)
    slack_m2 = ROUNDING * squared_m2.max()
    for low, high in ((hypothesis.lower, hypothesis.upper), (lower, upper)):
        assert (low - slack_m2 <= squared_m2).all() and (squared_m2 <= high + slack_m2).all()


def n_proved_in_their_hypotheses(problem, lower, upper, max_boxes, within=None):
    """Solve a problem; return how many hypotheses are proved, all of them rightly."""
    options = SolverOptions(resolution=0.05, max_boxes=max_boxes, max_seconds=2.0)
    proved = [h for h in solve(problem, options, within=within).hypotheses if h.proved]
    for hypothesis in proved:
        assert_in_its_hypothesis(hypothesis, lower, upper)
    return len(proved)


@pytest.mark.parametrize('seed', range(4))
def test_what_is_proved_lies_in_its_hypothesis(seed):
    rng = np.random.default_rng(seed)
    n_proved = 0
    for _ in range(N_PROBLEMS):
        problem, _ = drawn_problem(rng)
        bounds = problem.lower, problem.upper
        n_proved += n_proved_in_their_hypotheses(problem, *bounds, int(rng.choice([10, 60, 400])))
    assert n_proved > 50


@pytest.mark.parametrize('seed', range(2))
def test_what_is_proved_lies_within_the_boxes_that_are_asked_for(seed):
    rng = np.random.default_rng(seed)
    n_proved = 0
    for _ in range(N_PROBLEMS):
        problem, squared_m2 = drawn_problem(rng)
        box = drawn_within(rng, problem, squared_m2)
        n_proved += n_proved_in_their_hypotheses(problem, *box, 60, [box])
    assert n_proved > 50


def test_a_box_that_connects_a_point_places_it():
    """Only the box that is asked for bounds the distance between a triangle and a lone point."""
    lower, upper = np.zeros((4, 4)), np.full((4, 4), np.inf)
    np.fill_diagonal(upper, 0.0)
    for i, j, squared_m2 in ((0, 1, 9.0), (0, 2, 16.0), (1, 2, 25.0)):
        lower[[i, j], [j, i]], upper[[i, j], [j, i]] = 0.98 * squared_m2, 1.02 * squared_m2
    problem = Problem(lower, upper, chiralities=[Chirality((0, 1, 2), 1)])
    near = upper.copy()
    near[[0, 3], [3, 0]] = 25.0
    (hypothesis,) = solve(problem, within=[(lower, near)]).hypotheses
    assert np.isfinite(hypothesis.upper).all()
    assert hypothesis.proved
    assert_in_its_hypothesis(hypothesis, lower, near)
