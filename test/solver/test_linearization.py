# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear combinations keep the truth, whatever placement their multipliers are chosen at."""

from itertools import combinations
import math

import numpy as np
import pytest
from solver_cases import box_of, squared_distances

from dg_localization.solver.contract.linear import contract_linear


def references(positions, rng):
    """Yield placements near and far from the truth, and some that are none."""
    size = np.abs(positions).max()
    for error in (0.0, 1e-12, 1e-3, 0.3, 10.0):
        yield positions + rng.normal(size=positions.shape) * error * size
    yield np.zeros_like(positions)
    for wrong in (math.nan, math.inf, 1e300, 1e-300):
        spoilt = positions.copy()
        spoilt[rng.integers(len(spoilt)), rng.integers(spoilt.shape[1])] = wrong
        yield spoilt
        yield np.full_like(positions, wrong)


@pytest.mark.parametrize('scale', [1.0, 1e-12, 1e12, 2.0**-380, 2.0**370])
@pytest.mark.parametrize('dimension', [1, 2, 3])
def test_the_truth_stays_whatever_the_reference(dimension, scale):
    rng = np.random.default_rng(dimension)
    scale = 2.0 ** round(math.log2(scale))
    for trial in range(25):
        n_points = int(rng.integers(dimension + 1, 8))
        positions = rng.integers(-30, 31, size=(n_points, dimension))
        if trial % 5 == 1:
            positions[:, -1] = rng.integers(-1, 2, n_points)  # nearly flat
        elif trial % 5 == 2:
            positions = positions[rng.integers(0, n_points, n_points)]  # coincident
        positions = positions * scale
        squared = squared_distances(positions)
        pairs = np.array(list(combinations(range(n_points), 2)), dtype=np.int64)
        edges = pairs[rng.random(len(pairs)) < rng.choice([0.7, 1.0])].reshape(-1, 2)
        width = rng.choice([0.0, 1e-12, 1e-6, 0.01, 0.5])
        for reference in references(positions, rng):
            lower, upper = squared * (1.0 - width), squared * (1.0 + width)
            before = box_of(lower, upper)
            box = before.copy()
            errors = (upper - lower)[edges[:, 0], edges[:, 1]]
            with np.errstate(all='ignore'):
                nothing = np.zeros((n_points, n_points))
                assert contract_linear(box, reference, edges, errors, errors.sum(), nothing)
            assert not np.isnan(box).any()
            assert (before[0] <= box[0]).all() and (box[1] <= before[1]).all()
            assert (box[0] <= squared).all() and (squared <= box[1]).all()
