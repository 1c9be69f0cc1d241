# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs in frames at two points: they lose nothing and bound well."""

from itertools import combinations

import numpy as np
import pytest
from scipy.optimize import linprog
from solver_cases import bounds, squared_distances

from dg_localization import Problem, SolverOptions
from dg_localization.solver.contract.linearization import Linearization
from dg_localization.solver.contract.simplex import set_multipliers, set_table
from dg_localization.solver.place.placements import place
from dg_localization.solver.search.pruning import Pruner

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
        pruner = Pruner(problem, SolverOptions())
        box = pruner.prune(pruner.whole()).box
        before = box[1] - box[0]
        pairs = np.argwhere(np.triu(np.isinf(problem.upper)))
        positions = place(box, 2)
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


@pytest.mark.parametrize('seed', range(20))
def test_the_multipliers_are_those_of_the_linear_program(seed):
    rng = np.random.default_rng(seed)
    n_points, n_free = 7, 11
    reference = rng.uniform(0.0, 10.0, (n_points, 2))
    edges = np.array(list(combinations(range(n_points), 2)), dtype=np.int64)
    edges = edges[rng.permutation(len(edges))[:18]]
    # The first point is held, and the second in one coordinate.
    index = np.full((n_points, 2), -1)
    index[1, 0] = 0
    index[2:] = np.arange(1, n_free).reshape(-1, 2)
    residuals = np.stack([-rng.uniform(0.1, 1.0, 18), rng.uniform(0.1, 1.0, 18)], axis=1)
    table, active = np.eye(n_free + 2, n_free), np.full(n_free, -1)
    displacements = np.zeros((n_points, 2, 2))
    slopes = 2.0 * (reference[edges[:, 0]] - reference[edges[:, 1]])
    remainder = np.zeros((2, n_points, 2))
    linear = Linearization(reference, edges, slopes, index, displacements, residuals, remainder)
    assert set_table(linear, table, active)
    function = rng.normal(size=n_free)
    table[-2] = function @ table[:n_free]
    multipliers = np.empty(18)
    set_multipliers(linear, table, active, multipliers)
    gradients = np.zeros((18, n_points, 2))
    for m, (i, j) in enumerate(edges):
        gradients[m, i] = 2.0 * (reference[i] - reference[j])
        gradients[m, j] = -gradients[m, i]
    gradients = gradients[:, index >= 0]
    assert multipliers @ gradients == pytest.approx(function, abs=1e-9)
    bound = np.where(multipliers > 0.0, residuals[:, 1], residuals[:, 0]) @ multipliers
    matrix = np.vstack([gradients, -gradients])
    right = np.concatenate([residuals[:, 1], -residuals[:, 0]])
    best = -linprog(-function, matrix, right, bounds=(None, None)).fun
    assert best - 1e-9 <= bound <= best + 1e-3 * abs(best)
