# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""When a set of poses runs empty, the readings say since when they agree."""

import numpy as np
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairOptions, PairReadings, PastPoses, count_agreeing, cover_poses

ANCHORS = np.array([[0.0, 0.0, 0.0], [8.0, 0.0, 0.0], [0.0, 8.0, 0.0]])


def readings_of_a_drive(jump_at, jump_m, count=60):
    """Drive along y at 0.1 m a step, seen by three anchors in turn; odometry jumps once."""
    age = np.arange(count)
    position = np.stack([np.full(count, 2.0), 6.0 - 0.1 * age, np.zeros(count)], axis=-1)
    stated = position - position[0]
    stated[age >= jump_at, 0] += jump_m
    half = np.stack([0.001 * age, 0.001 * age, np.zeros(count)], axis=-1)
    poses = PastPoses(Interval(stated - half, stated + half), Interval(-0.001 * age, 0.001 * age))
    anchors = ANCHORS[age % 3]
    distance = np.linalg.norm(position - anchors, axis=-1)
    return PairReadings.of(
        Interval.point(anchors),
        poses.points_now(Interval.point(np.zeros((count, 3)))),
        Interval(distance - 0.02, distance + 0.02),
    )


def test_readings_that_agree_all_count():
    assert count_agreeing(readings_of_a_drive(60, 0.0)) == 60


@pytest.mark.parametrize('jump_at', [10, 33, 50])
def test_a_jump_of_the_odometry_is_found(jump_at):
    readings = readings_of_a_drive(jump_at, 0.8)
    assert cover_poses(readings).empty
    assert jump_at <= count_agreeing(readings) <= jump_at + 3
    tolerant = count_agreeing(readings, PairOptions(max_outliers=2))
    assert jump_at + 2 <= tolerant <= jump_at + 8


def test_what_is_not_proved_counts_as_agreeing():
    assert count_agreeing(readings_of_a_drive(10, 0.8), stopped=lambda: True) == 60
