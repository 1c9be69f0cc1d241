# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Robots that drive in circles in the plane, and a localizer that hears them."""

from itertools import combinations, permutations
import math

import numpy as np
from shapes import missing, turn

from dg_localization import SolverOptions
from dg_localization.fleet import FleetConfig, Localizer, OdometryErrorModel, RangeErrorModel
from dg_localization.fleet.rotations import quaternion_of_yaw, rotations_about_z

START_S = 100.0
TICK_S = 0.25
CENTERS = np.array([[0.0, 0.0], [4.0, 0.5], [1.5, 3.5], [-2.5, 2.0]])
RADII_M = np.array([0.8, -0.6, 1.0, 0.5])
RATES = np.array([0.5, 0.8, 0.6, -0.7])
"""Of the turn; the sign of a radius and of its rate tell whether a robot drives forward."""
ERROR = OdometryErrorModel(translation_per_m=0.02, rotation_per_rad=0.02)


class Circling:
    """Robots r0, r1, ... whose ranges err by shares of up to `noise`; cameras are exact."""

    def __init__(self, robots, *, odometry_frame='', noise=0.0, cameras=False, **settings):
        defaults = {
            'range_error': RangeErrorModel(min_error_relative=-0.02, max_error_relative=0.02),
            'odometry_error': ERROR,
            'max_age_s': 0.1,
            'memory_max_seconds': math.inf,
            'solver': SolverOptions(max_boxes=200),
        }
        self.names = tuple(f'r{i}' for i in range(robots))
        self.config = FleetConfig(robots=self.names, **{**defaults, **settings})
        self.localizer = Localizer(self.config)
        self.odometry_frame, self.noise, self.cameras = odometry_frame, noise, cameras
        self.time_s = 0.0
        self.shift_m = np.zeros((robots, 2))
        """How far robots were carried, which odometry does not see."""
        self.started_m, self.started_rad, self.scale = np.zeros(2), 0.0, 1.0
        """Where odometry starts, how it is turned, and how many meters its unit has."""
        self.ahead_s, self.late_s = 0.0, 0.0
        """How far clocks are ahead, and after what time it arrives what was measured."""
        self.centers_m, self.rates = CENTERS[:robots], RATES[:robots]
        self._rng = np.random.default_rng(0)

    @property
    def now_s(self):
        return START_S + self.time_s

    def poses(self, before_s=0.0):
        """Return true positions (n, 2) and yaws (n,), of now or some time before."""
        n = len(self.names)
        angles = self.rates * (self.time_s - before_s) + np.arange(n)
        around = RADII_M[:n, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        yaws = angles + np.sign(RADII_M[:n] * self.rates) * 0.5 * math.pi
        return self.centers_m + around + self.shift_m, yaws

    def measure(self, *, pairs=None, anchors=True, bearings=True, odometry=None):
        """Measure pairs of robots, or all, once."""
        places, yaws = self.poses(self.late_s)
        stamps = self._stamps()
        for i, name in enumerate(self.names):
            if odometry is None or name in odometry:
                driven = turn(2, self.started_rad)[:2, :2] @ (places[i] - self.shift_m[i])
                pose = [*(driven + self.started_m) / self.scale, 0.0]
                turned = quaternion_of_yaw(yaws[i] + self.started_rad)
                add = self.localizer.add_odometry
                assert add(name, pose, turned, *stamps, self.odometry_frame) is None
        for i, j in combinations(range(len(places)), 2) if pairs is None else pairs:
            self._range(self.names[i], self.names[j], places[j] - places[i])
        for i, j in permutations(range(len(places)), 2) if self.cameras and bearings else ():
            ray = turn(2, -yaws[i]) @ [*(places[j] - places[i]), 0.0]
            self.localizer.add_bearing(self.names[i], self.names[j], ray, *stamps)
        for name, anchor in self.config.anchors.items() if anchors else ():
            for robot, place in zip(self.names, places, strict=True):
                self._range(robot, name, anchor.coordinates_m - place)

    def _range(self, observer, target, gap):
        reading = float(np.linalg.norm(gap)) / (1.0 + self._rng.uniform(-self.noise, self.noise))
        self.localizer.add_range(observer, target, reading, *self._stamps())

    def _stamps(self):
        """Return when clocks say that it was measured, and when it arrives."""
        return self.now_s - self.late_s + self.ahead_s, self.now_s

    def drive(self, seconds, every_s=1.0, **measured):
        """Drive on, measuring; yield an estimate every second, or as often as is said."""
        for tick in range(1, round(seconds / TICK_S) + 1):
            self.time_s += TICK_S
            self.measure(**measured)
            if tick % round(every_s / TICK_S) == 0:
                yield self.localizer.step(self.now_s)

    def truth(self, estimate):
        """Return positions and yaws in the frame of an estimate."""
        places, yaws = self.poses()
        if estimate.frame.kind in ('anchors', 'odometry'):
            return places, yaws
        origin, *towards = (self.names.index(name) for name in estimate.frame.points)
        angle = yaws[origin]
        if estimate.frame.kind == 'robots':
            x, y = places[towards[0]] - places[origin]
            angle = math.atan2(y, x)
        return (places - places[origin]) @ turn(2, angle)[:2, :2], yaws - angle

    def holding(self, estimate):
        """Return the placements that hold the truth."""
        places, yaws = self.truth(estimate)
        turns = rotations_about_z(yaws)
        return [one for one in estimate.placements if not missing(one, places, turns)]
