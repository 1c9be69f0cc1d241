# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where a robot may have been between two samples of its odometry."""

import math

import numpy as np

from dg_localization.fleet.odometry import MotionLimits, OdometryErrorModel, OdometryPath


def level_path(stamps_s, places_m, error, limits):
    rotations = np.tile(np.eye(3), (len(stamps_s), 1, 1))
    return OdometryPath(np.array(stamps_s), np.array(places_m), rotations, error, limits)


def test_a_late_stamp_leaves_all_that_lies_between_the_samples_around_it():
    """The robot is as far from two samples as these are apart, and farther from the nearest."""
    height_m = math.sqrt(0.75)
    stamps_s = [0.0, 0.93, 0.96, 1.0, 1.15, 4.0, 4.2]
    at_rest = [0.0, 0.0, 0.0]
    places_m = [at_rest, [1.0, 0.0, 0.0], [0.5, height_m, 0.0], at_rest, at_rest, at_rest, at_rest]
    error, limits = OdometryErrorModel(latency_s=0.1), MotionLimits(1000.0, 10.0)
    past = level_path(stamps_s, places_m, error, limits).past_poses([1.0], 4.05)
    farthest_m = np.array([1.5, height_m])
    lower_m, upper_m = past.position_m.lower[0, :2], past.position_m.upper[0, :2]
    assert (lower_m <= farthest_m).all() and (farthest_m <= upper_m).all()


def test_without_latency_the_robot_is_near_the_samples_around_a_time():
    places_m = [[0.1 * x, 0.0, 0.0] for x in range(5)]
    path = level_path(np.arange(5.0), places_m, OdometryErrorModel(), MotionLimits(1000.0, 10.0))
    past = path.past_poses([1.4], 4.0)
    width_m = past.position_m.upper[0, 0] - past.position_m.lower[0, 0]
    assert 0.2 <= width_m < 0.21


def test_equal_stamps_need_not_be_equal_times():
    """A stamp since 1970 is a double to the tenth of a microsecond: the robot moves meanwhile."""
    stamp_s, speed_m_s, later_s = 1.7e9, 10.0, 1.1e-7
    assert stamp_s + later_s == stamp_s
    stamps_s = [stamp_s - 1.0, stamp_s, stamp_s + 1.0]
    places_m = [[-speed_m_s, 0.0, 0.0], [0.0, 0.0, 0.0], [speed_m_s, 0.0, 0.0]]
    path = level_path(stamps_s, places_m, OdometryErrorModel(), MotionLimits(speed_m_s, 1.0))
    for time_s, now_s in ((stamp_s, stamp_s + 1.0), (stamp_s - 1.0, stamp_s)):
        position_m = path.past_poses([time_s], now_s).position_m
        true_m = -speed_m_s * (1.0 - later_s)
        assert position_m.lower[0, 0] <= true_m <= position_m.upper[0, 0]
        assert position_m.upper[0, 0] - position_m.lower[0, 0] < 1e-4


def test_between_two_samples_the_errors_of_the_step_count():
    """A robot that turns on the spot, as its odometry says, goes and turns by its errors."""
    error = OdometryErrorModel(translation_per_rad=0.1, rotation_per_rad=0.5)
    c, s = np.cos(0.2), np.sin(0.2)
    turned = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    path = OdometryPath([0.0, 1.0], np.zeros((2, 3)), np.array([np.eye(3), turned]), error)
    # It goes 0.02 m along x and turns by 0.3 rad, evenly.
    past = path.past_poses([0.6], 1.0)
    c, s = np.cos(0.3), np.sin(0.3)
    true_m = 0.4 * 0.0199 * np.array([-c, s])
    assert np.all(past.position_m.lower[0, :2] <= true_m)
    assert np.all(true_m <= past.position_m.upper[0, :2])
    assert past.yaw_rad.lower[0] <= -0.4 * 0.2999 <= past.yaw_rad.upper[0]
