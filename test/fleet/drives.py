# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How robots drive about in the plane or fly in space, and what their odometry states of it."""

from dataclasses import dataclass
import math

import numpy as np
from shapes import angle_of, attitude, turn

from dg_localization.fleet.odometry_error import OdometryErrorModel

SAMPLE_S = 0.1
DELAYS_S = (0.0, 0.05, 0.3)
"""After these readings arrive."""
FASTEST_M_S, TILTING_RAD = 0.7, 0.03
"""Of a drive: its greatest speed, and how far roll and pitch change from sample to sample."""


@dataclass
class Drive:
    """The true poses (place, yaw, pitch, roll) and the stated ones (place, rotation)."""

    true: list
    stated: list
    scale: float

    def pose(self, time_s):
        """Return the true place and rotation since the start, evenly between samples."""
        place, *angles = self._between(time_s, 4)
        return place, attitude(*angles)

    def place(self, time_s):
        """Return the true place since the start, evenly between samples."""
        return self._between(time_s, 1)[0]

    def reported(self, sample):
        """Return the pose that is reported, before it is scaled."""
        place, rotation = self.stated[sample]
        return place / self.scale, rotation

    def start(self, place_m, yaw_rad=None):
        """Let the robot start elsewhere, and look elsewhere where that is given."""
        before_m, before_rad, *_ = self.true[0]
        turn_rad = 0.0 if yaw_rad is None else yaw_rad - before_rad
        axes = turn(2, turn_rad)
        self.true = [
            (place_m + axes @ (place - before_m), yaw + turn_rad, *tilt)
            for place, yaw, *tilt in self.true
        ]

    def start_anew(self, sample, leap_m, axes):
        """Let the odometry start anew at a sample, elsewhere and turned."""
        self.stated[sample:] = [
            (axes @ place + leap_m, axes @ rotation) for place, rotation in self.stated[sample:]
        ]

    def follow(self, other, sample):
        """Go on from where another drive is at a sample, after that drive."""
        (place, yaw, *_), (stated, rotation) = other.true[sample], other.stated[sample]
        self.start(place, yaw)
        axes = rotation @ self.stated[0][1].T
        self.start_anew(0, stated - axes @ self.stated[0][0], axes)
        self.true = other.true[:sample] + self.true
        self.stated = other.stated[:sample] + self.stated

    def kick(self, sample, step_m):
        """Move the robot at a sample, unnoticed by its odometry."""
        self.true[sample:] = [(place + step_m, *angles) for place, *angles in self.true[sample:]]

    def park(self):
        """Let the robot stand still."""
        self.true = [self.true[0]] * len(self.true)

    def _between(self, time_s, parts):
        low = min(int(time_s / SAMPLE_S), len(self.true) - 2)
        share = time_s / SAMPLE_S - low
        before, after = self.true[low][:parts], self.true[low + 1][:parts]
        return [a + share * (b - a) for a, b in zip(before, after, strict=True)]


def direction(rng, flat=(1.0, 1.0, 1.0)):
    """Draw a unit vector, in the plane where `flat` says so."""
    drawn = rng.normal(size=3) * flat
    return drawn / math.sqrt(drawn @ drawn)


