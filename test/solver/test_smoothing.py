# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Triangle smoothing against shortest paths and against exact placements."""

import math

from hypothesis import given, settings, strategies as st
import numpy as np
from solver_cases import bounds, box_of, squared_distances

from dg_localization.solver.contract.triangles import smooth_triangles

LAWS = settings(derandomize=True, deadline=None, max_examples=200)


def smooth(box):
    return smooth_triangles(box, np.zeros_like(box), np.arange(box.shape[1], dtype=np.int64))


def random_box(seed):
    """Return a box with unknown pairs around a fleet on integer coordinates, and its truth."""
    rng = np.random.default_rng(seed)
    n_points = int(rng.integers(2, 9))
    positions = rng.integers(-9, 10, size=(n_points, int(rng.integers(1, 4))))
    if rng.random() < 0.3:
        positions = positions[rng.integers(0, n_points, n_points)]
    squared = squared_distances(positions * 2.0 ** rng.choice([-40, 0, 40]))
    widths = np.triu(rng.random((2, n_points, n_points)) * rng.choice([0.0, 1e-9, 0.5]), 1)
    below, above = widths + widths.transpose(0, 2, 1)
    unknown = np.triu(rng.random((n_points, n_points)) < 0.4, 1)
    unknown |= unknown.T
    lower = np.where(unknown, 0.0, squared * (1.0 - below))
    upper = np.where(unknown, np.inf, squared * (1.0 + above))
    return box_of(lower, upper), squared


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


@LAWS
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


def test_a_broken_triangle_is_a_proof():
    box = box_of(*bounds(3, {(0, 1): (1.0, 1.1), (1, 2): (1.0, 1.1), (0, 2): (9.0, 9.1)}))
    assert not smooth(box)


def test_a_flat_triangle_is_none():
    """The tangent case, d_02 = d_01 + d_12 exactly, at sizes where its roots are rounded."""
    for unit in (1.0, math.pi, 1e12, 1e-12):
        side = unit * unit
        box = box_of(
            *bounds(3, {(0, 1): (side, side), (1, 2): (side, side), (0, 2): (4 * side, 4 * side)})
        )
        assert smooth(box)
