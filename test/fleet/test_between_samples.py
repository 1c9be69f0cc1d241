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
    error = OdometryErrorModel(latency_s=0.1, max_gap_s=math.inf)
    limits = MotionLimits(1000.0, 10.0)
    past = level_path(stamps_s, places_m, error, limits).past_poses([1.0], 4.05)
    farthest_m = np.array([1.5, height_m])
    lower_m, upper_m = past.position_m.lower[0, :2], past.position_m.upper[0, :2]
    assert (lower_m <= farthest_m).all() and (farthest_m <= upper_m).all()


def test_between_two_samples_the_errors_of_the_step_count():
    """A robot that turns on the spot, as its odometry says, goes and turns by its errors."""
    error = OdometryErrorModel(translation_per_rad=0.1, rotation_per_rad=0.5, max_gap_s=math.inf)
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


def circle_with_a_gap(error, limits):
    """Return a path that is seen before and after a whole turn on a circle of radius 1 m only."""
    stamps_s, circumference_m = [0.0, 0.5, 4.5, 5.0], 2.0 * math.pi
    places_m = [[-0.5, 0.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    assert limits.speed_m_s * 4.0 >= circumference_m
    return level_path(stamps_s, places_m, error, limits)


def test_where_samples_are_missing_the_robot_may_be_as_far_as_its_limits_allow():
    path = circle_with_a_gap(OdometryErrorModel(), MotionLimits(1.6, 1.6))
    past = path.past_poses([0.0, 0.5, 2.5, 4.5], 5.0)
    opposite_m = np.array([-0.5, 2.0])
    assert np.all(past.position_m.lower[2, :2] <= opposite_m)
    assert np.all(opposite_m <= past.position_m.upper[2, :2])
    assert past.yaw_rad.upper[2] - past.yaw_rad.lower[2] >= 2.0 * math.pi
    # Where it was seen it is known, as this odometry does not err.
    widths_m = past.position_m.upper - past.position_m.lower
    assert np.all(widths_m[[0, 1, 3]] < 1e-6)
