# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Simulated odometry drifts, and keeps the bounds that are stated for it."""

import numpy as np
import pytest

from dg_localization.simulation.moving_fleet import (
    ROBOTS,
    FleetMotion,
    FleetOdometry,
    OdometryErrors,
    Path,
    rotation,
)

PERIOD_S = 0.05
ERRORS = [
    OdometryErrors(),
    OdometryErrors(0.1, 0.02, 0.05, 0.2),
    OdometryErrors(0.0, 0.0, 0.0, 0.3),
    OdometryErrors(1.0, 0.5, 0.5, 1.0),
    OdometryErrors(0.0, 0.0, 0.1, 0.0),
]


def record(errors, seed, seconds=20.0, path=Path.LOOPS, speed=0.2):
    """Return stamps, measured positions and yaws, by robot, and the motion."""
    motion = FleetMotion(speed, seed, path)
    odometry = FleetOdometry(motion, errors, seed)
    stamps = np.arange(0.0, seconds, PERIOD_S)
    samples = [list(odometry.samples(stamp)) for stamp in stamps]
    assert [sample.robot for sample in samples[0]] == list(ROBOTS)
    positions = np.array([[sample.position_m for sample in row] for row in samples])
    yaws = np.array([[sample.yaw_rad for sample in row] for row in samples])
    return stamps, positions.swapaxes(0, 1), yaws.T, motion


def steps(positions, yaws):
    """Return the steps of a path in the body frames at their beginnings, and the turns."""
    turned = [
        (after - before) @ rotation(yaw)
        for before, after, yaw in zip(positions[:-1], positions[1:], yaws[:-1], strict=True)
    ]
    return np.array(turned), np.remainder(np.diff(yaws) + np.pi, 2.0 * np.pi) - np.pi


@pytest.mark.parametrize('errors', ERRORS)
@pytest.mark.parametrize('path', Path)
def test_every_step_keeps_its_bounds_of_truth_and_of_reading(errors, path):
    stamps, positions, yaws, motion = record(errors, seed=2, path=path)
    truth = [motion.state(stamp) for stamp in stamps]
    used_m, used_rad = [], []
    for robot in range(len(ROBOTS)):
        measured_m, measured_rad = steps(positions[robot], yaws[robot])
        true_m, true_rad = steps(
            np.array([state.positions_m[robot] for state in truth]),
            np.array([state.yaws_rad[robot] for state in truth]),
        )
        error_m = np.linalg.norm(measured_m - true_m, axis=1)
        error_rad = np.abs(measured_rad - true_rad)
        for way_m, turn_rad in ((measured_m, measured_rad), (true_m, true_rad)):
            length_m, angle_rad = np.linalg.norm(way_m, axis=1), np.abs(turn_rad)
            bound_m = errors.translation_per_m * length_m + errors.translation_per_rad * angle_rad
            bound_rad = errors.rotation_per_m * length_m + errors.rotation_per_rad * angle_rad
            assert np.all(error_m <= bound_m + 1e-12)
            assert np.all(error_rad <= bound_rad + 1e-12)
        used_m.append(error_m.max() / max(bound_m.max(), 1e-300))
        used_rad.append(error_rad.max() / max(bound_rad.max(), 1e-300))
    if errors == OdometryErrors():  # the bounds are used
        assert max(used_m) > 0.6 and max(used_rad) > 0.6
