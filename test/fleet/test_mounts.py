# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Sensors at known places on robots: headings from these, of the moment and of the memory."""

import csv
from itertools import product
import json
import math

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer, ray
from shapes import attitude, holds, in_space, random_rotation, turn

from dg_localization import Verdict
from dg_localization.fleet import Mount, OdometryErrorModel
from dg_localization.fleet.rotations import quaternion_of, yaw_of

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


@pytest.fixture(scope='module')
def cart(shared):
    """Return the geometry of three tags on a trolley among eight anchors."""
    return json.loads((shared / 'data/lias_uwb/geometry.json').read_text())['14']


@pytest.mark.parametrize('site', range(1, 6))
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


ANCHORS_M = {
    'a0': (0.0, 0.0, 0.5),
    'a1': (8.0, 0.0, 2.0),
    'a2': (3.0, 7.0, 0.0),
    'a3': (8.0, 7.0, 3.0),
}
TAG_M = np.array([0.5, 0.2, 0.3])
ERROR = OdometryErrorModel(
    translation_per_m=0.02,
    rotation_per_rad=0.02,
    constant_m=0.01,
    constant_rad=0.01,
    tilt_rad=0.02,
)


def pose(time_s, dimension):
    """Return place and rotation of a robot that drives, or flies and tilts, in an eight."""
    x, y = 4.0 + 1.5 * math.sin(0.5 * time_s), 3.0 + 1.5 * math.sin(time_s)
    yaw = math.atan2(1.5 * math.cos(time_s), 0.75 * math.cos(0.5 * time_s))
    if dimension == 2:
        return np.array([x, y, 0.0]), attitude(yaw)
    z, roll = 1.0 + 0.3 * math.sin(0.3 * time_s), 0.4 * math.sin(0.7 * time_s)
    return np.array([x, y, z]), attitude(yaw, 0.0, roll)


def drive(dimension, memory_s, *, lies=(), seed=0, noise_m=0.0, camera=False, **settings):
    """Yield times and estimates of a robot with one tag, away from its center; some ticks lie."""
    rng = np.random.default_rng(seed)
    anchors_m = {name: np.array(place[:dimension]) for name, place in ANCHORS_M.items()}
    localizer = new_localizer(
        ('r',),
        dimension=dimension,
        anchors=anchors_m,
        mounts={'r': {'tag': Mount(tuple(TAG_M[:dimension]), bound_m=0.01)}},
        range_error=(-0.02 - 1.4 * noise_m, 0.02 + 1.4 * noise_m, 0.0, 0.0),
        bearing_half_width_rad=0.1,
        odometry_error=ERROR,
        max_speed_m_s=2.0,
        max_turn_rate_rad_s=3.0,
        memory_s=memory_s,
        solver={'resolution': 0.3, 'max_boxes': 60},
        **settings,
    )
    for tick in range(161):
        time_s = 10.0 + 0.05 * tick
        place, rotation = pose(time_s, dimension)
        stamps = time_s, time_s
        localizer.add_odometry('r', place, quaternion_of(rotation), *stamps)
        name = f'a{tick % 4}'
        gap = in_space(anchors_m[name]) - in_space((place + rotation @ TAG_M)[:dimension])
        reading = np.linalg.norm(gap) + (1.5 if tick in lies else rng.uniform(-noise_m, noise_m))
        assert localizer.add_range('r/tag', name, float(reading), *stamps) is None
        if camera:
            ray = turn(2, rng.uniform(-0.08, 0.08)) @ rotation.T @ gap
            assert localizer.add_bearing('r/tag', name, ray, *stamps) is None
        if tick % 40 == 0 and tick:
            yield time_s, localizer.step(time_s)


def holds_truth(estimate, time_s, dimension):
    place, rotation = pose(time_s, dimension)
    return holds(estimate, place[:dimension], [rotation])


def placement_of(estimate):
    """Return the only placement, whose heading must be known."""
    (placement,) = estimate.placements
    assert placement.heading_known[0]
    return placement


