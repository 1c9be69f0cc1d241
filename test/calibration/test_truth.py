# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The truth between samples, and the errors of readings beside it."""

import math

import numpy as np
import pytest

from dg_localization.calibration.truth import TrueTrack, ray_errors_rad
from dg_localization.fleet.rotations import quaternion_of_euler, quaternion_of_yaw


def turned(yaws_rad):
    return np.array([quaternion_of_yaw(yaw_rad) for yaw_rad in yaws_rad])


def circle(stamps):
    angles = 0.5 * np.asarray(stamps)
    places = 2.0 * np.column_stack([np.cos(angles), np.sin(angles), 0.0 * angles])
    return places, angles + np.pi / 2.0


STAMPS = np.arange(0.0, 20.0, 0.05)


def test_places_and_headings_between_samples():
    places, yaws = circle(STAMPS)
    track = TrueTrack(STAMPS, places, turned(yaws))
    times = np.linspace(0.0, 19.9, 333)
    expected, headings = circle(times)
    np.testing.assert_allclose(track.positions_at(times), expected, atol=2e-4)
    forward = track.rotations_at(times)[:, :2, 0]
    np.testing.assert_allclose(
        forward, np.column_stack([np.cos(headings), np.sin(headings)]), atol=2e-4
    )


def test_headings_turn_the_short_way_whatever_the_sign_of_the_quaternions():
    quaternions = turned([3.0, 3.2]) * [[1.0], [-1.0]]
    rotation = TrueTrack([0.0, 0.1], np.zeros((2, 3)), quaternions).rotations_at([0.05])[0]
    assert math.atan2(rotation[1, 0], rotation[0, 0]) == pytest.approx(3.1)


@pytest.mark.parametrize('time', [-0.1, 1.5, 3.1])
def test_nothing_is_known_beyond_and_in_long_gaps(time):
    track = TrueTrack([0.0, 0.3, 1.2, 3.0], np.arange(12.0).reshape(4, 3))
    assert np.isnan(track.positions_at([time])).all()
    assert np.isfinite(track.positions_at([0.1])).all()


@pytest.mark.parametrize('start_s', [0.0, 1.7e9])
@pytest.mark.parametrize('off_s', [-5e-7, 5e-7])
def test_the_ends_are_known_to_a_stamp_that_is_rounded_otherwise(start_s, off_s):
    stamps = start_s + np.array([0.0, 0.5, 1.0])
    track = TrueTrack(stamps, np.arange(9.0).reshape(3, 3), turned([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(track.positions_at(stamps + off_s), np.arange(9.0).reshape(3, 3))
    assert np.isfinite(track.rotations_at(stamps + off_s)).all()
    alone = TrueTrack([start_s], [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(alone.positions_at([start_s + off_s]), [[1.0, 2.0, 3.0]])
    assert np.isnan(alone.positions_at([start_s - 1e-3, start_s + 1e-3])).all()
    assert np.isnan(track.positions_at(stamps[[0, -1]] + [-1e-5, 1e-5])).all()


def pitched(yaw_rad, pitch_rad):
    """Return the quaternion of a body that pitches after it has turned."""
    return quaternion_of_euler(0.0, pitch_rad, yaw_rad)


@pytest.mark.parametrize('height_m', [1.2, math.nan])
def test_in_the_plane_heights_and_tilt_of_the_truth_are_no_errors_of_rays(height_m):
    """A camera that is exact in the plane, on a body that the truth tells is tilted."""
    robot = TrueTrack([0.0, 1.0], [[0.0, 0.0, 0.2]] * 2, [pitched(0.3, 0.1)] * 2)
    target = TrueTrack([0.0, 1.0], [[2.0, 2.0, height_m]] * 2)
    azimuth = 0.25 * math.pi - 0.3
    ray = [[math.cos(azimuth), math.sin(azimuth), 0.0]]
    assert ray_errors_rad(robot, target, [0.5], ray, 2) == pytest.approx([0.0], abs=1e-12)


def test_a_sensor_is_nowhere_while_the_heading_of_its_robot_is_not_known():
    without_yaw = TrueTrack([0.0, 1.0], np.zeros((2, 3))).carrying((0.3, 0.2))
    assert np.isnan(without_yaw.positions_at([0.5])).all()
