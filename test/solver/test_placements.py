# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Proofs of placements: exact signs, and agreement that is never claimed wrongly."""

from fractions import Fraction
import math

from hypothesis import given, settings, strategies as st
import numpy as np
from solver_cases import orientation, squared_distances

from dg_localization import Problem
from dg_localization.solver.place.proofs import agrees, chirality_signs

LAWS = settings(derandomize=True, deadline=None, max_examples=300)


def exact_squared(positions, i, j):
    points = [[Fraction(x) for x in positions[k].tolist()] for k in (i, j)]
    return sum((x - y) ** 2 for x, y in zip(*points, strict=True))


@LAWS
@given(st.integers(0, 2**32))
def test_signs_of_determinants_are_exact(seed):
    """Also where the points are in one hyperplane, or an ulp away from it."""
    rng = np.random.default_rng(seed)
    dimension = int(rng.integers(1, 4))
    points = rng.integers(-5, 6, size=(dimension + 1, dimension)) * rng.choice([1.0, 0.1, 1e8])
    if dimension > 1 and rng.random() < 0.7:
        points[-1] = points[0] + (points[1] - points[0]) * rng.integers(-3, 4)
    if rng.random() < 0.5:
        entry = tuple(rng.integers(0, points.shape))
        points[entry] = math.nextafter(points[entry], math.inf)
    exact = orientation([[Fraction(x) for x in point] for point in points.tolist()])
    assert chirality_signs(points, np.arange(dimension + 1)[None]).tolist() == [exact]


def test_a_product_that_underflows_is_not_taken_for_zero():
    """The large edge brings back what the product of two small ones has lost."""
    tiny = 2.0**-538
    points = np.array([[0, 0, 0], [2.0**900, 1, 0], [2.0**300, tiny, 0], [0, 0, tiny]])
    assert orientation([[Fraction(x) for x in point] for point in points.tolist()]) == 1
    assert chirality_signs(points, np.arange(4)[None]).tolist() == [1]


@LAWS
@given(st.integers(0, 2**32))
def test_agreement_is_a_proof(seed):
    """Bounds a few ulps around the exact distances: what is affirmed is so in rationals."""
    rng = np.random.default_rng(seed)
    n_points, dimension = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    positions = rng.standard_normal((n_points, dimension)) * 10.0 ** rng.integers(-12, 13)
    squared = squared_distances(positions)
    ulps = rng.integers(-2, 12, size=(2, n_points, n_points)) * 2.0**-52
    below, above = np.triu(ulps, 1) + np.triu(ulps, 1).transpose(0, 2, 1)
    lower, upper = squared * (1.0 - below), squared * (1.0 + above)
    if (lower > upper).any():
        return
    if agrees(Problem(lower, upper, dimension), positions):
        for i in range(n_points):
            for j in range(i):
                assert lower[i, j] <= exact_squared(positions, i, j) <= upper[i, j]
