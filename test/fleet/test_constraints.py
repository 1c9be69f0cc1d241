# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What rays say about distances and chirality, and where pendant robots are."""

import math

import numpy as np
import pytest
from sensing import new_localizer

from dg_localization.fleet import Anchor, OdometryErrorModel
from dg_localization.fleet.constraints.constrain import constrain
from dg_localization.fleet.constraints.distances import triangulate
from dg_localization.fleet.constraints.rays import Angles, include_displacement, spatial_sign
from dg_localization.fleet.vocabulary import LinkKey, LinkKind, RayReading

NOW_S = 5.0


def make(robots='abc', **settings):
    defaults = {
        'max_speed_m_s': 0.0,
        'max_turn_rate_rad_s': 1.0,
        'range_error': (0.0, 0.0, 0.0, 0.0),
        'bearing_half_width_rad': 0.1,
    }
    return new_localizer(robots, **{**defaults, **settings})


def ray(angle_rad):
    return [math.cos(angle_rad), math.sin(angle_rad), 0.0]


def test_a_robot_that_is_only_seen_is_triangulated():
    localizer = make(bearing_half_width_rad=0.01)
    localizer.add_range('a', 'b', 4.0, NOW_S, NOW_S)
    for observer, target, angle in (
        ('a', 'b', 0.0),
        ('a', 'c', math.pi / 3),
        ('b', 'a', 0.0),
        ('b', 'c', -math.pi / 3),
    ):
        localizer.add_bearing(observer, target, ray(angle), NOW_S, NOW_S)
    constraints = constrain(localizer.snapshot(NOW_S))
    for observer in (0, 1):
        low, high = constraints.lower[observer, 2], constraints.upper[observer, 2]
        assert low < 16.0 < high < 20.0
        assert low > 13.0
    (placement,) = localizer.step(NOW_S).placements
    assert placement.positions_m[2] == pytest.approx([2.0, 2.0 * 3**0.5], abs=0.3)


@pytest.mark.parametrize(
    ('at_a', 'at_b'),
    [
        ((1.0, 1.4), (0.4, 0.5)),  # the third angle may be a right one
        ((0.3, 0.4), (1.4, 1.8)),
        ((0.5, 0.6), (2.0, 2.4)),
        ((0.0, 0.3), (0.2, 0.3)),
    ],
)
def test_triangulation_holds_every_triangle(at_a, at_b):
    corners = np.array([[0, 1, 2], [1, 0, 2]])
    low, high = np.array([at_a, at_b]).T
    angles = Angles(corners, 0.5 * (low + high), 0.5 * (high - low) + 1e-15)
    lower, upper = np.zeros((3, 3)), np.full((3, 3), np.inf)
    np.fill_diagonal(upper, 0.0)
    lower[0, 1] = lower[1, 0] = upper[0, 1] = upper[1, 0] = 100.0
    triangulate(lower, upper, angles)
    for a in np.linspace(*at_a, 41):
        for b in np.linspace(*at_b, 41):
            for seen_from, opposite in ((0, b), (1, a)):
                squared = (10.0 * math.sin(opposite) / math.sin(a + b)) ** 2
                assert lower[seen_from, 2] <= squared * (1.0 + 1e-12)
                assert squared * (1.0 - 1e-12) <= upper[seen_from, 2]


def test_no_two_robots_are_nearer_than_their_size_but_anchors_may_be():
    localizer = make('ab', min_separation_m=0.5, anchors={'p': Anchor((0.0, 0.0))})
    lower = constrain(localizer.snapshot(NOW_S)).lower
    assert lower[0, 1] == pytest.approx(0.25)
    assert lower[0, 2] == 0.0


def test_pitch_does_not_bend_a_ray_in_the_plane():
    localizer = make(
        max_age_s=5.0,
        bearing_half_width_rad=0.0,
        max_turn_rate_rad_s=10.0,
        odometry_error=OdometryErrorModel(),
    )
    localizer.add_odometry('a', [0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0], NOW_S - 1.0, NOW_S)
    pitched = [0.0, math.sin(0.1), 0.0, math.cos(0.1)]
    localizer.add_odometry('a', [0.0, 0.0, 0.0], pitched, NOW_S, NOW_S)
    localizer.add_bearing('a', 'b', ray(math.pi / 4.0), NOW_S - 1.0, NOW_S)
    localizer.add_bearing('a', 'c', ray(math.pi / 2.0), NOW_S, NOW_S)
    low_rad, high_rad = constrain(localizer.snapshot(NOW_S)).angles.bounds_rad()
    assert low_rad[0] <= math.pi / 4.0 <= high_rad[0]
    assert high_rad[0] - low_rad[0] < 1e-9


def test_robots_above_each_other_may_be_at_one_place_of_the_plane():
    localizer = make(min_separation_m=0.5, elevations_m={'b': (3.0, 3.0)})
    localizer.add_range('a', 'b', 3.0, NOW_S, NOW_S)
    constraints = constrain(localizer.snapshot(NOW_S))
    assert constraints.lower[0, 1] == 0.0 and constraints.upper[0, 1] < 1e-12
    # Only where they may be too near: b can be beside c, not a hand's breadth above it.
    near = make(min_separation_m=0.5, elevations_m={'b': (0.1, 0.3)})
    near.add_range('a', 'b', 3.0, NOW_S, NOW_S)
    lower = constrain(near.snapshot(NOW_S)).lower
    assert lower[0, 2] == pytest.approx(0.25) and lower[1, 2] == pytest.approx(0.25 - 0.09)


KEY = LinkKey(LinkKind.BEARING, 'a', 'b')


def test_a_displacement_turns_a_line_by_as_much_as_its_tip_may_move():
    reading = RayReading(KEY, 0.0, np.array(ray(0.0)), 0.1, displacement_m=1.0)
    for lower_m2, turn_rad in ((4.0, math.pi / 6.0), (1.0, math.pi)):
        half_width_rad = include_displacement(reading, lower_m2).half_width_rad
        assert 0.1 + turn_rad <= half_width_rad == pytest.approx(0.1 + turn_rad)


@pytest.mark.parametrize(('angle_rad', 'signs'), [(0.5, [1]), (-0.5, [-1]), (0.05, []), (3.1, [])])
def test_an_angle_that_may_have_either_side_has_none(angle_rad, signs):
    angles = Angles(np.array([[0, 1, 2]]), np.array([angle_rad]), np.array([0.1]))
    assert [known.sign for known in angles.chiralities()] == signs


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
        rays = rng.normal(size=(3, 3))
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        errors_rad = np.array(share) * rng.uniform(0.0, 0.8, 3)
        known = zip(rays, errors_rad.tolist(), strict=True)
        readings = [RayReading(KEY, 0.0, ray, error_rad) for ray, error_rad in known]
        sign = spatial_sign(readings)
        if sign:
            certain += 1
            assert sign * np.linalg.det(rays) > 0.0
            assert sign * worst_volume(rays, errors_rad, sign) > -1e-12
    assert certain > 20


def test_rays_that_may_be_anywhere_have_no_certain_sign():
    rays = np.array([[0.0, 0.0, 1.0], ray(0.0), ray(0.1)])
    assert spatial_sign([RayReading(KEY, 0.0, one, 1.3) for one in rays]) == 0
