# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The simulated fleet is the paper's, moves within its bounds, and its sensors do too."""

import itertools
import json

import numpy as np
import pytest

from dg_localization.simulation.moving_fleet import (
    ROBOTS,
    FleetMotion,
    FleetOdometry,
    FleetSensors,
    OdometryErrors,
    Path,
    rotation,
)

TIMES_S = np.linspace(0.0, 600.0, 301)


def chirality(a, b, c):
    """Return the chirality of three points in the plane."""
    (x1, y1), (x2, y2) = b - a, c - a
    return np.sign(x1 * y2 - y1 * x2)


def test_it_starts_as_the_fleet_of_the_paper(shared):
    truth = json.loads((shared / 'truth/fleet.json').read_text())
    positions = FleetMotion().state(0.0).positions_m
    solution = truth['solutions'][0]['s']
    for first, second in itertools.combinations(range(6), 2):
        name = f's{first + 1}{second + 1}'
        expected = {**truth['edges_squared_m2'], **solution}[name]
        gap = positions[first] - positions[second]
        assert gap @ gap == pytest.approx(expected, abs=1e-9), name


@pytest.mark.parametrize('seed', range(5))
def test_the_sides_of_the_paper_hold_all_the_time(seed):
    motion = FleetMotion(speed_m_s=0.5, seed=seed)
    for time_s in TIMES_S:
        p = motion.state(time_s).positions_m
        for a, b, i, k in ((1, 2, 0, 3), (1, 3, 2, 5), (1, 5, 3, 4)):
            assert chirality(p[a], p[b], p[i]) == -chirality(p[a], p[b], p[k])


@pytest.mark.parametrize('speed', [0.05, 0.5])
def test_no_robot_is_faster_than_the_bound_and_each_drives_forward(speed):
    motion = FleetMotion(speed_m_s=speed, seed=3)
    step_s = 1e-3
    for time_s in TIMES_S:
        now, later = motion.state(time_s), motion.state(time_s + step_s)
        velocity = (later.positions_m - now.positions_m) / step_s
        norms = np.linalg.norm(velocity, axis=1)
        assert np.all(norms <= speed * (1.0 + 1e-6))
        for robot in range(len(ROBOTS)):
            forward = rotation(now.yaws_rad[robot])[:, 0]
            assert velocity[robot] @ forward == pytest.approx(norms[robot], rel=1e-3)


@pytest.mark.parametrize('error', [1e-6, 1e-5])
def test_small_bounds_hold_in_single_precision(error):
    motion, sensors = FleetMotion(seed=4), FleetSensors(error, error, seed=4)
    for time_s in TIMES_S:
        state = motion.state(time_s)
        for pair, reading_m in sensors.ranges(state).items():
            observer, target = map(ROBOTS.index, pair)
            truth = np.linalg.norm(state.positions_m[observer] - state.positions_m[target])
            range_m = float(np.float32(reading_m))
            assert abs(range_m - truth) <= error * min(truth, range_m)
        for pair, ray in sensors.bearings(state).items():
            observer, target = map(ROBOTS.index, pair)
            x, y = np.float32(ray[:2]).astype(float)
            seen = rotation(state.yaws_rad[observer]) @ (x, y)
            towards = state.positions_m[target] - state.positions_m[observer]
            turn_rad = np.arctan2(seen[0] * towards[1] - seen[1] * towards[0], seen @ towards)
            assert abs(turn_rad) <= error


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
