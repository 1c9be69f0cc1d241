# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Coordinate boxes contracted by distances keep every true point."""

from hypothesis import given, settings, strategies as st
import numpy as np

from dg_localization.solver.contract.coordinates import contract_coordinate_boxes


@settings(deadline=None)
@given(
    places=st.lists(st.tuples(st.integers(-9, 9), st.integers(-9, 9)), min_size=2, max_size=5),
    slack=st.floats(0.0, 3.0),
    margin=st.floats(0.0, 20.0),
)
def test_coordinate_boxes_keep_every_true_point(places, slack, margin):
    points = np.array(places, dtype=float)
    squared = ((points[:, None] - points[None]) ** 2).sum(axis=-1)
    lower, upper = np.maximum(squared - slack, 0.0), squared + slack
    low, high = points - margin, points + margin
    low[0], high[0] = points[0], points[0]
    assert contract_coordinate_boxes(low, high, lower, upper, 20)
    assert (low <= points).all()
    assert (points <= high).all()


def test_coordinate_boxes_without_a_point_are_empty():
    low, high = np.zeros((2, 2)), np.ones((2, 2))
    lower = np.array([[0.0, 100.0], [100.0, 0.0]])
    upper = np.array([[0.0, 200.0], [200.0, 0.0]])
    assert not contract_coordinate_boxes(low, high, lower, upper, 20)
