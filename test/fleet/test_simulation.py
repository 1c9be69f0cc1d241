# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The simulated fleet is that of the paper; its motion and its sensors keep their bounds."""

import numpy as np
import pytest
from solver_cases import orientation

from benchmarks.problems import fleet_placements, squared_distances
from dg_localization.simulation import moving_fleet as simulation

TIMES_S = np.linspace(0.0, 600.0, 301)


def test_it_starts_as_the_fleet_of_the_paper():
    squared = squared_distances(simulation.FleetMotion().state(0.0).positions_m)
    assert squared == pytest.approx(squared_distances(fleet_placements()[0]), abs=1e-9)


@pytest.mark.parametrize('seed', range(5))
def test_the_sides_of_the_paper_hold_all_the_time(seed):
    motion = simulation.FleetMotion(speed_m_s=0.5, seed=seed)
    for time_s in TIMES_S:
        p = motion.state(time_s).positions_m.tolist()
        for a, b, i, k in ((1, 2, 0, 3), (1, 3, 2, 5), (1, 5, 3, 4)):
            assert orientation([p[a], p[b], p[i]]) == -orientation([p[a], p[b], p[k]])


@pytest.mark.parametrize('speed', [0.05, 0.5])
def test_no_robot_is_faster_than_the_bound_and_each_drives_forward(speed):
    motion = simulation.FleetMotion(speed_m_s=speed, seed=3)
    step_s = 1e-3
    for time_s in TIMES_S:
        now, later = motion.state(time_s), motion.state(time_s + step_s)
        velocity = (later.positions_m - now.positions_m) / step_s
        norms = np.linalg.norm(velocity, axis=1)
        assert np.all(norms <= speed * (1.0 + 1e-6))
        for robot in range(len(simulation.ROBOTS)):
            forward = simulation.rotation(now.yaws_rad[robot])[:, 0]
            assert velocity[robot] @ forward == pytest.approx(norms[robot], rel=1e-3)


@pytest.mark.parametrize('error', [1e-6, 1e-5])
def test_small_bounds_hold_in_single_precision(error):
    motion, sensors = simulation.FleetMotion(seed=4), simulation.FleetSensors(error, error, seed=4)
    for time_s in TIMES_S:
        state = motion.state(time_s)
        ranges, rays = sensors.ranges(state), sensors.bearings(state)
        for pair in {*ranges, *rays}:
            observer, target = map(simulation.ROBOTS.index, pair)
            way = state.positions_m[target] - state.positions_m[observer]
            true_m, range_m = np.linalg.norm(way), float(np.float32(ranges.get(pair, np.nan)))
            assert pair not in ranges or abs(range_m - true_m) <= error * min(true_m, range_m)
            seen = np.float32(rays[pair][:2]).astype(float)
            seen = simulation.rotation(state.yaws_rad[observer]) @ seen
            turn_rad = np.arctan2(seen[0] * way[1] - seen[1] * way[0], seen @ way)
            assert abs(turn_rad) <= error


PERIOD_S = 0.05
ERRORS = [
    simulation.OdometryErrors(),
    simulation.OdometryErrors(0.1, 0.02, 0.05, 0.2),
    simulation.OdometryErrors(0.0, 0.0, 0.0, 0.3),
    simulation.OdometryErrors(1.0, 0.5, 0.5, 1.0),
    simulation.OdometryErrors(0.0, 0.0, 0.1, 0.0),
]


def tracks(errors, path, seed=2):
    """Return the stated and the true places, as complex numbers, and yaws: each (n, time)."""
    motion = simulation.FleetMotion(0.2, seed, path)
    odometry = simulation.FleetOdometry(motion, errors, seed)
    times_s = np.arange(0.0, 20.0, PERIOD_S)
    stated = [[[*s.position_m, s.yaw_rad] for s in odometry.samples(t)] for t in times_s]
    states = [motion.state(t) for t in times_s]
    true = [np.column_stack([state.positions_m, state.yaws_rad]) for state in states]
    for x, y, yaws in (
        np.moveaxis(np.array(track), 0, -1).swapaxes(0, 1) for track in (stated, true)
    ):
        yield x + 1j * y, yaws


def steps(places, yaws):
    """Return the steps of paths in the body frames at their beginnings, and the turns."""
    return np.diff(places) * np.exp(-1j * yaws[:, :-1]), np.angle(np.exp(1j * np.diff(yaws)))


@pytest.mark.parametrize('errors', ERRORS)
@pytest.mark.parametrize('path', simulation.Path)
def test_every_step_keeps_its_bounds_of_truth_and_of_reading(errors, path):
    both = [steps(*track) for track in tracks(errors, path)]
    off_m, off_rad = (np.abs(stated - true) for stated, true in zip(*both, strict=True))
    for ways, turns in both:
        ways_m, turns_rad = np.abs(ways), np.abs(turns)
        most_m = errors.translation_per_m * ways_m + errors.translation_per_rad * turns_rad
        most_rad = errors.rotation_per_m * ways_m + errors.rotation_per_rad * turns_rad
        assert np.all(off_m <= most_m + 1e-12) and np.all(off_rad <= most_rad + 1e-12)
        if errors == simulation.OdometryErrors():  # the bounds are used
            assert (off_m.max(axis=1) / most_m.max(axis=1)).max() > 0.6
            assert (off_rad.max(axis=1) / most_rad.max(axis=1)).max() > 0.6
