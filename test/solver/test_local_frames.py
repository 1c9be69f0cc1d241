# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs in frames at two points: they lose nothing and bound well."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog
from solver_cases import bounds, squared_distances

from dg_localization import Problem
from dg_localization.solver.contract.linearization import Linearization
from dg_localization.solver.contract.simplex import set_multipliers, set_table
from dg_localization.solver.place.placements import MOST_STEPS, place
from dg_localization.solver.search.branch_and_prune import Pruner

N_POINTS = 8
RELATIVE_ERROR = 0.01
MEDIAN_GAIN = 0.05


def fleet(seed):
    """Return a placement, and its problem with all but six pairs measured to one percent."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.0, 10.0, (N_POINTS, 2))
    squared = squared_distances(positions)
    pairs = list(combinations(range(N_POINTS), 2))
    measured = [pairs[number] for number in rng.permutation(len(pairs))[6:]]
    ends = np.array([1.0 - RELATIVE_ERROR, 1.0 + RELATIVE_ERROR]) ** 2
    ranges = {pair: tuple(squared[pair] * ends) for pair in measured}
    return squared, Problem(*bounds(N_POINTS, ranges))


def test_pairs_are_narrowed_and_the_truth_is_kept():
    gains = []
    for seed in range(8):
        squared, problem = fleet(seed)
        pruner = Pruner(problem, 0.05)
        box = pruner.prune(pruner.whole()).box
        before = box[1] - box[0]
        pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
        positions = place(box, 2, MOST_STEPS)
        for pair in pairs:
            frame = np.vstack([pair, pairs[(pairs != pair).any(axis=1)]])
            explained = np.zeros(len(frame))
            assert pruner.narrow_in_frame(box, positions, frame, explained)
            assert (explained > 0.0).all()
        assert (box[0] <= squared).all() and (squared <= box[1]).all()
        after = box[1] - box[0]
        assert (after <= before).all()
        gains.extend(1.0 - after[i, j] / before[i, j] for i, j in pairs)
    assert np.median(gains) > MEDIAN_GAIN


def random_program(rng, kind='plain'):
    """Return measured pairs of seven points of which the first is held, and their gradients."""
    n_points, n_free = 7, 11
    reference = rng.uniform(0.0, 10.0, (n_points, 2))
    edges = np.array(list(combinations(range(n_points), 2)), dtype=np.int64)
    edges = edges[rng.permutation(len(edges))[:18]]
    residuals = np.stack([-rng.uniform(0.1, 1.0, 18), rng.uniform(0.1, 1.0, 18)], axis=1)
    if kind == 'exact':
        residuals[rng.random(18) < 0.7] = 0.0
    elif kind == 'repeated':
        edges = np.repeat(edges, 3, axis=0)
        residuals = np.repeat(residuals, 3, axis=0)
    elif kind == 'wide':
        residuals *= 10.0 ** rng.integers(-150, 150)
    # The first point is held, and the second in one coordinate.
    index = np.full((n_points, 2), -1)
    index[1, 0] = 0
    index[2:] = np.arange(1, n_free).reshape(-1, 2)
    displacements = np.zeros((n_points, 2, 2))
    slopes = 2.0 * (reference[edges[:, 0]] - reference[edges[:, 1]])
    remainder = np.zeros((2, n_points, 2))
    linear = Linearization(reference, edges, slopes, index, displacements, residuals, remainder)
    gradients = np.zeros((len(edges), n_points, 2))
    gradients[np.arange(len(edges)), edges[:, 0]] = slopes
    gradients[np.arange(len(edges)), edges[:, 1]] = -slopes
    return linear, gradients[:, index >= 0]


def multipliers_of(linear, function, tolerance):
    """Return the multipliers that bound a function."""
    table, active = np.eye(len(function) + 2, len(function)), np.full(len(function), -1)
    assert set_table(linear, table, active)
    table[-2] = function @ table[: len(function)]
    multipliers = np.empty(len(linear.edges))
    set_multipliers(linear, table, active, tolerance, multipliers)
    return multipliers


@pytest.mark.parametrize('tolerance', [1e-6, 0.03, 0.3])
@pytest.mark.parametrize('seed', range(20))
def test_the_multipliers_are_those_of_the_linear_program(seed, tolerance):
    rng = np.random.default_rng(seed)
    linear, gradients = random_program(rng)
    residuals, function = linear.residuals, rng.normal(size=11)
    multipliers = multipliers_of(linear, function, tolerance)
    assert multipliers @ gradients == pytest.approx(function, abs=1e-9)
    bound = np.where(multipliers > 0.0, residuals[:, 1], residuals[:, 0]) @ multipliers
    matrix = np.vstack([gradients, -gradients])
    right = np.concatenate([residuals[:, 1], -residuals[:, 0]])
    best = -linprog(-function, matrix, right, bounds=(None, None)).fun
    assert best - 1e-9 <= bound <= best + max(1e-3, tolerance) * abs(best)


@pytest.mark.parametrize('kind', ['exact', 'repeated', 'wide'])
@pytest.mark.parametrize('seed', range(20))
def test_exact_repeated_and_wide_pairs_have_multipliers_too(seed, kind):
    rng = np.random.default_rng(seed)
    linear, gradients = random_program(rng, kind)
    function = rng.normal(size=11)
    multipliers = multipliers_of(linear, function, 0.03)
    assert multipliers @ gradients == pytest.approx(function, abs=1e-8)
