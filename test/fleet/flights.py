# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Robots that fly among anchors: ranges to one anchor at a time, odometry at the end of its bounds.

``python test/fleet/flights.py 40`` flies so many times and says what is known at the end.
"""

import math
import sys
import time

import numpy as np

from dg_localization import SolverOptions
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
)
from dg_localization.fleet.rotations import quaternion_of, rotation_of_quaternion

ANCHORS_M = [(0.0, 0.0, 0.0), (10.0, 0.0, 3.0), (10.0, 10.0, 0.0), (0.0, 10.0, 2.5)]
TICK_S = 0.1
RANGE_ERROR_M = 0.1
RAY_ERROR_RAD = 0.05
ERROR = OdometryErrorModel(
    translation_per_m=0.05,
    translation_per_rad=0.01,
    rotation_per_m=0.01,
    rotation_per_rad=0.05,
    constant_m=0.02,
    constant_rad=0.02,
    tilt_rad=0.03,
)


def turn(axis, angle_rad):
    """Return the rotation about a coordinate axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    matrix = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def attitude(yaw, pitch, roll):
    """Return the rotation about x, then y, then z."""
    (cz, sz), (cy, sy), (cx, sx) = ((math.cos(a), math.sin(a)) for a in (yaw, pitch, roll))
    return np.array(
        [
            [cz * cy, cz * sy * sx - sz * cx, cz * sy * cx + sz * sx],
            [sz * cy, sz * sy * sx + cz * cx, sz * sy * cx - cz * sx],
            [-sy, cy * sx, cy * cx],
        ]
    )


def angle_rad(rotation):
    return math.acos(min(1.0, max(-1.0, 0.5 * (rotation.trace() - 1.0))))


class Flier:
    """A robot that flies about, and odometry that is as wrong as its bounds let it be."""

    def __init__(self, random, steepest_rad):
        self._random = random
        self._center_m = random.uniform([3.0, 3.0, 1.5], [7.0, 7.0, 3.0])
        self._reach_m = random.uniform([0.5, 0.5, 0.1], [3.0, 3.0, 1.0])
        self._rates = random.uniform(0.1, 0.4, 6)
        self._phases = random.uniform(0.0, 6.0, 6)
        self._steepest_rad = steepest_rad
        # Errors that all go one way add up most.
        self._bias = random.uniform(-1.0, 1.0, 4) if random.random() < 0.5 else None
        self._stated = random.normal(size=3), random.uniform(-3.0, 3.0)
        self._before = None

    def pose(self, time_s):
        """Return position, yaw, pitch and roll."""
        waves = np.sin(self._rates * time_s + self._phases)
        pitch, roll = self._steepest_rad * waves[3:5]
        return self._center_m + self._reach_m * waves[:3], 3.0 * waves[5], pitch, roll

    def odometry(self, time_s):
        """Return what odometry says of the pose; times ascend."""
        position, yaw, pitch, roll = self.pose(time_s)
        if self._before is not None:
            self._advance(position, yaw, pitch, roll)
        self._before = position, yaw, pitch, roll
        random = self._random
        stated, stated_yaw = self._stated
        shift = self._direction() * ERROR.constant_m / 2.0
        stated_yaw += random.choice([-1.0, 1.0]) * ERROR.constant_rad / 2.0
        share = random.uniform(0.0, 1.0)
        pitch += random.choice([-1.0, 1.0]) * share * ERROR.tilt_rad
        roll += random.choice([-1.0, 1.0]) * (1.0 - share) * ERROR.tilt_rad
        return stated + shift, attitude(stated_yaw, pitch, roll)

    def _advance(self, position, yaw, pitch, roll):
        before_m, before_yaw, *tilt = self._before
        step = turn(2, -before_yaw) @ (position - before_m)
        way_m = float(np.linalg.norm(step)) * (1.0 - ERROR.translation_per_m)
        turned = attitude(before_yaw, *tilt).T @ attitude(yaw, pitch, roll)
        turned_rad = angle_rad(turned) * (1.0 - ERROR.rotation_per_rad)
        error_m = ERROR.translation_per_m * way_m + ERROR.translation_per_rad * turned_rad
        error_rad = ERROR.rotation_per_m * way_m + ERROR.rotation_per_rad * turned_rad
        # What odometry states of the way is a little shorter: bounds hold with room to spare.
        stated_m, stated_yaw = self._stated
        step = step + 0.9 * error_m * self._direction()
        side = math.copysign(1.0, self._bias[3]) if self._bias is not None else 0.0
        side = side or self._random.choice([-1.0, 1.0])
        self._stated = (
            stated_m + turn(2, stated_yaw) @ step,
            stated_yaw + (yaw - before_yaw) + 0.9 * side * error_rad,
        )

    def _direction(self):
        drawn = self._random.normal(size=3) if self._bias is None else self._bias[:3]
        return drawn / np.linalg.norm(drawn)


