# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The laws of contraction: inside the input, no placement lost, told the same twice."""

import numpy as np
import pytest
from solver_cases import bounds, box_of, random_case, squared_distances

from benchmarks.pieces import neighbors, uwb_fleet
from dg_localization.solver.box import Status
from dg_localization.solver.search.branch_and_prune import Pruner, choose_split


def contracted(case):
    """Return (the box of a problem after one contraction, whether anything is left)."""
    pruner = Pruner(case.problem, case.options.resolution)
    pruned = pruner.prune(pruner.whole())
    return pruned.box, pruned.status is not Status.EMPTY


@pytest.mark.parametrize('first_seed', range(0, 500, 100))
def test_the_result_lies_inside_the_input_and_holds_the_truth(first_seed):
    for seed in range(first_seed, first_seed + 100):
        case = random_case(seed)
        box, left = contracted(case)
        assert left, seed
        squared = case.squared
        assert (case.problem.lower <= box[0]).all() and (box[1] <= case.problem.upper).all(), seed
        assert (box[0] <= squared).all() and (squared <= box[1]).all(), seed
        assert not ((box[2] < squared) & (squared < box[3])).any(), f'seed {seed}: in a gap'
        assert np.array_equal(box, box.transpose(0, 2, 1)), seed
        assert not np.isnan(box).any(), seed


def test_contraction_is_deterministic_and_leaves_no_trace():
    """A pruner used for something else in between says the same."""
    for seed in range(50):
        case = random_case(seed)
        pruner = Pruner(case.problem, case.options.resolution)
        first = pruner.prune(pruner.whole())
        assert first.status is Status.CONTRACTED
        between = pruner.whole()
        between[1] = np.minimum(between[1], 0.9 * np.where(np.isinf(between[1]), 1.0, between[1]))
        pruner.prune(between)
        second = pruner.prune(pruner.whole())
        assert second.status is Status.CONTRACTED
        assert np.array_equal(first.box, second.box), seed
        assert np.array_equal(first.explained, second.explained), seed


def test_the_largest_ranges_are_split_inside():
    """The sum of the ends of such a range overflows; its middle does not."""
    lower, upper = bounds(2, {(0, 1): (1e308, 1.7e308)})
    i, j, low_end, high_start = choose_split(box_of(lower, upper), np.zeros((2, 2)), 1.0)
    assert (i, j) == (0, 1)
    assert low_end == high_start == pytest.approx(1.35e308)


@pytest.mark.parametrize('n_points', [17, 20, 21, 30])
def test_no_placement_of_a_fleet_of_wide_distances_is_lost(n_points):
    for seed in range(20):
        pruner = Pruner(uwb_fleet(n_points, 5 + seed % 4, seed), 0.05)
        pruned = pruner.prune(pruner.whole())
        squared = squared_distances(neighbors(n_points, 5 + seed % 4, 2, seed)[0])
        assert pruned.status is not Status.EMPTY, seed
        assert ((pruned.box[0] <= squared) & (squared <= pruned.box[1])).all(), seed
        assert not ((pruned.box[2] < squared) & (squared < pruned.box[3])).any(), seed
