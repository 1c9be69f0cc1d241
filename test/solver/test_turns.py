# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Angles of triangles by the bounds of their sides."""

import math

import numpy as np
import pytest

from dg_localization.solver.contract.triangle_angles import bound_angle
from dg_localization.solver.contract.turns import (
    FARTHEST,
    _signed_angle,
    complete,
    shorten_chains,
)


def angle_at(x, i, j, k):
    a, b = x[j] - x[i], x[k] - x[i]
    return math.atan2(abs(a[0] * b[1] - a[1] * b[0]), a @ b)


@pytest.mark.parametrize('error', [0.0, 1e-3, 0.1, 0.7])
def test_angles_of_triangles_are_bounded_by_their_sides(error):
    rng = np.random.default_rng(7)
    for _ in range(200):
        x = rng.uniform(-1.0, 1.0, (3, 2)) * [1.0, rng.choice([1.0, 1e-3, 0.0])]
        squared = ((x[:, None] - x) ** 2).sum(axis=2)
        box = np.zeros((4, 3, 3))
        below, above = error * np.triu(rng.random((2, 3, 3)), 1)
        box[0] = squared * (1.0 - below - below.T) * (1.0 - 1e-15)
        box[1] = squared * (1.0 + above + above.T) * (1.0 + 1e-15)
        low, high = bound_angle(box, 0, 1, 2)
        assert low - 1e-14 <= angle_at(x, 0, 1, 2) <= high + 1e-14
        steps = np.linspace(0.0, 1.0, 41)
        sides = ((0, 1), (0, 2), (1, 2))
        a, b, c = (np.sqrt(box[0][p] + steps * (box[1] - box[0])[p]) for p in sides)
        with np.errstate(divide='ignore', invalid='ignore'):
            a, b = a[:, None, None], b[None, :, None]
            cosines = np.clip((a * a + b * b - c * c) / (2.0 * a * b), -1.0, 1.0)
        angles = np.arccos(cosines)
        assert low <= angles.min() + 1e-7 and angles.max() <= high + 1e-7


def test_a_side_that_may_vanish_bounds_no_angle():
    box = np.zeros((4, 3, 3))
    box[0] = [[0.0, 0.0, 0.9], [0.0, 0.0, 0.9], [0.9, 0.9, 0.0]]
    box[1] = [[0.0, 0.2, 1.1], [0.2, 0.0, 1.1], [1.1, 1.1, 0.0]]
    assert bound_angle(box, 0, 1, 2)[0] == 0.0
    assert bound_angle(box, 0, 1, 2)[1] >= math.pi


def test_the_angle_between_sides_whose_product_underflows_is_bounded():
    unit = 2.0**-1074
    box = np.zeros((4, 3, 3))
    box[:2] = unit * np.array([[0.0, 1.0, 2.0], [1.0, 0.0, 1.0], [2.0, 1.0, 0.0]])
    low, high = bound_angle(box, 0, 1, 2)
    assert low <= 0.25 * math.pi <= high


def test_an_angle_of_unknown_sign_has_both():
    assert _signed_angle(0.1, 0.5, 1, True) == (0.1, 0.5)
    assert _signed_angle(0.1, 0.5, -1, True) == (-0.5, -0.1)
    assert _signed_angle(0.1, 0.5, 0, True) == (-0.5, 0.5)
    low, high = _signed_angle(3.0, 3.1, 0, True)
    assert low == 3.0 and 2.0 * math.pi - 3.0 <= high < 3.3
    low, high = _signed_angle(3.0, 3.1, 0, False)
    assert high == -3.0 and -3.3 < low <= 3.0 - 2.0 * math.pi


@pytest.mark.parametrize('seed', range(10))
def test_chains_are_as_short_as_they_can_be_and_hold_the_truth(seed):
    rng = np.random.default_rng(seed)
    n_pairs = int(rng.integers(3, 14))
    turns = rng.uniform(-0.4, 0.4, n_pairs)
    above = turns[:, None] - turns + rng.uniform(0.0, rng.choice([0.1, 1.0, 4.0]), (n_pairs,) * 2)
    unknown = rng.random((n_pairs, n_pairs)) < 0.4
    above[(above > FARTHEST) | (above.T > FARTHEST) | unknown | unknown.T] = math.pi
    np.fill_diagonal(above, 0.0)
    shortest = above.copy()
    for hub in range(n_pairs):
        chains = shortest[:, [hub]] + shortest[[hub]]
        known = (chains < FARTHEST) & (chains.T < FARTHEST)
        known &= np.outer(shortest[:, hub] < FARTHEST, shortest[hub] < FARTHEST)
        shortest = np.where(known, np.minimum(shortest, chains), shortest)
    below = np.ascontiguousarray(above.T)
    for hub in range(n_pairs):
        shorten_chains(above, below, np.array([hub]))
    complete(above, below, n_pairs)
    assert above == pytest.approx(shortest, abs=1e-12)
    assert np.array_equal(below, above.T)
    assert (above >= shortest).all()
    assert (above >= turns[:, None] - turns).all()
