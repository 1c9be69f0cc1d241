# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Proofs of placements: of exact distances, exact signs, and never of what is not so."""

from fractions import Fraction
from itertools import combinations
import math

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import bounds, exact_squared, orientation, squared_distances, symmetric

from dg_localization import Problem, solve
from dg_localization.interval.arrays import Interval
from dg_localization.solver.place.existence import NEARNESS, _contraction, settled
from dg_localization.solver.place.proofs import agrees, chirality_signs

TRIANGLE = dict.fromkeys(combinations(range(3), 2), (1.0, 1.0))
SKETCH = np.array([[0.0, 0.0], [1.1, 0.0], [0.4, 0.8]])


@pytest.mark.parametrize('seed', range(20))
def test_exact_and_wide_distances_in_space(seed):
    """A chain of exact distances, its other pairs known to a few per cent."""
    rng = np.random.default_rng(seed)
    truth = rng.random((8, 3))
    squared = squared_distances(truth)
    ranges = {x: (0.9 * squared[x], 1.1 * squared[x]) for x in combinations(range(8), 2)}
    exact = [(i, j) for j in range(1, 8) for i in range(max(0, j - 2), j)]
    ranges |= {pair: (squared[pair], squared[pair]) for pair in exact}
    problem = Problem(*bounds(8, ranges), 3)
    positions, proved = settled(problem, truth + rng.uniform(-1e-4, 1e-4, truth.shape))
    assert proved
    found = squared_distances(positions)
    for pair in exact:
        assert abs(found[pair] - squared[pair]) < NEARNESS
    assert (found >= 0.9 * squared - NEARNESS).all() and (found <= 1.1 * squared + NEARNESS).all()
    assert any(hypothesis.proved for hypothesis in solve(problem).hypotheses)


def test_nothing_is_proved_where_a_wide_pair_is_missed():
    """The exact distances can be met there, the fourth point is too far from the third."""
    ranges = {**TRIANGLE, (0, 3): (1.0, 1.0), (1, 3): (1.0, 1.0)}
    positions = np.vstack([SKETCH, [0.5, -0.8]])
    for low, high, expected in ((2.9, 3.1, True), (3.1, 3.2, False), (2.8, 2.9, False)):
        problem = Problem(*bounds(4, {**ranges, (2, 3): (low, high)}), 2)
        assert settled(problem, positions)[1] == expected


def test_nothing_is_proved_where_exact_distances_contradict_each_other():
    """Four points one apart exist in space only; three in line only where the lengths add up."""
    four = dict.fromkeys(combinations(range(4), 2), (1.0, 1.0))
    positions = np.vstack([SKETCH, [0.5, 0.3]])
    assert not settled(Problem(*bounds(4, four), 2), positions)[1]
    broken = {(0, 1): (1.0, 1.0), (1, 2): (1.0, 1.0), (0, 2): (4.0001, 4.0001)}
    in_line = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 1e-3]])
    assert not settled(Problem(*bounds(3, broken), 2), in_line)[1]


def test_every_equation_of_a_proof_counts():
    """Many equations are looked at in parts; the last one has the largest norm here."""
    rng, n_points = np.random.default_rng(0), 300
    pairs = np.argwhere(np.tri(n_points, k=-1))[: 2 * n_points - 3]
    slopes, inverse = rng.normal(size=(len(pairs), 2)), rng.normal(size=(n_points, 2, len(pairs)))
    slopes[-1] *= 100.0
    relative = inverse[pairs[:, 0]] - inverse[pairs[:, 1]]
    off = np.einsum('ma,mak->mk', slopes, relative) - np.eye(len(pairs))
    norm = _contraction(Interval.point(slopes), Interval.point(inverse), pairs)
    assert np.abs(off[-1]).sum() * (1.0 - 1e-9) <= norm


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


@given(st.integers(0, 2**32))
def test_agreement_is_a_proof(seed):
    """Bounds a few ulps around the exact distances: what is affirmed is so in rationals."""
    rng = np.random.default_rng(seed)
    n_points, dimension = int(rng.integers(2, 6)), int(rng.integers(1, 4))
    positions = rng.standard_normal((n_points, dimension)) * 10.0 ** rng.integers(-12, 13)
    squared = squared_distances(positions)
    ulps = rng.integers(-2, 12, size=(2, n_points, n_points)) * 2.0**-52
    below, above = map(symmetric, ulps)
    lower, upper = squared * (1.0 - below), squared * (1.0 + above)
    if (lower > upper).any():
        return
    if agrees(Problem(lower, upper, dimension), positions):
        for i in range(n_points):
            for j in range(i):
                assert lower[i, j] <= exact_squared(positions, i, j) <= upper[i, j]
