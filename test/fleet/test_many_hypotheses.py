# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is remembered rules out placements, however few of them are listed."""

import numpy as np
import pytest

from dg_localization.fleet import FleetConfig, Localizer, RangeErrorModel
from dg_localization.fleet.odometry import OdometryErrorModel

N_ROBOTS = 4
ERROR_M = 0.03
START_S, END_S = 100.0, 112.0


def circling_fleet(seed, max_hypotheses):
    """Let robots drive in circles of their own; return the estimates, one each second."""
    rng = np.random.default_rng(seed)
    robots = tuple(f'r{i}' for i in range(N_ROBOTS))
    localizer = Localizer(
        FleetConfig(
            robots=robots,
            max_hypotheses=max_hypotheses,
            memory_max_seconds=10.0,
            range_error=RangeErrorModel(-ERROR_M, ERROR_M, 0.0, 0.0),
            odometry_error=OdometryErrorModel(translation_per_m=0.02, rotation_per_rad=0.02),
        )
    )
    middles_m = rng.uniform(-3.0, 3.0, (N_ROBOTS, 2))
    rates, phases = rng.uniform(0.2, 0.6, N_ROBOTS), rng.uniform(0.0, 6.0, N_ROBOTS)
    estimates = []
    for now_s in np.arange(START_S, END_S + 0.01, 0.25):
        angles = phases + rates * now_s
        places_m = middles_m + np.stack([np.cos(angles), np.sin(angles)], axis=1)
        halves = 0.5 * (angles + 0.5 * np.pi)
        for robot, (x, y), half in zip(robots, places_m, halves, strict=True):
            quaternion = (0.0, 0.0, np.sin(half), np.cos(half))
            localizer.add_odometry(robot, (x, y, 0.0), quaternion, now_s, now_s, f'{robot}/odom')
        for i in range(N_ROBOTS):
            for j in range(i + 1, N_ROBOTS):
                range_m = np.linalg.norm(places_m[i] - places_m[j]) + rng.uniform(
                    -ERROR_M, ERROR_M
                )
                localizer.add_range(robots[i], robots[j], float(range_m), now_s, now_s)
        if now_s % 1.0 == 0.0:
            estimates.append(localizer.step(now_s))
    return estimates


@pytest.mark.parametrize('seed', [0, 3])
def test_one_listed_placement_is_the_one_that_is_left(seed):
    estimates = circling_fleet(seed, max_hypotheses=1)
    assert not any(estimate.forgotten for estimate in estimates)
    assert all(len(estimate.placements) == 1 for estimate in estimates)
    assert estimates[0].n_hypotheses == 2
    assert estimates[-1].n_hypotheses == 1


def test_a_window_that_rules_out_what_is_listed_contradicts_nothing(monkeypatch):
    monkeypatch.setattr('dg_localization.fleet.answers.LEAST_LISTED', 1)
    estimates = circling_fleet(0, max_hypotheses=1)
    assert not any(estimate.forgotten for estimate in estimates)
    assert all(len(estimate.placements) == 1 for estimate in estimates)
