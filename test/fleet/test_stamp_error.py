# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Clocks of robots differ: what they stamp was true a little earlier or later."""

import math

from circling import Circling
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, anchors_at, new_localizer, ray

from dg_localization import Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel
from dg_localization.fleet.rotations import yaw_of

ANCHORS_M = {'a0': (0.0, 0.0), 'a1': (8.0, 0.0), 'a2': (3.0, 7.0)}


def driving(ahead_s=0.0, late_s=0.0, **settings):
    """Return a robot that drives in a circle at 0.4 m/s among anchors, by a clock of its own."""
    robot = Circling(
        1,
        anchors=anchors_at(ANCHORS_M),
        range_error=RangeErrorModel(-1e-4, 1e-4, 0.0, 0.0),
        max_speed_m_s=0.404,
        max_turn_rate_rad_s=0.505,
        odometry_error=OdometryErrorModel(1e-3, 0.0, 0.0, 1e-3),
        **settings,
    )
    robot.ahead_s, robot.late_s = ahead_s, late_s
    return robot


@pytest.mark.parametrize('odometry', [(), None])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_the_truth_is_inside_with_clocks_as_wrong_as_is_stated(ahead_s, odometry):
    robot = driving(ahead_s, 0.05, stamp_error_s=0.05)
    for estimate in robot.drive(4.0, every_s=0.5, odometry=odometry):
        assert estimate.verdict is not Verdict.INFEASIBLE
        assert not estimate.forgotten
        assert robot.holding(estimate)


@pytest.mark.parametrize('odometry', [(), None])
def test_stamps_that_are_more_wrong_than_is_stated_are_noticed(odometry):
    """Late readings look new where the clock is ahead by as much."""
    robot = driving(0.2, 0.2, stamp_error_s=0.01)
    answers = robot.drive(4.0, every_s=0.5, odometry=odometry)
    assert not all(robot.holding(estimate) for estimate in answers)


def turning(**settings):
    """Return a localizer of a robot that turns on the spot among anchors, with a camera."""
    return new_localizer(
        ('r',),
        anchors=ANCHORS_M,
        range_error=(-1e-3, 1e-3, 0.0, 0.0),
        bearing_half_width_rad=0.005,
        max_speed_m_s=0.0,
        max_turn_rate_rad_s=1.01,
        memory_s=0.0,
        **settings,
    )


@pytest.mark.parametrize('with_odometry', [False, True])
@pytest.mark.parametrize('ahead_s', [-0.05, 0.05])
def test_a_ray_with_the_stamp_of_the_answer_may_be_of_another_time(ahead_s, with_odometry):
    localizer = turning(stamp_error_s=0.05)
    measured_s, stamp_s, now_s = 100.0, 100.0 + ahead_s, 100.05
    if with_odometry:
        add_odometry(localizer, 'r', (0.0, 0.0), stamp_s, measured_s, now_s)
    add_ranges(localizer, 'r', (3.0, 3.0), ANCHORS_M, stamp_s, now_s=now_s)
    for name, anchor_m in ANCHORS_M.items():
        seen = ray((3.0, 3.0), anchor_m, measured_s)
        assert localizer.add_bearing('r', name, seen, stamp_s, now_s) is None
    (placement,) = localizer.step(stamp_s).placements
    off_rad = math.remainder(yaw_of(placement.orientations_xyzw[0]) - stamp_s, math.tau)
    assert abs(off_rad) <= placement.heading_half_width_rad[0] < 0.15


def test_where_clocks_are_right_nothing_is_widened():
    widths_m = []
    for robot in (driving(), driving(stamp_error_s=0.02)):
        *_, estimate = robot.drive(4.0)
        widths_m.append(np.ptp(estimate.placements[0].enclosure_m[0], axis=0))
    assert np.all(widths_m[0] < 0.1)
    assert np.all(widths_m[0] < widths_m[1]) and np.all(widths_m[1] < 0.5)
