# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Cartesian enclosures against exact coordinates."""

import itertools

from hypothesis import given, strategies as st
import numpy as np
import pytest
from solver_cases import squared_distances

from dg_localization.solver.contract.coordinates import enclose_coordinates

mpmath = pytest.importorskip('mpmath')


def in_frame(positions, frame):
    """Return the coordinates in the frame to many digits, None where it is degenerate."""
    points = [mpmath.matrix([mpmath.mpf(float(x)) for x in p]) for p in positions]
    axes = []
    for end in frame[1:]:
        edge = points[end] - points[frame[0]]
        for axis in axes:
            edge -= axis * (axis.T * edge)[0]
        length = mpmath.norm(edge)
        if length < 1e-30:
            return None
        axes.append(edge / length)
    return [[((p - points[frame[0]]).T * axis)[0] for axis in axes] for p in points]


@given(st.integers(0, 2**32))
def test_every_point_is_enclosed(seed):
    rng = np.random.default_rng(seed)
    dimension = int(rng.integers(1, 4))
    n_points = int(rng.integers(dimension + 1, 8))
    positions = rng.integers(-30, 31, size=(n_points, dimension))
    if rng.random() < 0.3:
        positions[:, -1] *= rng.integers(-1, 2, n_points) == 0
    positions = positions * 2.0 ** rng.choice([-40, 0, 40])
    squared = squared_distances(positions)
    width = float(rng.choice([0.0, 1e-12, 0.01, 0.2]))
    upper = squared * (1.0 + width)
    if rng.random() < 0.3:
        i, j = rng.permutation(n_points)[:2]
        upper[i, j] = upper[j, i] = np.inf
    frame = tuple(int(point) for point in rng.permutation(n_points)[: dimension + 1])
    enclosure = enclose_coordinates(squared * (1.0 - width), upper, frame)
    assert enclosure.shape == (n_points, 2, dimension)
    assert not np.isnan(enclosure).any()
    with mpmath.workdps(100):
        coordinates = in_frame(positions, frame)
        # Relative to the fleet, a hundred digits leave no doubt but where numbers are equal.
        slack = mpmath.mpf(10) ** -60 * float(np.sqrt(squared.max()))
        for point, axis in itertools.product(range(n_points), range(dimension)):
            if coordinates is not None:
                low, high = enclosure[point, :, axis].tolist()
                exact = coordinates[point][axis]
                assert low <= exact + slack and exact - slack <= high, (point, axis)
