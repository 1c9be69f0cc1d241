# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds that are learned of ranges and odometry hold; the truth between samples."""

from itertools import repeat
import math

import numpy as np
import pytest
from shapes import turn

from dg_localization.calibration import bounds
from dg_localization.calibration.odometry import fit_odometry, odometry_windows
from dg_localization.calibration.truth import TrueTrack, ray_errors_rad
from dg_localization.fleet import OdometryErrorModel
from dg_localization.fleet.error_models import distance_bounds_m, likeliest_distance_m
from dg_localization.fleet.rotations import (
    quaternion_of_euler,
    quaternion_of_yaw,
    rotations_about_z,
)

EXACT = bounds.Choice(keep=1.0, margin=0.0)


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
    terms = fit.constant_m, fit.translation_per_m, fit.constant_rad, fit.rotation_per_rad
    return max(terms) <= 1e-4 and fit.translation_scale == 1.0


@pytest.mark.parametrize('scale', [-1.0, 1000.0, 0.001])
def test_a_scale_that_may_not_be_stated_is_not_learned(scale):
    """With another unit, or a reversed axis, the errors are as large as the way."""
    stamps, places, yaws = planar_drive()
    truth = TrueTrack(stamps, places, quaternions(yaws))
    windows = odometry_windows(stamps, places / scale, rotations_about_z(yaws), truth)
    fit = fit_odometry(windows, EXACT)
    assert fit.translation_scale == 1.0
    assert fit.translation_per_m + fit.constant_m > 0.9


@pytest.mark.parametrize(
    ('height_m', 'tilt_rad'), [(0.3, 0.0), (np.nan, 0.0), (0.0, 0.1), (0.0, 0.3)]
)
def test_in_the_plane_heights_and_tilt_of_the_truth_are_no_errors(height_m, tilt_rad):
    """Markers may be mounted askew, and a robot may be on a ramp."""
    stamps, places, yaws = planar_drive()
    true = places + np.column_stack([0.0 * stamps, 0.0 * stamps, height_m * np.sin(stamps)])
    turns = [quaternion_of_euler(0.0, tilt_rad, yaw) for yaw in yaws]
    truth = TrueTrack(stamps, true, turns)
    windows = odometry_windows(stamps, places, rotations_about_z(yaws), truth, dimension=2)
    assert len(windows.seconds) > 400
    assert exact(fit_odometry(windows, EXACT))
    in_space = odometry_windows(stamps, places, rotations_about_z(yaws), truth, 3, upright=False)
    assert not tilt_rad or fit_odometry(in_space, EXACT).translation_per_m > 0.05


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
    true = np.column_stack([np.interp(known, paused, column) for column in places.T])
    truth = TrueTrack(known, true, quaternions(np.interp(known, paused, yaws)))
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


