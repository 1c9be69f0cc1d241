# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""How robots drive about in the plane, and what their odometry states of it."""

from dataclasses import dataclass
import math

import numpy as np

from dg_localization.fleet.odometry_error import OdometryErrorModel

SAMPLE_S = 0.1


@dataclass
class Drive:
    """The true and the stated poses (x, y, yaw) of a robot at each sample."""

    true: np.ndarray
    stated: np.ndarray
    scale: float = 1.0

    def reported(self, sample):
        """Return the pose that is reported, before it is scaled."""
        x, y, yaw = self.stated[sample].tolist()
        return x / self.scale, y / self.scale, yaw

    def pose(self, time_s):
        """Return the true pose at a time since the start, on straight lines between samples."""
        low = min(int(time_s / SAMPLE_S), len(self.true) - 2)
        share = time_s / SAMPLE_S - low
        return self.true[low] + share * (self.true[low + 1] - self.true[low])

    def start(self, place_m, yaw_rad=None):
        """Let the robot start elsewhere, and look elsewhere where that is given."""
        *before_m, before_rad = self.true[0]
        turn_rad = 0.0 if yaw_rad is None else yaw_rad - before_rad
        self.true[:, :2] -= before_m
        self.true = posed(self.true, np.asarray(place_m), turn_rad)

    def start_anew(self, sample, leap_m, turn_rad):
        """Let the odometry start anew at a sample, elsewhere and turned."""
        self.stated[sample:] = posed(self.stated[sample:], leap_m, turn_rad)

    def kick(self, sample, step_m):
        """Move the robot at a sample, unnoticed by its odometry."""
        self.true[sample:, :2] += step_m


def draw_drive(rng, count, error, worst, own, pace=1.0, turning=1.0):
    """
    Drive about; every step of the odometry errs by its bound if `worst`, by less otherwise.

    The constant errors of the poses are drawn of `own`. A robot with `pace` 0 stands, one with
    `turning` 0 drives straight ahead.
    """
    goal_turn = turning * rng.uniform(-0.8, 0.8)
    true = np.array([*rng.uniform(-5.0, 5.0, 2), rng.uniform(-3.0, 3.0)])
    stated = np.array([*rng.uniform(-5.0, 5.0, 2), rng.uniform(-3.0, 3.0)])
    speed = pace * rng.uniform(0.0, 0.7)
    sign, aim = rng.choice([-1.0, 1.0]), rng.uniform(-math.pi, math.pi)
    constant = draw_constant(own, error, 0.0, worst, np.zeros(3))
    poses = ([true], [stated + constant])
    for _sample in range(count):
        if rng.random() < 0.05:
            goal_turn, speed = turning * rng.uniform(-0.8, 0.8), pace * rng.uniform(0.0, 0.7)
        way, turn = speed * SAMPLE_S, goal_turn * SAMPLE_S
        c, s = math.cos(stated[2]), math.sin(stated[2])
        stated = stated + [c * way, s * way, turn]
        constant = draw_constant(own, error, true[2] - stated[2] + turn, worst, constant)
        # Errors count per meter and radian of what is stated.
        *stated_way, stated_turn = stated + constant - poses[1][-1]
        stated_way = math.hypot(*stated_way)
        share = 0.999 if worst else rng.random()
        off = share * (
            error.translation_per_m * stated_way + error.translation_per_rad * abs(stated_turn)
        )
        angle = aim if worst else rng.uniform(-math.pi, math.pi)
        step = np.array([way + off * math.cos(angle), off * math.sin(angle)])
        most = error.rotation_per_m * stated_way + error.rotation_per_rad * abs(stated_turn)
        off_turn = most * (0.999 * sign if worst else rng.uniform(-1.0, 1.0))
        c, s = math.cos(true[2]), math.sin(true[2])
        true = true + [c * step[0] - s * step[1], s * step[0] + c * step[1], turn + off_turn]
        poses[0].append(true)
        poses[1].append(stated + constant)
    return Drive(np.array(poses[0]), np.array(poses[1]), error.translation_scale)


def posed(poses, place_m, turn_rad):
    """Return poses (x, y, yaw) turned about the origin and moved."""
    c, s = math.cos(turn_rad), math.sin(turn_rad)
    places_m = poses[:, :2] @ np.array([[c, s], [-s, c]]) + place_m
    return np.column_stack([places_m, poses[:, 2] + turn_rad])


def draw_constant(rng, error, off_rad, worst, before):
    """
    Draw the constant error of a pose (x, y, yaw) after that of the pose before.

    Where it is the worst, all push the robot the same way while its track, which is off by
    `off_rad`, turns.
    """
    x, y, yaw = before
    if error.constant_m > 0.0:
        angle = -off_rad - 0.5 * math.pi if worst else rng.uniform(-math.pi, math.pi)
        radius = 0.499 * error.constant_m * (1.0 if worst else rng.random())
        x, y = radius * math.cos(angle), radius * math.sin(angle)
    if error.constant_rad > 0.0 and rng.random() < 0.1:
        yaw = 0.999 * error.constant_rad * rng.random()
    return np.array([x, y, yaw])


def draw_errors(rng, robots, own, constants):
    """Draw the errors of the odometry of each robot: those of all, or its own, and its scale."""
    of_all = draw_terms(rng)
    return [
        OdometryErrorModel(
            **(of_all if own.random() < 0.5 else draw_terms(own)),
            translation_scale=float(own.choice([1.0, 1.0, 0.8, 1.25])),
            max_gap_s=1.5 * SAMPLE_S,
            constant_m=float(constants.choice([0.0, 0.0, 0.01, 0.03])),
            constant_rad=float(constants.choice([0.0, 0.0, 0.02])),
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


def draw_lost(seed, count):
    """Draw which samples of an odometry are lost; never the first."""
    rng = np.random.default_rng(seed)
    lost = set()
    if rng.random() < 0.3:
        for first in rng.integers(1, count, rng.integers(1, 4)):
            lost.update(range(first, first + rng.choice([1, 3, 10, 30])))
    return lost