class Flight:
    """Robots that fly, and a localizer that hears them."""

    def __init__(self, seed, robots=2, steepest_rad=0.3, rays=False, **settings):
        self.random = np.random.default_rng(seed)
        self.names = tuple(f'r{i}' for i in range(robots))
        self.rays = rays
        anchors = {f'a{i}': Anchor(place) for i, place in enumerate(ANCHORS_M)}
        defaults = {
            'dimension': 3,
            'anchors': anchors,
            'range_error': RangeErrorModel(min_error_m=-RANGE_ERROR_M, max_error_m=RANGE_ERROR_M),
            'bearing_half_width_rad': RAY_ERROR_RAD,
            'odometry_error': ERROR,
            'max_speed_m_s': 3.0,
            'max_turn_rate_rad_s': 3.0,
            'max_age_s': 0.5,
            'memory_s': 15.0,
            'memory_max_seconds': math.inf,
            'solver': SolverOptions(max_boxes=50),
        }
        self.localizer = Localizer(FleetConfig(robots=self.names, **{**defaults, **settings}))
        self.fliers = [Flier(self.random, steepest_rad) for _ in self.names]
        self.time_s = 100.0

    def fly(self, seconds, measures=lambda robot: True):
        """Fly on, measuring; yield an estimate every second."""
        for tick in range(1, round(seconds / TICK_S) + 1):
            self.time_s += TICK_S
            for name, flier in zip(self.names, self.fliers, strict=True):
                place, rotation = flier.odometry(self.time_s)
                stated = place, quaternion_of(rotation), self.time_s, self.time_s
                assert self.localizer.add_odometry(name, *stated) is None
                if measures(name):
                    self._measure(name, flier)
            if tick % 10 == 0:
                yield self.localizer.step(self.time_s)

    def _measure(self, name, flier):
        number = int(self.random.integers(len(ANCHORS_M)))
        place, *angles = flier.pose(self.time_s)
        gap = ANCHORS_M[number] - place
        reading = np.linalg.norm(gap) + RANGE_ERROR_M * self.random.uniform(-1.0, 1.0)
        stamps = self.time_s, self.time_s
        assert self.localizer.add_range(name, f'a{number}', float(reading), *stamps) is None
        if self.rays:
            ray = attitude(*angles).T @ gap
            across = np.cross(ray, self.random.normal(size=3))
            across *= np.linalg.norm(ray) / np.linalg.norm(across)
            ray = ray + 0.9 * math.tan(RAY_ERROR_RAD) * across * self.random.uniform()
            assert self.localizer.add_bearing(name, f'a{number}', ray, *stamps) is None

    def lost(self, estimate):
        """Return the robots whose pose no placement holds."""
        return [
            name
            for row, (name, flier) in enumerate(zip(self.names, self.fliers, strict=True))
            if not any(self._holds(p, row, flier) for p in estimate.placements)
        ]

    def _holds(self, placement, row, flier):
        place, *angles = flier.pose(self.time_s)
        low, high = placement.enclosure_m[row]
        if not (np.all(low <= place) and np.all(place <= high)):
            return False
        if not placement.heading_known[row]:
            return True
        stated = rotation_of_quaternion(placement.orientations_xyzw[row])
        off_rad = angle_rad(stated.T @ attitude(*angles))
        return off_rad <= placement.heading_half_width_rad[row] + 1e-6


def main(flights):
    """Print what is known of two robots after 15 s in flights, with a memory and without."""
    print('| memory (s) | inside | horizontal (m) | vertical (m) | heading (rad) | ms |')
    print('|---|---|---|---|---|---|')
    for memory_s in (0.0, 15.0):
        widths_m, headings_rad, seconds, lost = [], [], [], 0
        for seed in range(flights):
            flight = Flight(seed, memory_s=memory_s)
            start_s = time.process_time()
            *_, estimate = flight.fly(15.0)
            seconds.append((time.process_time() - start_s) / 15.0)
            lost += len(flight.lost(estimate))
            low, high = np.array([p.enclosure_m for p in estimate.placements]).transpose(
                2, 0, 1, 3
            )
            widths_m += list(high.max(axis=0) - low.min(axis=0))
            headings_rad += list(estimate.placements[0].heading_half_width_rad)
        x_m, y_m, z_m = np.array(widths_m).T
        across_m, robots = np.maximum(x_m, y_m), len(widths_m)
        print(
            f'| {memory_s:g} | {robots - lost} of {robots} | {np.median(across_m):.2f} '
            f'| {np.median(z_m):.2f} | {np.median(headings_rad):.2f} '
            f'| {1e3 * np.median(seconds):.0f} |',
            flush=True,
        )


if __name__ == '__main__':
    main(int(sys.argv[1]))
