# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""In space the sign of three rays counts only where no errors of theirs can change it."""

import numpy as np
import pytest

from dg_localization.fleet.constraints.rays import spatial_sign
from dg_localization.fleet.vocabulary import LinkKey, LinkKind, RayReading

KEY = LinkKey(LinkKind.BEARING, 'a', 'b')


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def turned_towards(ray, goal, angle_rad):
    """Return a unit vector turned towards another by an angle."""
    across = goal - (goal @ ray) * ray
    length = np.linalg.norm(across)
    if length < 1e-12:
        return ray
    return np.cos(angle_rad) * ray + np.sin(angle_rad) * across / length


def worst_volume(rays, errors_rad, sign):
    """Return the determinant after each ray in turn has moved where it changes the sign most."""
    worst = rays.copy()
    for _ in range(6):
        for i in range(3):
            normal = np.cross(worst[(i + 1) % 3], worst[(i + 2) % 3])
            worst[i] = turned_towards(rays[i], -sign * normal, errors_rad[i])
    return float(np.linalg.det(worst))


@pytest.mark.parametrize('share', [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 0], [1, 1, 1]])
def test_a_certain_sign_survives_the_worst_errors(share):
    rng = np.random.default_rng(5)
    certain = 0
    for _ in range(500):
        rays = unit(rng.normal(size=(3, 3)))
        errors_rad = np.array(share) * rng.uniform(0.0, 0.8, 3)
        readings = [
            RayReading(KEY, 0.0, ray, float(error))
            for ray, error in zip(rays, errors_rad, strict=True)
        ]
        sign = spatial_sign(readings)
        if sign:
            certain += 1
            assert sign * np.linalg.det(rays) > 0.0
            assert sign * worst_volume(rays, errors_rad, sign) > -1e-12
    assert certain > 20
