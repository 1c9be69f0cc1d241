# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The true heading lies within the half width, wherever in their boxes robot and targets are."""

import math

import numpy as np
import pytest
from shapes import angle_of, rotation_about

from dg_localization.fleet.frames.headings import estimate_heading
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.fleet.vocabulary import LinkKey, LinkKind, RayReading
from dg_localization.interval.arrays import Interval


def some_rotation(rng, q, angle_rad):
    axis = rng.normal(size=3) if q == 3 else np.array([0.0, 0.0, rng.choice([-1.0, 1.0])])
    return rotation_about(axis / np.linalg.norm(axis) * angle_rad)


@pytest.mark.parametrize('q', [2, 3])
@pytest.mark.parametrize('size_m', [0.0, 0.3, 2.0])
def test_the_true_heading_is_within_the_half_width(q, size_m):
    rng = np.random.default_rng(int(10 * size_m) + q)
    known = 0
    for _ in range(400):
        n_points = int(rng.integers(2, 6))
        names = [f'p{i}' for i in range(n_points)]
        truth = rng.uniform(-5.0, 5.0, (n_points, q))
        below, above = size_m * rng.random((2, n_points, q))
        enclosure = Interval(truth - below, truth + above)
        positions = truth - below + (below + above) * rng.random((n_points, q))
        heading = some_rotation(rng, q, rng.uniform(0.0, math.pi))
        half_width_rad = float(rng.choice([1e-3, 0.05, 0.3]))
        rays = []
        for target in range(1, n_points):
            gap = np.zeros(3)
            gap[:q] = truth[target] - truth[0]
            gap /= np.linalg.norm(gap)
            error = some_rotation(rng, q, 0.999 * half_width_rad * rng.choice([1.0, rng.random()]))
            key = LinkKey(LinkKind.BEARING, 'p0', names[target])
            rays.append(RayReading(key, 0.0, heading.T @ error @ gap, half_width_rad))
        rows = {name: row for row, name in enumerate(names)}
        found = estimate_heading(rows, rays, positions, enclosure)
        if found is not None:
            known += 1
            wrong = rotation_of_quaternion(found.orientation_xyzw).T @ heading
            assert angle_of(wrong) <= found.half_width_rad + 1e-9
    assert known > 100
