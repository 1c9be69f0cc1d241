# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One moment without odometry, in the plane: every sensor of a robot among anchors counts."""

import math
import os

import numpy as np
import pytest
from sensing import new_localizer, ray
from shapes import holds, turn

from dg_localization.fleet import Anchor, Mount

CASES = int(os.environ.get('DG_PROPERTY_FLEETS', '60'))
NOW_S = 100.0


class Rig:
    """A robot with a tag and a camera among anchors: some are ranged, some are seen."""

    def __init__(self, seed, speed_m_s=0.0, turn_rate_rad_s=0.0):
        self.rng = rng = np.random.default_rng([seed, 5])
        self.error_m, self.error_rad = (rng.choice([0.01, 0.1, 0.3]), rng.choice([0.002, 0.05]))
        names = [f'a{k}' for k in range(rng.integers(3, 9))]
        self.bound_m = rng.choice([0.0, 0.05])
        self.stated = {name: rng.uniform(-5.0, 5.0, 2) for name in names}
        off = rng.uniform(-0.7, 0.7, (len(names), 2)) * self.bound_m
        self.places = {name: self.stated[name] + off[k] for k, name in enumerate(names)}
        self.ranged = [name for name in names if rng.random() < 0.7] or names[:3]
        self.seen = [name for name in names if rng.random() < 0.7] or names[-2:]
        self.mounts = {}
        for sensor in ('tag', 'cam'):
            if rng.random() < 0.7:
                self.mounts[sensor] = rng.uniform(-0.4, 0.4, 2)
        self.place, self.yaw = rng.uniform(-4.0, 4.0, 2), rng.uniform(-math.pi, math.pi)
        self.speed_m_s, self.turn_rate_rad_s = speed_m_s, turn_rate_rad_s
        self.velocity = rng.uniform(-0.7, 0.7, 2) * speed_m_s
        self.turning = rng.uniform(-1.0, 1.0) * turn_rate_rad_s

    def at(self, sensor, age_s):
        """Return the place of a sensor, and the yaw, some time ago."""
        yaw = self.yaw - self.turning * age_s
        arm = turn(2, yaw)[:2, :2] @ self.mounts.get(sensor, np.zeros(2))
        return self.place - self.velocity * age_s + arm, yaw

    def estimate(self, **more):
        mounts = {name: Mount(tuple(arm), 0.0) for name, arm in self.mounts.items()}
        localizer = new_localizer(
            ('r',),
            anchors={n: Anchor(tuple(p), self.bound_m) for n, p in self.stated.items()},
            mounts={'r': mounts} if mounts else {},
            range_error=(-self.error_m, self.error_m, 0.0, 0.0),
            bearing_half_width_rad=self.error_rad,
            max_speed_m_s=self.speed_m_s,
            max_turn_rate_rad_s=self.turn_rate_rad_s,
            **more,
        )
        tag, camera = (f'r/{s}' if s in self.mounts else 'r' for s in ('tag', 'cam'))
        for name in self.ranged:
            age_s = self.rng.uniform(0.0, 0.4)
            place, _ = self.at('tag', age_s)
            range_m = np.linalg.norm(self.places[name] - place)
            range_m = max(0.01, range_m + self.rng.uniform(-1.0, 1.0) * self.error_m)
            assert localizer.add_range(tag, name, range_m, NOW_S - age_s, NOW_S) is None
        for name in self.seen:
            age_s = self.rng.uniform(0.0, 0.4)
            place, yaw = self.at('cam', age_s)
            off_rad = self.rng.uniform(-1.0, 1.0) * self.error_rad
            seen = ray(place, self.places[name], yaw - off_rad)
            assert localizer.add_bearing(camera, name, seen, NOW_S - age_s, NOW_S) is None
        return localizer.step(NOW_S)

    def holds(self, estimate):
        return holds(estimate, self.place, [turn(2, self.yaw)])


@pytest.mark.parametrize('motion', [(0.0, 0.0), (1.0, 0.8)], ids=['at rest', 'moving'])
@pytest.mark.parametrize('outliers', [0, 1])
def test_the_truth_is_never_lost(motion, outliers):
    known = 0
    for seed in range(CASES):
        rig = Rig(seed, *motion)
        estimate = rig.estimate(window_outliers=outliers)
        assert rig.holds(estimate), seed
        known += bool(estimate.placements[0].heading_known[0])
    assert known > 0.6 * CASES


def test_rays_to_anchors_that_are_not_ranged_give_place_and_heading():
    """The bounds are at most 1.5 times as wide as those that sampling finds."""
    anchors = {'a': (-3.0, 3.0), 'b': (3.0, 3.0), 'c': (-3.0, -3.0), 'd': (2.9, -2.8)}
    seen = {'e': (3.0, 1.0), 'f': (2.5, -1.2), 'g': (1.5, 2.5), 'h': (3.4, 1.9)}
    for mounts in ({}, {'tag': (-0.18, -0.11), 'cam': (0.1, 0.05)}):
        rig = Rig(0)
        rig.error_m, rig.error_rad, rig.bound_m = 0.01, 0.002, 0.0
        rig.stated = {name: np.array(place) for name, place in {**anchors, **seen}.items()}
        rig.places, rig.ranged, rig.seen = rig.stated, list(anchors), list(seen)
        rig.mounts = {name: np.array(arm) for name, arm in mounts.items()}
        estimate = rig.estimate()
        (placement,) = estimate.placements
        assert rig.holds(estimate)
        assert np.ptp(placement.enclosure_m[0], axis=0).max() < 0.05
        assert placement.heading_half_width_rad[0] < 0.02
