# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Sensors at known places on robots: bodies of several points, and headings from these."""

import csv
from itertools import product
import json
import math

import numpy as np
import pytest
from sensing import add_ranges, new_localizer, ray
from shapes import holds, random_rotation, turn

from dg_localization import Verdict
from dg_localization.fleet.rotations import yaw_of

NOW_S = 10.0
RANGE_ERROR = 0.02
MOUNTS = {'left': (0.5, 0.3), 'right': (0.5, -0.3)}


def test_two_robots_that_range_between_their_sensors_know_left_from_right():
    """There are no cameras and no anchors: the bodies differ from their mirror images."""
    for seed in range(4):
        rng = np.random.default_rng(seed)
        frames, places = [random_rotation(rng, 2) for _ in range(2)], {}
        for robot, frame in zip(('r0', 'r1'), frames, strict=True):
            places[robot] = rng.uniform(1.0, 7.0, 2)
            for name, arm in MOUNTS.items():
                places[f'{robot}/{name}'] = places[robot] + frame[:2, :2] @ arm
        error = (0.0, 0.0, -RANGE_ERROR, RANGE_ERROR)
        mounts = {'r0': MOUNTS, 'r1': MOUNTS}
        localizer = new_localizer(['r0', 'r1'], mounts=mounts, range_error=error)
        for first, second in product(list(places)[:3], list(places)[3:]):
            range_m = math.dist(places[first], places[second])
            range_m /= 1.0 - rng.uniform(-RANGE_ERROR, RANGE_ERROR)
            assert localizer.add_range(first, second, range_m, NOW_S, NOW_S) is None
        estimate = localizer.step(NOW_S)
        assert (estimate.frame.kind, estimate.frame.points) == ('heading', ('r0',))
        back = frames[0].T
        seen = back[:2, :2] @ (places['r1'] - places['r0'])
        assert holds(estimate, [np.zeros(2), seen], [np.eye(3), back @ frames[1]]), seed
        assert all(one.heading_half_width_rad[1] < 0.5 for one in estimate.placements), seed