def test_headings_turn_the_short_way_whatever_the_sign_of_the_quaternions():
    turns = quaternions([3.0, 3.2]) * [[1.0], [-1.0]]
    rotation = TrueTrack([0.0, 0.1], np.zeros((2, 3)), turns).rotations_at([0.05])[0]
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
    track = TrueTrack(stamps, np.arange(9.0).reshape(3, 3), quaternions([0.1, 0.2, 0.3]))
    np.testing.assert_array_equal(track.positions_at(stamps + off_s), np.arange(9.0).reshape(3, 3))
    assert np.isfinite(track.rotations_at(stamps + off_s)).all()
    alone = TrueTrack([start_s], [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(alone.positions_at([start_s + off_s]), [[1.0, 2.0, 3.0]])
    assert np.isnan(alone.positions_at([start_s - 1e-3, start_s + 1e-3])).all()
    assert np.isnan(track.positions_at(stamps[[0, -1]] + [-1e-5, 1e-5])).all()


@pytest.mark.parametrize('height_m', [1.2, math.nan])
def test_in_the_plane_heights_and_tilt_of_the_truth_are_no_errors_of_rays(height_m):
    """A camera that is exact in the plane, on a body that the truth tells is tilted."""
    robot = TrueTrack([0.0, 1.0], [[0.0, 0.0, 0.2]] * 2, [quaternion_of_euler(0.0, 0.1, 0.3)] * 2)
    target = TrueTrack([0.0, 1.0], [[2.0, 2.0, height_m]] * 2)
    azimuth = 0.25 * math.pi - 0.3
    ray = [[math.cos(azimuth), math.sin(azimuth), 0.0]]
    assert ray_errors_rad(robot, target, [0.5], ray, 2) == pytest.approx([0.0], abs=1e-12)


def test_a_sensor_is_nowhere_while_the_heading_of_its_robot_is_not_known():
    without_yaw = TrueTrack([0.0, 1.0], np.zeros((2, 3))).carrying((0.3, 0.2))
    assert np.isnan(without_yaw.positions_at([0.5])).all()


@pytest.mark.parametrize('keep', [0.5, 0.9, 0.95, 0.999, 1.0])
def test_the_band_holds_its_share_and_none_shorter_does(keep):
    rng = np.random.default_rng(3)
    values = rng.gamma(2.0, 0.2, 400)
    low, high = bounds.shortest_band(values, keep)
    held = np.count_nonzero((low <= values) & (values <= high))
    assert held >= keep * 400
    ordered, kept = np.sort(values), bounds.n_kept(400, keep)
    assert high - low <= (ordered[kept - 1 :] - ordered[: 400 - kept + 1]).min()


@pytest.mark.parametrize(
    'shape', [bounds.ErrorShape(), bounds.ErrorShape(relative=True), bounds.ErrorShape(slope=0.01)]
)
@pytest.mark.parametrize('keep', [0.9, 0.99, 1.0])
def test_the_node_holds_the_truth_of_as_many_readings_as_asked(shape, keep):
    rng = np.random.default_rng(5)
    truth = rng.uniform(1.0, 20.0, 1000)
    readings = truth + rng.gamma(2.0, 0.1, 1000) - 0.05
    model = bounds.fit_range(readings, readings - truth, bounds.Choice(keep, 0.0), shape)
    pairs = zip(readings.tolist(), truth.tolist(), strict=True)
    excluded = sum(not bounds.range_holds(model, reading, true) for reading, true in pairs)
    assert excluded <= 1000 - bounds.n_kept(1000, keep)
    held = [distance_bounds_m(model, reading) for reading in readings]
    inside = [low <= true <= high for (low, high), true in zip(held, truth, strict=True)]
    assert inside.count(False) == excluded


def test_radios_that_read_a_share_too_long_have_bounds_with_a_slope():
    rng = np.random.default_rng(2)
    truth = rng.uniform(2.0, 60.0, 500)
    readings = (truth + 0.08 + rng.uniform(-0.3, 0.3, 500)) / (1.0 - 0.0666)
    shape = bounds.shape_of(readings, readings - truth, EXACT)
    assert not shape.relative and shape.slope == pytest.approx(0.0666, abs=1e-3)
    model = bounds.fit_range(readings, readings - truth, EXACT, shape)
    assert all(map(bounds.range_holds, repeat(model), readings.tolist(), truth.tolist()))
    assert model.max_error_m - model.min_error_m < 0.65
    off_m = [likeliest_distance_m(model, reading) for reading in readings] - truth
    assert abs(np.median(off_m)) < 0.01 and np.abs(off_m).max() < 0.4


def test_a_scatter_as_wide_as_the_bounds_needs_none_wider():
    scatter = np.linspace(-0.1, 0.3, 41)
    assert bounds.missing_m(scatter, np.full(41, 0.2), EXACT) == (pytest.approx(0.0, abs=1e-9), 0)
    assert bounds.missing_m(scatter, np.full(41, 0.15), EXACT) == (pytest.approx(0.05), 0)
    wider_m, _ = bounds.missing_m(scatter, np.full(41, 0.2), bounds.Choice(1.0, 0.1))
    assert wider_m == pytest.approx(0.04)


def test_each_reading_is_held_by_bounds_as_wide_as_its_own():
    """The wide bounds of far readings do not count for near ones."""
    scatter, halves = np.array([-0.2, 0.2] * 20), np.array([0.03, 0.03] + [0.6] * 38)
    assert bounds.missing_m(scatter, halves, EXACT) == (pytest.approx(0.17), 0)
    # Errors that grow with the range need no more than bounds that do.
    assert bounds.missing_m(0.9 * halves * np.array([-1.0, 1.0] * 20), halves, EXACT)[0] == 0.0


def test_readings_that_no_bias_brings_between_the_bounds_are_counted():
    scatter, halves = np.append(np.zeros(99), 0.9), np.full(100, 0.5)
    choice = bounds.Choice(0.99, 0.0)
    assert bounds.missing_m(scatter, halves, choice) == (0.0, 0)
    assert bounds.missing_m(scatter + np.append(np.zeros(99), 0.2), halves, choice) == (0.0, 1)


def test_no_half_width_is_more_than_half_a_turn():
    assert bounds.fit_half_width_rad([3.1], bounds.Choice(1.0, 1.0)) == math.pi


STAMPS = np.arange(0.0, 30.0, 0.1)


def test_a_steady_motion_and_a_bias_leave_no_residual():
    found = bounds.residuals(STAMPS, 5.0 + 0.3 * STAMPS)
    assert np.isnan(found[:2]).all() and np.isnan(found[-2:]).all()
    np.testing.assert_allclose(found[2:-2], 0.0, atol=1e-9)


def test_lonely_readings_tell_nothing():
    assert np.isnan(bounds.residuals(np.arange(10.0), np.zeros(10))).all()


def test_angles_are_compared_the_short_way_round():
    rng = np.random.default_rng(0)
    turned_rad = 3.0 + 0.5 * STAMPS + rng.uniform(-0.02, 0.02, len(STAMPS))
    found = bounds.residuals(STAMPS, np.remainder(turned_rad, 2.0 * np.pi), angles=True)
    np.testing.assert_allclose(found, bounds.residuals(STAMPS, turned_rad), atol=1e-9)
