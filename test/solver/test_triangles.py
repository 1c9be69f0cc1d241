# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Triangle inequalities against shortest paths, the law of cosines against sampled triangles."""

import math

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest
from solver_cases import bounds_around, box_of, squared_distances, symmetric

from dg_localization.solver.contract.triangles import (
    contract_adjacent_side,
    contract_opposite_side,
    smooth,
)


def random_box(seed):
    """Return a box with unknown pairs around a fleet on integer coordinates, and its truth."""
    rng = np.random.default_rng(seed)
    n_points = int(rng.integers(2, 9))
    positions = rng.integers(-9, 10, size=(n_points, int(rng.integers(1, 4))))
    if rng.random() < 0.3:
        positions = positions[rng.integers(0, n_points, n_points)]
    squared = squared_distances(positions * 2.0 ** rng.choice([-40, 0, 40]))
    box = box_of(*bounds_around(rng, squared, [0.0, 1e-9, 0.5], alike=0.9))
    unknown = symmetric(rng.random((n_points, n_points)) < 0.4)
    box[:2, unknown] = [[0.0], [np.inf]]
    return box, squared


def fixed_point(box):
    """Return the tightest distances in m that obey all triangle inequalities, by repetition."""
    low, high = np.sqrt(box[0]), np.sqrt(box[1])
    for _ in range(len(low)):
        high = np.minimum(high, (high[:, :, None] + high[None]).min(axis=1))
    for _ in range(len(low)):
        # d_ik >= d_ij - d_jk
        low = np.maximum(low, (low[:, :, None] - high[None]).max(axis=1))
        low = np.maximum(low, low.T)
    return low, high


@given(st.integers(0, 2**32))
def test_the_result_is_the_tightest_that_triangles_give_and_no_tighter(seed):
    box, squared = random_box(seed)
    low, high = fixed_point(box)
    before = box.copy()
    assert smooth(box)
    assert (box[0] <= squared).all() and (squared <= box[1]).all()
    assert (box[0] >= before[0]).all() and (box[1] <= before[1]).all()
    size = np.sqrt(squared.max())
    np.testing.assert_allclose(np.sqrt(box[0]), low, rtol=1e-12, atol=1e-12 * size)
    np.testing.assert_allclose(np.sqrt(box[1]), high, rtol=1e-12, atol=1e-100)


side = st.floats(0.0, 10.0)
share = st.floats(0.0, 1.0)


def between(ends, part):
    low, high = ends
    return min(max(low + part * (high - low), low), high)


@settings(derandomize=False)
@given(
    first=st.tuples(side, side).map(sorted),
    second=st.tuples(side, side).map(sorted),
    angle=st.tuples(st.floats(0.0, math.pi), st.floats(0.0, math.pi)).map(sorted),
    parts=st.tuples(share, share, share),
)
def test_the_law_of_cosines_excludes_no_triangle(first, second, angle, parts):
    lower, upper = np.zeros((3, 3)), np.full((3, 3), np.inf)
    np.fill_diagonal(upper, 0.0)
    for point, (low, high) in ((1, first), (2, second)):
        lower[0, point] = lower[point, 0] = low * low
        upper[0, point] = upper[point, 0] = high * high
    low, high = angle
    contract_opposite_side(lower, upper, 0, 1, 2, math.cos(high) - 1e-15, math.cos(low) + 1e-15)
    x, y = between(first, parts[0]), between(second, parts[1])
    opposite = x * x + y * y - 2.0 * x * y * math.cos(between(angle, parts[2]))
    rounding = 1e-14 * (x + y) ** 2 + 1e-300
    assert lower[1, 2] - rounding <= opposite <= upper[1, 2] + rounding


@settings(derandomize=False)
@given(
    places=st.lists(st.tuples(side, side), min_size=3, max_size=3),
    slack=st.tuples(side, side, side, st.floats(0.0, 1.0), st.floats(0.0, 1.0)),
)
def test_an_adjacent_side_excludes_no_triangle(places, slack):
    points = np.array(places)
    true = ((points[:, None] - points[None]) ** 2).sum(axis=-1)
    a, b, c, less, more = slack
    widths = np.array([[0.0, a, b], [a, 0.0, c], [b, c, 0.0]])
    lower, upper = np.maximum(true - widths, 0.0), true + widths
    edges = points[1:] - points[0]
    lengths = np.linalg.norm(edges, axis=1)
    if lengths.min() < 1e-3:
        return
    cosine = float(np.clip(edges[0] @ edges[1] / lengths.prod(), -1.0, 1.0))
    low, high = max(-1.0, cosine - less - 1e-12), min(1.0, cosine + more + 1e-12)
    contract_adjacent_side(lower, upper, 0, 1, 2, low, high)
    assert lower[0, 1] - 1e-9 <= true[0, 1] <= upper[0, 1] + 1e-9


def test_an_adjacent_side_is_sharp_and_may_be_none():
    lower = np.array([[0.0, 0.0, 9.0], [0.0, 0.0, 25.0], [9.0, 25.0, 0.0]])
    upper = np.array([[0.0, 99.0, 9.0], [99.0, 0.0, 25.0], [9.0, 25.0, 0.0]])
    contract_adjacent_side(lower, upper, 0, 1, 2, -1e-16, 1e-16)
    assert upper[0, 1] == pytest.approx(16.0)
    lower[0, 2] = upper[0, 2] = lower[2, 0] = upper[2, 0] = 36.0
    contract_adjacent_side(lower, upper, 0, 1, 2, -1e-16, 1e-16)
    assert upper[0, 1] < lower[0, 1]


def test_lengths_whose_squares_overflow_bound_nothing():
    lower, upper = np.full((3, 3), 1.7e308), np.full((3, 3), 1.7e308)
    lower[1, 2] = lower[2, 1] = 0.0
    before = lower.copy(), upper.copy()
    contract_opposite_side(lower, upper, 0, 1, 2, 0.99, 1.0)
    assert np.array_equal(lower, before[0]) and np.array_equal(upper, before[1])
