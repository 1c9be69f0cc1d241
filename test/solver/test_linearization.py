# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear combinations against exact rationals, the truth, and the linear program they bound."""

from fractions import Fraction
from itertools import combinations
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import box_of, squared_distances

from dg_localization.solver.contract.linear import contract_linear
from dg_localization.solver.contract.linearization import Linearization, bound_linear_function


def outward(x):
    """Return the doubles around a rational, its own where it is one."""
    near = float(x)
    if Fraction(near) == x:
        return near, near
    return math.nextafter(near, -math.inf), math.nextafter(near, math.inf)


@given(st.integers(0, 2**32))
def test_any_multipliers_bound_a_linear_function(seed):
    rng = np.random.default_rng(seed)
    n_points, dimension = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    unit = 2.0 ** rng.choice([-400, -30, 0, 370])
    reference = rng.integers(-(2**24), 2**24 + 1, (n_points, dimension)) * unit
    displacements = rng.integers(-(2**20), 2**20 + 1, (n_points, dimension)) * unit / 2**30
    edges = np.array(list(combinations(range(n_points), 2)), dtype=np.int64)
    exact = [[Fraction(x) for x in row] for row in displacements.tolist()]
    residuals = []
    for i, j in edges.tolist():
        arms = (reference[i] - reference[j]).tolist()
        along = [2 * Fraction(arm) for arm in arms]
        relative = [x - y for x, y in zip(exact[i], exact[j], strict=True)]
        residuals.append(outward(sum(a * b for a, b in zip(along, relative, strict=True))))
    multipliers = rng.normal(size=len(edges)) * rng.choice([0.0, 1e-300, 1.0, 1e300], len(edges))
    if rng.random() < 0.3:
        multipliers[rng.integers(len(edges))] = rng.choice([math.inf, -math.inf, math.nan])
    target = rng.normal(size=(n_points, dimension))
    slack = np.abs(displacements) * rng.choice([0.0, 1.0]) + 0.0
    linear = Linearization(
        reference,
        edges,
        2.0 * (reference[edges[:, 0]] - reference[edges[:, 1]]),
        np.arange(n_points * dimension).reshape(n_points, dimension),
        np.stack([displacements - slack, displacements + slack], axis=1),
        np.array(residuals),
        np.empty((2, n_points, dimension)),
    )
    low, high = bound_linear_function(linear, multipliers, target)
    value = sum(
        Fraction(t) * e
        for row, of_point in zip(target.tolist(), exact, strict=True)
        for t, e in zip(row, of_point, strict=True)
    )
    assert low <= value <= high


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
                gain = contract_linear(
                    box, reference, edges, errors, np.zeros((n_points, n_points))
                )
            assert gain >= 0.0
            assert not np.isnan(box).any()
            assert (before[0] <= box[0]).all() and (box[1] <= before[1]).all()
            assert (box[0] <= squared).all() and (squared <= box[1]).all()
