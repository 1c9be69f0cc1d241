# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds that are learned from odometry and a truth hold, and are near the true bounds."""

import numpy as np
import pytest
from shapes import turn

from dg_localization.calibration.bounds import Choice
from dg_localization.calibration.odometry import fit_odometry, odometry_windows
from dg_localization.calibration.truth import TrueTrack
from dg_localization.fleet import OdometryErrorModel
from dg_localization.fleet.rotations import (
    quaternion_of_euler,
    quaternion_of_yaw,
    rotations_about_z,
)

EXACT = Choice(keep=1.0, margin=0.0)


def quaternions(yaws):
    return np.array([quaternion_of_yaw(yaw) for yaw in yaws])


def planar_drive():
    """Return stamps, places and yaws on a circle, with steps along the headings."""
    stamps = np.arange(0.0, 60.0, 0.1)
    yaws = 0.1 * stamps
    steps = 0.03 * np.column_stack([np.cos(yaws), np.sin(yaws), 0.0 * yaws])
    return stamps, np.cumsum(steps, axis=0) - steps, yaws


def exact(fit):
    """Return whether bounds are those of perfect odometry, but for rounding."""
    bounds = fit.constant_m, fit.translation_per_m, fit.constant_rad, fit.rotation_per_rad
    return max(bounds) <= 1e-4 and fit.translation_scale == 1.0


@pytest.mark.parametrize('scale', [-1.0, 1000.0, 0.001])
def test_a_scale_that_may_not_be_stated_is_not_learned(scale):
    """With another unit, or a reversed axis, the errors are as large as the way."""
    stamps, places, yaws = planar_drive()
    truth = TrueTrack(stamps, places, quaternions(yaws))
    windows = odometry_windows(stamps, places / scale, rotations_about_z(yaws), truth)
    fit = fit_odometry(windows, EXACT)
    assert fit.translation_scale == 1.0
    assert fit.translation_per_m + fit.constant_m > 0.9


@pytest.mark.parametrize('height_m', [0.3, np.nan])
def test_in_the_plane_heights_of_the_truth_are_no_errors(height_m):
    stamps, places, yaws = planar_drive()
    true = places + np.column_stack([0.0 * stamps, 0.0 * stamps, height_m * np.sin(stamps)])
    truth = TrueTrack(stamps, true, quaternions(yaws))
    windows = odometry_windows(stamps, places, rotations_about_z(yaws), truth, dimension=2)
    assert len(windows.seconds) > 400
    assert exact(fit_odometry(windows, EXACT))


@pytest.mark.parametrize('tilt_rad', [0.1, 0.3])
def test_in_the_plane_tilt_of_the_truth_is_no_error(tilt_rad):
    """Markers may be mounted askew, and a robot may be on a ramp."""
    stamps, places, yaws = planar_drive()
    turns = [quaternion_of_euler(0.0, tilt_rad, yaw) for yaw in yaws]
    truth = TrueTrack(stamps, places, turns)
    windows = odometry_windows(stamps, places, rotations_about_z(yaws), truth, dimension=2)
    assert exact(fit_odometry(windows, EXACT))
    in_space = odometry_windows(stamps, places, rotations_about_z(yaws), truth, 3, upright=False)
    assert fit_odometry(in_space, EXACT).translation_per_m > 0.05


@pytest.mark.parametrize('stamp_s', [0.0, 1e15])
def test_one_wrong_stamp_costs_no_memory_and_tells_nothing(stamp_s):
    stamps, places, yaws = planar_drive()
    stamps += 1.7e9
    turns = rotations_about_z(yaws)
    truth = TrueTrack(stamps, places, quaternions(yaws))
    order = [0, *range(len(stamps))] if stamp_s == 0.0 else [*range(len(stamps)), -1]
    mixed = np.sort([*stamps, stamp_s])
    windows = odometry_windows(mixed, places[order], turns[order], truth)
    assert len(windows.seconds) > 400
    assert windows.seconds.max() < 41.0
    assert exact(fit_odometry(windows, EXACT))


def test_a_pause_repeats_no_window_and_is_in_none():
    stamps, places, yaws = planar_drive()
    # The truth goes on while the odometry pauses for 10 min.
    paused = np.where(stamps < 30.0, stamps, stamps + 600.0)
    known = np.arange(0.0, 700.0, 0.5)
    truth = TrueTrack(
        known,
        np.column_stack([np.interp(known, paused, places[:, axis]) for axis in range(3)]),
        quaternions(np.interp(known, paused, yaws)),
    )
    windows = odometry_windows(paused, places, rotations_about_z(yaws), truth)
    spans = set(zip(windows.begin_s, windows.seconds, strict=True))
    assert len(windows.seconds) == len(spans) > 200
    ends_s = windows.begin_s + windows.seconds
    assert np.all((ends_s < 30.0) | (windows.begin_s > 600.0))


@pytest.mark.parametrize('upright', [True, False])
def test_in_space_turns_are_those_of_the_whole_body(upright):
    """A body that rolls: its odometry states the roll with an error of 0.1 rad."""
    stamps = np.arange(0.0, 10.0, 0.05)
    roll, still = 0.5 * np.sin(stamps), np.zeros((len(stamps), 3))
    truth = TrueTrack(stamps, still, [quaternion_of_euler(angle, 0.0, 0.0) for angle in roll])
    turns = np.array([turn(0, angle) for angle in roll + 0.1 * np.cos(7.0 * stamps)])
    windows = odometry_windows(stamps, still, turns, truth, dimension=3, upright=upright)
    # How far it rolls counts; where errors of roll are not stated otherwise, so do they.
    assert windows.turn_rad.max() > 1.0
    assert windows.error_rad.max() == pytest.approx(0.0 if upright else 0.2, abs=0.01)


STATED = OdometryErrorModel(0.1, 0.03, 0.02, 0.2, 0.05, 0.06, translation_scale=0.9)


def test_a_robot_that_stood_still_tells_nothing_better_than_what_is_stated():
    stamps = np.arange(0.0, 60.0, 0.1)
    still = np.zeros((len(stamps), 3))
    truth = TrueTrack(stamps, still, quaternions(np.zeros(len(stamps))))
    windows = odometry_windows(stamps, still, rotations_about_z(np.zeros(len(stamps))), truth)
    assert not windows.tell_ways and not windows.tell_turns
    assert fit_odometry(windows, EXACT, STATED) == STATED
