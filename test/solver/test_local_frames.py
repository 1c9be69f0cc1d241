# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs in frames at two points: they lose nothing and bound well."""

from itertools import combinations

import numpy as np
from solver_cases import bounds, squared_distances

from dg_localization import Problem
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
