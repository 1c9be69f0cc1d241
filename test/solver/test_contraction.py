# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The laws of contraction: inside the input, no placement lost, told the same twice."""

import numpy as np
import pytest
from solver_cases import bounds, box_of, random_case

from dg_localization.solver.box import Status
from dg_localization.solver.search.branch_and_prune import Pruner, choose_split


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