@pytest.mark.parametrize('dimension', [2, 3])
def test_one_sensor_away_from_the_center_tells_the_heading(dimension):
    for time_s, estimate in drive(dimension, memory_s=6.0):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert placement_of(estimate) and holds_truth(estimate, time_s, dimension)
    placement = placement_of(estimate)
    assert placement.heading_half_width_rad[0] < 0.5
    assert np.all(np.ptp(placement.enclosure_m[0], axis=0)[:2] < 0.5)
    *_, (_, moment) = drive(dimension, memory_s=0.0)
    assert not moment.placements[0].heading_known[0]
    widths_m = np.ptp(moment.placements[0].enclosure_m[0], axis=0)
    assert np.all(widths_m[:2] > 0.8)


@pytest.mark.parametrize('dimension', [2, 3])
def test_a_wrong_reading_of_a_sensor_is_tolerated_and_named(dimension):
    """One is the newest reading of an estimate, the other is old."""
    found = set()
    for time_s, estimate in drive(dimension, memory_s=6.0, window_outliers=2, lies=(65, 120)):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert holds_truth(estimate, time_s, dimension)
        found.update(str(suspect) for suspect in estimate.suspects_in_window)
    assert placement_of(estimate).heading_half_width_rad[0] < 0.7
    assert found == {'range r/tag->a1 at 13.250 s', 'range r/tag->a0 at 16.000 s'}


@pytest.mark.parametrize('camera', [False, True])
def test_the_best_point_goes_by_what_a_sensor_measured_before(camera):
    """Ranges are up to 0.2 m off, rays up to 0.08 rad."""
    off_m = {0.0: [], 10.0: []}
    for memory_s, seed in product(off_m, range(2)):
        for time_s, estimate in drive(2, memory_s, seed=seed, noise_m=0.2, camera=camera):
            place = pose(time_s, 2)[0][:2]
            off_m[memory_s].append(np.linalg.norm(estimate.placements[0].positions_m[0] - place))
    assert np.median(off_m[10.0]) < 0.1 < 0.2 < np.median(off_m[0.0])


def test_ranges_of_two_sensors_may_differ_without_a_suspect():
    """Two robots drive side by side; one has a sensor ahead and one behind."""
    localizer = new_localizer(
        ('r', 's'),
        mounts={'r': {'ahead': (0.5, 0.0), 'behind': (-0.5, 0.0)}},
        range_error=(-0.01, 0.01, 0.0, 0.0),
        odometry_error=ERROR,
        window_outliers=1,
    )
    for tick in range(40):
        now_s = 10.0 + 0.1 * tick
        for robot, start_m in (('r', 0.0), ('s', 3.0)):
            add_odometry(localizer, robot, (start_m + 0.05 * tick, 0.0), now_s)
        localizer.add_range('r/ahead', 's', 2.5, now_s, now_s)
        localizer.add_range('r/behind', 's', 3.5, now_s, now_s)
    estimate = localizer.step(now_s)
    assert estimate.verdict is not Verdict.INFEASIBLE
    assert estimate.suspects_in_window == ()


def test_rays_to_landmarks_that_are_not_ranged_widen_nothing():
    ranged = {'a': (0, 0, 0), 'b': (4, 0, 1), 'c': (0, 4, 2), 'd': (4, 4, 0)}
    seen = {'e': (-9, 2, 3), 'f': (8, -9, 1)}
    place_m, widths_m = np.array([1.0, 2.0, 1.5]), []
    for rays in ({}, seen):
        mounts = {'r': {'camera': Mount((0.3, 0.0, 0.1))}}
        settings = {'mounts': mounts, 'dimension': 3, 'bearing_half_width_rad': 0.05}
        localizer = new_localizer(['r'], ranged | rays, range_error=(-0.15, 0.15), **settings)
        add_ranges(localizer, 'r', place_m, ranged, NOW_S)
        for name, landmark_m in rays.items():
            seen_m = np.subtract(landmark_m, place_m) - [0.3, 0.0, 0.1]
            localizer.add_bearing('r/camera', name, seen_m, NOW_S, NOW_S)
        (placement,) = localizer.step(NOW_S).placements
        widths_m.append(np.ptp(placement.enclosure_m[0], axis=0))
    assert np.all(widths_m[1] <= 1.01 * widths_m[0])