def draw_drive(rng, count, error, worst, flat, steepest_rad=0.0, pace=1.0, turning=1.0):
    """
    Drive about; odometry errs by its bounds if `worst`, by less otherwise.

    With `flat` (1, 1, 0) it stays in the plane. A robot with `pace` 0 stands, one with `turning` 0
    keeps its heading.
    """
    place, yaw = rng.uniform(-5.0, 5.0, 3) * flat * [1.0, 1.0, 0.4], rng.uniform(-3.0, 3.0)
    track, track_yaw = rng.uniform(-5.0, 5.0, 3) * flat, rng.uniform(-3.0, 3.0)
    tilt, goal_tilt = rng.uniform(-steepest_rad, steepest_rad, (2, 2))
    rate = turning * rng.uniform(-0.8, 0.8)
    velocity = pace * rng.uniform(0.0, FASTEST_M_S) * direction(rng, flat)
    aim, sign = direction(rng, flat), rng.choice([-1.0, 1.0])
    true, stated, step, before_yaw = [], [], np.zeros(3), yaw
    for _sample in range(count):
        reported = _stated(rng, error, worst, (track, track_yaw, *tilt), yaw - track_yaw, aim)
        if stated:
            # Errors count per meter and radian of what is stated.
            way_m = math.dist(reported[0], stated[-1][0])
            turned_rad = angle_of(stated[-1][1].T @ reported[1])
            off_m = error.translation_per_m * way_m + error.translation_per_rad * turned_rad
            off_rad = error.rotation_per_m * way_m + error.rotation_per_rad * turned_rad
            share = 0.99 if worst else 0.99 * rng.random()
            off = share * off_m * (aim if worst else direction(rng, flat))
            place = place + turn(2, before_yaw) @ (step + off)
            yaw = before_yaw + rate * SAMPLE_S + sign * share * off_rad
        true.append((place, yaw, *tilt))
        stated.append(reported)
        if rng.random() < 0.05:
            rate = turning * rng.uniform(-0.8, 0.8)
            velocity = pace * rng.uniform(0.0, FASTEST_M_S) * direction(rng, flat)
            goal_tilt = rng.uniform(-steepest_rad, steepest_rad, 2)
        before_yaw, step = yaw, velocity * SAMPLE_S
        track, track_yaw = track + turn(2, track_yaw) @ step, track_yaw + rate * SAMPLE_S
        tilt = tilt + np.clip(goal_tilt - tilt, -TILTING_RAD, TILTING_RAD)
    return Drive(true, stated, error.translation_scale)


def _stated(rng, error, worst, pose, off_rad, aim):
    """
    Return what odometry states of a pose of its track, which is off by a turn.

    Where errors are the worst, constant ones all push the robot the same way as its track turns.
    """
    track, yaw, pitch, roll = pose
    share = 1.0 if worst else rng.random()
    constant = 0.499 * share * error.constant_m * (turn(2, -off_rad) @ aim)
    constant_rad = 0.999 * error.constant_rad * rng.random()
    tilted = 0.98 * (error.tilt_rad or 0.0) * share * rng.choice([-1.0, 1.0], 2)
    part = rng.random()
    angles = yaw + constant_rad, pitch + part * tilted[0], roll + (1.0 - part) * tilted[1]
    return track + constant, attitude(*angles)


def draw_errors(rng, robots, tilts_rad):
    """Draw the errors of the odometry of each robot: those of all, or its own, and its scale."""
    of_all = draw_terms(rng)
    return [
        OdometryErrorModel(
            **(of_all if rng.random() < 0.5 else draw_terms(rng)),
            translation_scale=float(rng.choice([1.0, 1.0, 0.8, 1.25])),
            max_gap_s=1.5 * SAMPLE_S,
            constant_m=float(rng.choice([0.0, 0.0, 0.01, 0.03])),
            constant_rad=float(rng.choice([0.0, 0.0, 0.02])),
            tilt_rad=rng.choice(tilts_rad),
        )
        for _robot in range(robots)
    ]


def draw_terms(rng):
    return {
        'translation_per_m': rng.choice([0.0, 0.05, 0.2]),
        'translation_per_rad': rng.choice([0.0, 0.02]),
        'rotation_per_m': rng.choice([0.0, 0.05]),
        'rotation_per_rad': rng.choice([0.0, 0.05, 0.2]),
    }


def draw_lost(rng, count):
    """Draw which samples of an odometry are lost; never the first."""
    lost = set()
    if rng.random() < 0.3:
        for first in rng.integers(1, count, rng.integers(1, 4)):
            lost.update(range(first, first + rng.choice([1, 3, 10, 30])))
    return lost