def test_sensors_of_a_parked_robot_turn_with_it():
    """It turns by half a radian between two ranges that are right."""
    places = {'parked': (0.0, 0.0), 'b': (6.0, 0.0), 'c': (0.0, 6.0)}
    localizer = new_localizer(
        ['parked', 'r'],
        anchors=places,
        mounts={'parked': {'left': (0.0, 0.5)}},
        range_error=(0.0, 0.0, -1e-3, 1e-3),
        max_speed_m_s=0.0,
    )
    place = (3.0, 4.0)
    add_ranges(localizer, 'r', place, {name: places[name] for name in 'bc'}, NOW_S)
    for stamp_s, yaw in ((NOW_S - 0.5, 0.0), (NOW_S, 0.5)):
        left = (-0.5 * math.sin(yaw), 0.5 * math.cos(yaw))
        add_ranges(localizer, 'parked/left', left, {'r': place}, stamp_s, now_s=NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
    assert holds(estimate, [places['parked'], place])


SITES = [1, 2, 3, 4, 5]


@pytest.fixture(scope='module')
def cart(shared):
    """Return the geometry of three tags on a trolley among eight anchors."""
    return json.loads((shared / 'data/lias_uwb/geometry.json').read_text())['14']


@pytest.mark.parametrize('site', SITES)
def test_every_true_pose_of_a_trolley_with_three_tags_is_inside(shared, cart, site):
    tag_height_m = (0.96, 0.985)
    localizer = new_localizer(
        ['cart'],
        mounts={'cart': {f't{k}': tuple(tag[:2]) for k, tag in enumerate(cart['tags'])}},
        anchors={f'a{k}': place[:2] for k, place in enumerate(cart['anchors'])},
        elevations_m={
            'cart': tag_height_m,
            **{f'a{k}': (place[2], place[2]) for k, place in enumerate(cart['anchors'])},
        },
        range_error=(-0.05, 0.6, 0.0, 0.0),
        max_repeats=1,
        solver={'resolution': 0.02},
    )
    for turn_deg in (0, 120, 240):
        yaw_deg, x, y = cart['poses_yawdeg_x_y'][str(site)][turn_deg // 60]
        path = shared / f'data/lias_uwb/UWB_static_exp_8_14_pos{site}_deg_{turn_deg}.csv'
        with path.open() as file:
            rows = [row for row, _ in zip(csv.reader(file), range(2), strict=False)]
        for row in rows:
            localizer.reset()
            ranges = {}
            for number, text in enumerate(row[1:25]):
                anchor, tag = divmod(number, 3)
                ranges[tag, anchor] = float(text)
                localizer.add_range(f'cart/t{tag}', f'a{anchor}', float(text), NOW_S, NOW_S)
            (placement,) = localizer.step(NOW_S).placements
            low, high = placement.enclosure_m[0]
            assert (low <= [x, y]).all() and ([x, y] <= high).all()
            error_rad = yaw_of(placement.orientations_xyzw[0]) - math.radians(yaw_deg)
            error_rad = abs(math.remainder(error_rad, 2.0 * math.pi))
            assert error_rad <= placement.heading_half_width_rad[0]
            exact = exact_poses(cart, ranges, tag_height_m, placement)
            assert np.hypot(*(placement.positions_m[0] - [x, y])) < 0.3
            # How far headings that agree are from the published one at most.
            assert placement.heading_half_width_rad[0] <= 1.1 * exact
            assert placement.heading_half_width_rad[0] >= exact


def exact_poses(cart, ranges, tag_height_m, placement):
    """Return how far from the published heading poses agree, by sampling poses."""
    low, high = placement.enclosure_m[0]
    half_width = placement.heading_half_width_rad[0]
    axes = [np.linspace(low[k], high[k], 41) for k in range(2)]
    offsets = np.linspace(-half_width, half_width, 161)
    x, y, offset = np.meshgrid(*axes, offsets, indexing='ij')
    yaws_rad = yaw_of(placement.orientations_xyzw[0]) + offset
    c, s = np.cos(yaws_rad), np.sin(yaws_rad)
    agrees = np.ones(x.shape, dtype=bool)
    for (tag, anchor), range_m in ranges.items():
        (a, b, _), place = cart['tags'][tag], cart['anchors'][anchor]
        squared = (x + c * a - s * b - place[0]) ** 2 + (y + s * a + c * b - place[1]) ** 2
        rises = [place[2] - height for height in tag_height_m]
        agrees &= squared <= (range_m + 0.05) ** 2 - min(rise**2 for rise in rises)
        agrees &= squared >= (range_m - 0.6) ** 2 - max(rise**2 for rise in rises)
    return np.abs(offset[agrees]).max()


def test_a_robot_that_only_knows_its_own_sensors_is_not_connected():
    localizer = new_localizer(['alone', 'r', 's'], mounts={'alone': MOUNTS, 'r': MOUNTS})
    localizer.add_range('r/left', 's', 3.0, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.frame.points == ('r',) and estimate.groups == ()
    assert 'reference robot alone is not connected' in estimate.frame_doubt
    assert 'not connected: alone' in estimate.reason
    assert all(np.isnan(p.positions_m[0]).all() for p in estimate.placements)


RANGED = {'a': (-3.0, 3.0), 'b': (3.0, 3.0), 'c': (-3.0, -3.0), 'd': (2.9, -2.8)}
SEEN = {'e': (3.0, 1.0), 'f': (2.5, -1.2), 'g': (1.5, 2.5), 'h': (3.4, 1.9)}


@pytest.mark.parametrize('mounts', [{}, {'tag': (-0.18, -0.11), 'cam': (0.1, 0.05)}])
def test_rays_to_anchors_that_are_not_ranged_give_place_and_heading(mounts):
    """There is no odometry; bounds are at most 1.5 times as wide as those that sampling finds."""
    rng = np.random.default_rng(0)
    place, yaw = np.array([0.6, -0.4]), 2.2
    localizer = new_localizer(
        'r',
        anchors={**RANGED, **SEEN},
        mounts={'r': mounts} if mounts else {},
        range_error=(-0.01, 0.01, 0.0, 0.0),
        bearing_half_width_rad=0.002,
        max_speed_m_s=0.0,
        max_turn_rate_rad_s=0.0,
    )
    names = [f'r/{sensor}' if mounts else 'r' for sensor in ('tag', 'cam')]
    arms_m = (mounts.get(sensor, (0.0, 0.0)) for sensor in ('tag', 'cam'))
    tag, camera = (place + turn(2, yaw)[:2, :2] @ arm_m for arm_m in arms_m)
    for name, anchor_m in RANGED.items():
        add_ranges(localizer, names[0], tag, {name: anchor_m}, NOW_S, rng.uniform(-0.01, 0.01))
    for name, anchor_m in SEEN.items():
        seen = ray(camera, anchor_m, yaw + rng.uniform(-0.002, 0.002))
        assert localizer.add_bearing(names[1], name, seen, NOW_S, NOW_S) is None
    estimate = localizer.step(NOW_S)
    (placement,) = estimate.placements
    assert holds(estimate, place, [turn(2, yaw)])
    assert np.ptp(placement.enclosure_m[0], axis=0).max() < 0.05
    assert placement.heading_half_width_rad[0] < 0.02
