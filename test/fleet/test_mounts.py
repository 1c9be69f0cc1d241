# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Sensors at known places on robots: bodies of several points, and headings from these."""

import csv
import json
import math

import numpy as np
import pytest
from shapes import holds, in_space, random_rotation

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    Mount,
    RangeErrorModel,
)
from dg_localization.fleet.rotations import rotation_of_quaternion

NOW_S = 10.0
RANGE_ERROR = 0.02
RAY_ERROR_RAD = 0.02
MOUNTS = {
    2: {'left': (0.5, 0.3), 'right': (0.5, -0.3)},
    3: {'left': (0.5, 0.3, 0.1), 'right': (0.5, -0.3, 0.2), 'top': (-0.2, 0.1, 0.8)},
}
ANCHORS = {2: np.array([[0.0, 0.0], [9.0, 0.0], [2.0, 8.0]])}
ANCHORS[3] = np.vstack([np.pad(ANCHORS[2], ((0, 0), (0, 1))), [4.0, 4.0, 7.0]])


class Truth:
    """Robots with sensors: where all of their points are."""

    def __init__(self, seed, dimension, robots=2):
        self.rng = np.random.default_rng(seed)
        self.dimension = dimension
        self.frames = {f'r{k}': random_rotation(self.rng, dimension) for k in range(robots)}
        self.points = {}
        for robot, frame in self.frames.items():
            self.points[robot] = self.rng.uniform(1.0, 7.0, dimension)
            for name, arm in MOUNTS[dimension].items():
                self.points[f'{robot}/{name}'] = (
                    self.points[robot] + frame[:dimension, :dimension] @ arm
                )
        self.anchors = {f'a{k}': place for k, place in enumerate(ANCHORS[dimension])}

    def localizer(self, **settings):
        return Localizer(
            FleetConfig(
                robots=list(self.frames),
                dimension=self.dimension,
                mounts=dict.fromkeys(self.frames, MOUNTS[self.dimension]),
                range_error=RangeErrorModel(0.0, 0.0, -RANGE_ERROR, RANGE_ERROR),
                bearing_half_width_rad=RAY_ERROR_RAD,
                **settings,
            )
        )

    def range_between(self, localizer, first, second):
        places = {**self.points, **self.anchors}
        error = self.rng.uniform(-RANGE_ERROR, RANGE_ERROR)
        range_m = math.dist(places[first], places[second]) / (1.0 - error)
        assert localizer.add_range(first, second, range_m, NOW_S, NOW_S) is None

    def look(self, localizer, observer, target, camera=None):
        """See a target; `camera` is the rotation from the frame of the sensor to the body."""
        places = {**self.points, **self.anchors}
        frame = self.frames[observer.partition('/')[0]]
        ray = frame.T @ in_space(places[target] - places[observer])
        ray = ray if camera is None else camera.T @ ray
        assert localizer.add_bearing(observer, target, ray, NOW_S, NOW_S) is None

    def holds(self, estimate):
        """Return whether positions and headings of all robots are in their bounds."""
        places = [self.points[robot] for robot in self.frames]
        return holds(estimate, places, [*self.frames.values()])


def test_two_robots_that_range_between_their_sensors_know_left_from_right():
    """Without cameras and anchors: the bodies are no mirror images of themselves."""
    for seed in range(4):
        truth = Truth(seed, 2)
        localizer = truth.localizer()
        for first in ('r0', 'r0/left', 'r0/right'):
            for second in ('r1', 'r1/left', 'r1/right'):
                truth.range_between(localizer, first, second)
        estimate = localizer.step(NOW_S)
        assert (estimate.frame.kind, estimate.frame.points) == ('heading', ('r0',))
        way, back = truth.points['r1'] - truth.points['r0'], truth.frames['r0'].T
        truth.points |= {'r0': np.zeros(2), 'r1': back[:2, :2] @ way}
        truth.frames |= {'r0': np.eye(3), 'r1': back @ truth.frames['r1']}
        assert truth.holds(estimate), seed
        assert all(one.heading_half_width_rad[1] < 0.5 for one in estimate.placements), seed


def test_a_camera_on_an_arm_sees_from_there_and_along_its_own_axes():
    truth = Truth(1, 2, robots=1)
    quarter = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
    mounts = {'r0': {'left': MOUNTS[2]['left'], 'right': Mount((0.5, -0.3), 0.0, quarter)}}
    anchors = {name: Anchor(tuple(place)) for name, place in truth.anchors.items()}
    localizer = Localizer(
        FleetConfig(['r0'], mounts=mounts, anchors=anchors, bearing_half_width_rad=RAY_ERROR_RAD)
    )
    for anchor in anchors:
        truth.range_between(localizer, 'r0/left', anchor)
        truth.look(localizer, 'r0/right', anchor, camera=rotation_of_quaternion(quarter))
    estimate = localizer.step(NOW_S)
    (placement,) = estimate.placements
    assert truth.holds(estimate)
    assert placement.heading_half_width_rad[0] < 0.1
    assert np.abs(placement.positions_m[0] - truth.points['r0']).max() < 0.2


