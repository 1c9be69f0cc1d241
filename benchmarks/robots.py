# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Robots that drive: five of a recording among landmarks, and simulated ones.

MRCLAM (UTIAS, Leung et al., IJRR 30(8), 2011) is a recording of five robots with cameras among 15
landmarks. Odometry is the velocity that was commanded.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import OdometryErrorModel

FloatArray = NDArray[np.float64]

EXCERPT = 'excerpt_D7_t200_440'
ROBOTS = range(1, 6)
SAMPLE_S = 0.1
"""Commands come every 15 ms; integrated, they are sampled this often."""
RANGE_ERROR = 0.15
BEARING_ERROR_RAD = 0.12
SPEED_M_S, TURN_RATE_RAD_S = 0.3, 1.0
"""What the recorded robots never exceed."""

STEP_S = 0.1
ARENA_M = 5.0
"""Simulated robots drive from one place to another of a square of twice this side."""
STEERED_RAD_S = 0.8


def odometry_error(per_turn: float) -> OdometryErrorModel:
    """Return the bounds of commanded odometry: the robot follows about 0.2 s later."""
    return OdometryErrorModel(
        translation_per_m=0.1, rotation_per_rad=per_turn, constant_m=0.04, constant_rad=0.12
    )


@dataclass(frozen=True)
class Recording:
    """One robot of the excerpt: truth, odometry and what it saw of landmarks."""

    truth: FloatArray
    commands: FloatArray
    sightings: FloatArray
    all_sightings: FloatArray
    landmarks: dict[int, FloatArray]

    @classmethod
    def load(cls, folder: Path, robot: int) -> Self:
        """Read the files of a robot."""
        subjects = {int(row[1]): int(row[0]) for row in np.loadtxt(folder / 'Barcodes.dat')}
        landmarks = {
            int(row[0]): row[1:3] for row in np.loadtxt(folder / 'Landmark_Groundtruth.dat')
        }
        seen = np.loadtxt(folder / f'Robot{robot}_Measurement.dat').reshape(-1, 4)
        seen[:, 1] = [subjects.get(int(barcode), 0) for barcode in seen[:, 1]]
        return cls(
            np.loadtxt(folder / f'Robot{robot}_Groundtruth.dat'),
            np.loadtxt(folder / f'Robot{robot}_Odometry.dat'),
            seen[np.isin(seen[:, 1], list(landmarks))],
            seen[seen[:, 1] > 0],
            landmarks,
        )

    @cached_property
    def track(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Stamps, positions and yaws of the integrated commands."""
        stamps, speeds, rates = self.commands.T
        steps_s = np.diff(stamps)
        yaws = np.concatenate([[0.0], np.cumsum(rates[:-1] * steps_s)])
        middles = yaws[:-1] + 0.5 * rates[:-1] * steps_s
        steps = (speeds[:-1] * steps_s)[:, None] * np.stack(
            [np.cos(middles), np.sin(middles), np.zeros(len(middles))], axis=-1
        )
        positions = np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)])
        kept = np.unique(np.round((stamps - stamps[0]) / SAMPLE_S), return_index=True)[1]
        return stamps[kept], positions[kept], yaws[kept]

    def pose(self, time_s: float) -> tuple[FloatArray, float]:
        """Return the true pose at a time."""
        x, y, yaw = (
            np.interp(time_s, self.truth[:, 0], column)
            for column in (self.truth[:, 1], self.truth[:, 2], np.unwrap(self.truth[:, 3]))
        )
        return np.array([x, y, 0.0]), float(yaw)


def rotation(yaw_rad: float) -> FloatArray:
    """Return the rotation about the vertical axis."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def integrate(lengths: FloatArray, turns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return positions (n + 1, 3) and yaws (n + 1,) of a robot that steps, then turns, n times."""
    yaws = np.concatenate([[0.0], np.cumsum(turns)])
    directions = np.stack([np.cos(yaws), np.sin(yaws), np.zeros(len(yaws))], axis=-1)[:-1]
    steps = lengths[:, None] * directions
    return np.concatenate([np.zeros((1, 3)), np.cumsum(steps, axis=0)]), yaws


def wander(
    rng: np.random.Generator, count: int, place_m: FloatArray, yaw_rad: float
) -> tuple[FloatArray, FloatArray]:
    """Return the lengths and turns of a drive from one random place to the next."""
    length = rng.uniform(0.3, 0.8) * STEP_S
    most_rad = STEERED_RAD_S * STEP_S
    goal, turns = rng.uniform(-ARENA_M, ARENA_M, 2), np.empty(count)
    x, y = place_m[:2]
    for step in range(count):
        x, y = x + length * math.cos(yaw_rad), y + length * math.sin(yaw_rad)
        if math.hypot(goal[0] - x, goal[1] - y) < 1.0:
            goal = rng.uniform(-ARENA_M, ARENA_M, 2)
        aim = math.remainder(math.atan2(goal[1] - y, goal[0] - x) - yaw_rad, 2.0 * math.pi)
        turns[step] = min(most_rad, max(-most_rad, aim))
        yaw_rad += turns[step]
    return np.full(count, length), turns


@dataclass(frozen=True)
class SimulatedRobot:
    """A robot that drives about, and its odometry, which errs by a share of way and turn."""

    positions_m: FloatArray
    yaws_rad: FloatArray
    stated_m: FloatArray
    stated_rad: FloatArray

    @classmethod
    def drive(cls, rng: np.random.Generator, seconds: float, odometry: float) -> SimulatedRobot:
        """Draw a drive in the arena."""
        count = round(seconds / STEP_S)
        place_m = rng.uniform(-ARENA_M, ARENA_M, 3) * [1.0, 1.0, 0.0]
        yaw_rad = rng.uniform(-math.pi, math.pi)
        lengths, turns = wander(rng, count, place_m, yaw_rad)
        positions, yaws = integrate(lengths, turns)
        # Drift that lasts is worse than drift that averages out.
        off = 1.0 + rng.uniform(-odometry, odometry, 2)
        stated_m, stated_rad = integrate(lengths / off[0], turns / off[1])
        places = place_m + positions @ rotation(yaw_rad).T
        return cls(places, yaw_rad + yaws, stated_m, stated_rad)
