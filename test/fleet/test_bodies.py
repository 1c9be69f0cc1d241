# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What the coordinates of anchors say: distances, a chirality, and the axes of the fixed frame."""

from fractions import Fraction
from itertools import combinations

import numpy as np
import pytest

from dg_localization.fleet import Anchor, FleetConfig
from dg_localization.fleet.bodies import MAX_CORES, anchor_geometry


def geometry(centers, bounds_m=0.0):
    """Return what anchors at places (n, q), known within bounds, say; the robot is row 0."""
    bounds_m = np.broadcast_to(bounds_m, len(centers))
    anchors = {
        f'p{k}': Anchor(tuple(center), float(bound_m))
        for k, (center, bound_m) in enumerate(zip(centers, bounds_m, strict=True))
    }
    return anchor_geometry(FleetConfig(robots=('a',), dimension=len(centers[0]), anchors=anchors))


@pytest.mark.parametrize('dimension', [2, 3])
@pytest.mark.parametrize('bound_m', [0.0, 0.01])
def test_the_one_anchor_off_the_line_is_found_among_many(dimension, bound_m):
    centers = np.zeros((80, dimension))
    centers[:, 0] = np.arange(80.0)
    for axis in range(1, dimension):
        centers[40 + axis, axis] = 0.3
    found = geometry(centers, bound_m)
    (chirality,) = found.chiralities
    assert set(range(42, 41 + dimension)) <= set(chirality.points)
    assert len(found.cores) == MAX_CORES
    # An anchor that may be anywhere near decides nothing.
    bounds_m = np.where(centers[:, 1:].any(axis=1), 5.0, bound_m)
    assert not geometry(centers, bounds_m).chiralities


@pytest.mark.parametrize('bound_m', [0.0, 0.01])
def test_distances_of_anchors_hold_the_exact_ones(bound_m):
    centers = np.random.default_rng(1).uniform(-50.0, 50.0, (30, 3))
    found = geometry(centers, bound_m)
    assert [pair[:2] for pair in found.distances] == list(combinations(range(1, 31), 2))
    for i, j, s_lower_m2, s_upper_m2 in found.distances:
        pairs = zip(centers[i - 1].tolist(), centers[j - 1].tolist(), strict=True)
        exact = sum((Fraction(one) - Fraction(other)) ** 2 for one, other in pairs)
        assert s_lower_m2 <= exact <= s_upper_m2
        assert s_upper_m2 - s_lower_m2 <= 1e-9 + 8.1 * bound_m * float(exact) ** 0.5