def test_sensors_of_a_parked_robot_turn_with_it():
    """It turns by half a radian between two ranges that are right."""
    places = {'parked': (0.0, 0.0), 'b': (6.0, 0.0), 'c': (0.0, 6.0)}
    localizer = Localizer(
        FleetConfig(
            ['parked', 'r'],
            anchors={name: Anchor(place) for name, place in places.items()},
            mounts={'parked': {'left': (0.0, 0.5)}},
            range_error=RangeErrorModel(0.0, 0.0, -1e-3, 1e-3),
            max_speed_m_s=0.0,
        )
    )
    place = (3.0, 4.0)
    for name in 'bc':
        localizer.add_range('r', name, math.dist(place, places[name]), NOW_S, NOW_S)
    for stamp_s, yaw in ((NOW_S - 0.5, 0.0), (NOW_S, 0.5)):
        left = (-0.5 * math.sin(yaw), 0.5 * math.cos(yaw))
        localizer.add_range('parked/left', 'r', math.dist(place, left), stamp_s, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
    boxes_m = [placement.enclosure_m[1] for placement in estimate.placements]
    assert any((low <= place).all() and (place <= high).all() for low, high in boxes_m)


SITES = [1, 2, 3, 4, 5]


@pytest.fixture(scope='module')
def cart(shared):
    """Return the geometry of three tags on a trolley among eight anchors."""
    return json.loads((shared / 'data/lias_uwb/geometry.json').read_text())['14']


@pytest.mark.parametrize('site', SITES)
def test_every_true_pose_of_a_trolley_with_three_tags_is_inside(shared, cart, site):
    tag_height_m = (0.96, 0.985)
    config = FleetConfig(
        robots=['cart'],
        mounts={'cart': {f't{k}': tuple(tag[:2]) for k, tag in enumerate(cart['tags'])}},
        anchors={f'a{k}': Anchor(tuple(place[:2])) for k, place in enumerate(cart['anchors'])},
        elevations_m={
            'cart': tag_height_m,
            **{f'a{k}': (place[2], place[2]) for k, place in enumerate(cart['anchors'])},
        },
        range_error=RangeErrorModel(-0.05, 0.6, 0.0, 0.0),
        max_repeats=1,
        solver=SolverOptions(resolution=0.02),
    )
    localizer = Localizer(config)
    for turn in (0, 120, 240):
        yaw_deg, x, y = cart['poses_yawdeg_x_y'][str(site)][turn // 60]
        path = shared / f'data/lias_uwb/UWB_static_exp_8_14_pos{site}_deg_{turn}.csv'
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
            error_rad = heading_rad(placement) - math.radians(yaw_deg)
            error_rad = abs(math.remainder(error_rad, 2.0 * math.pi))
            assert error_rad <= placement.heading_half_width_rad[0]
            exact = exact_poses(cart, ranges, tag_height_m, placement)
            assert np.hypot(*(placement.positions_m[0] - [x, y])) < 0.3
            # How far headings that agree are from the published one at most.
            assert placement.heading_half_width_rad[0] <= 1.1 * exact
            assert placement.heading_half_width_rad[0] >= exact


def heading_rad(placement):
    z, w = placement.orientations_xyzw[0, 2:]
    return 2.0 * math.atan2(z, w)


def exact_poses(cart, ranges, tag_height_m, placement):
    """Return how far from the published heading poses agree, by sampling poses."""
    low, high = placement.enclosure_m[0]
    half_width = placement.heading_half_width_rad[0]
    axes = [np.linspace(low[k], high[k], 41) for k in range(2)]
    offsets = np.linspace(-half_width, half_width, 161)
    x, y, offset = np.meshgrid(*axes, offsets, indexing='ij')
    c, s = np.cos(heading_rad(placement) + offset), np.sin(heading_rad(placement) + offset)
    agrees = np.ones(x.shape, dtype=bool)
    for (tag, anchor), range_m in ranges.items():
        (a, b, _), place = cart['tags'][tag], cart['anchors'][anchor]
        squared = (x + c * a - s * b - place[0]) ** 2 + (y + s * a + c * b - place[1]) ** 2
        rises = [place[2] - height for height in tag_height_m]
        agrees &= squared <= (range_m + 0.05) ** 2 - min(rise**2 for rise in rises)
        agrees &= squared >= (range_m - 0.6) ** 2 - max(rise**2 for rise in rises)
    return np.abs(offset[agrees]).max()


def test_a_robot_that_only_knows_its_own_sensors_is_not_connected():
    config = FleetConfig(
        ['alone', 'r', 's'],
        mounts={'alone': MOUNTS[2], 'r': MOUNTS[2]},
    )
    localizer = Localizer(config)
    localizer.add_range('r/left', 's', 3.0, NOW_S, NOW_S)
    estimate = localizer.step(NOW_S)
    assert estimate.frame.points == ('r',) and estimate.groups == ()
    assert 'reference robot alone is not connected' in estimate.frame_doubt
    assert 'not connected: alone' in estimate.reason
    assert all(np.isnan(p.positions_m[0]).all() for p in estimate.placements)
