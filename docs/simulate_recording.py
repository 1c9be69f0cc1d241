# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Write a simulated recording for the tutorial: four robots with ultra-wideband radios and odometry.

    python docs/simulate_recording.py first_robots

It takes numpy and the package rosbags, and no ROS. The same command writes the same recording.
"""

from __future__ import annotations

from itertools import combinations
import math
from pathlib import Path
import sys

import numpy as np
from recorder import Recorder

ROBOTS = ('alice', 'bob', 'carol', 'dave')
HOMES_M = np.array([[0.0, 0.0], [6.0, 1.0], [5.0, 6.0], [-1.0, 5.0]])
RADII_M = np.array([1.0, 0.8, 1.2, 0.9])
TURNS_RAD_S = np.array([0.4, -0.5, 0.35, -0.45])
PHASES_RAD = np.array([0.0, 2.0, 4.0, 1.0])
SECONDS, RANGE_PERIOD_S, ODOMETRY_PERIOD_S = 40.0, 0.2, 0.05
START_S = 1_700_000_000.0
BIAS_M, TAIL_M, MAX_ERROR_M = 0.12, 0.05, 0.6
"""A range is too long by the bias and an exponential tail, 0.6 m at most."""
SCALES = np.array([1.02, 0.98, 1.01, 0.97])
"""True distance over the distance that each odometry reports."""
STEP_ERROR = 0.02
"""Further errors of each step and turn of odometry are up to this fraction of it."""


def true_poses(time_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return positions (n, 2) in m and headings (n,) in rad: each robot drives a circle."""
    angles = PHASES_RAD + TURNS_RAD_S * time_s
    positions_m = HOMES_M + RADII_M[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return positions_m, angles + np.sign(TURNS_RAD_S) * math.pi / 2.0


def record(path: Path) -> None:
    """Write the recording, a folder that does not exist."""
    random, bag = np.random.default_rng(0), Recorder()
    for time_s in np.arange(0.0, SECONDS, RANGE_PERIOD_S):
        stamp_s = START_S + float(time_s)
        positions_m, headings_rad = true_poses(time_s)
        for i, robot in enumerate(ROBOTS):
            bag.add_truth(robot, positions_m[i], headings_rad[i], stamp_s)
        for i, j in combinations(range(len(ROBOTS)), 2):
            error_m = min(BIAS_M + random.exponential(TAIL_M), MAX_ERROR_M)
            range_m = math.dist(positions_m[i], positions_m[j]) + error_m
            bag.add_range(ROBOTS[i], ROBOTS[j], range_m, stamp_s, stamp_s)
    for i, robot in enumerate(ROBOTS):
        before_m, before_rad = (values[i] for values in true_poses(0.0))
        place_m, heading_rad = np.zeros(2), 0.0
        for time_s in np.arange(0.0, SECONDS, ODOMETRY_PERIOD_S):
            now_m, now_rad = (values[i] for values in true_poses(time_s))
            errors = 1.0 + random.uniform(-STEP_ERROR, STEP_ERROR, 2)
            turn_rad = (now_rad - before_rad) * errors[0]
            step_m = math.dist(now_m, before_m) / SCALES[i] * errors[1]
            along_rad = heading_rad + turn_rad / 2.0
            place_m += step_m * np.array([math.cos(along_rad), math.sin(along_rad)])
            heading_rad += turn_rad
            before_m, before_rad = now_m, now_rad
            bag.add_odometry(robot, place_m.tolist(), heading_rad, START_S + float(time_s))
    bag.write(path)


if __name__ == '__main__':
    if len(sys.argv) != 2 or Path(sys.argv[1]).exists():
        sys.exit('usage: simulate_recording.py FOLDER, the name of a folder that does not exist')
    record(Path(sys.argv[1]))
    print(f'{sys.argv[1]}: {SECONDS:.0f} s of {len(ROBOTS)} simulated robots')
