# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Learned bounds hold the share of the errors that was asked for, and are no wider than that."""

from itertools import repeat
import math

import numpy as np
import pytest

from dg_localization.calibration.bounds import (
    Choice,
    ErrorShape,
    fit_half_width_rad,
    fit_range,
    missing_m,
    n_kept,
    range_holds,
    residuals,
    shape_of,
    shortest_band,
)
from dg_localization.fleet.error_models import distance_bounds_m, likeliest_distance_m

EXACT = Choice(keep=1.0, margin=0.0)


@pytest.mark.parametrize('keep', [0.5, 0.9, 0.95, 0.999, 1.0])
def test_the_band_holds_its_share_and_none_shorter_does(keep):
    rng = np.random.default_rng(3)
    values = rng.gamma(2.0, 0.2, 400)
    low, high = shortest_band(values, keep)
    held = np.count_nonzero((low <= values) & (values <= high))
    assert held >= keep * 400
    ordered, kept = np.sort(values), n_kept(400, keep)
    assert high - low <= (ordered[kept - 1 :] - ordered[: 400 - kept + 1]).min()


@pytest.mark.parametrize(
    'shape', [ErrorShape(), ErrorShape(relative=True), ErrorShape(slope=0.01)]
)
@pytest.mark.parametrize('keep', [0.9, 0.99, 1.0])
def test_the_node_holds_the_truth_of_as_many_readings_as_asked(shape, keep):
    rng = np.random.default_rng(5)
    truth = rng.uniform(1.0, 20.0, 1000)
    readings = truth + rng.gamma(2.0, 0.1, 1000) - 0.05
    model = fit_range(readings, readings - truth, Choice(keep, 0.0), shape)
    pairs = zip(readings.tolist(), truth.tolist(), strict=True)
    excluded = sum(not range_holds(model, reading, true) for reading, true in pairs)
    assert excluded <= 1000 - n_kept(1000, keep)
    bounds = [distance_bounds_m(model, reading) for reading in readings]
    inside = [low <= true <= high for (low, high), true in zip(bounds, truth, strict=True)]
    assert inside.count(False) == excluded


def test_radios_that_read_a_share_too_long_have_bounds_with_a_slope():
    rng = np.random.default_rng(2)
    truth = rng.uniform(2.0, 60.0, 500)
    readings = (truth + 0.08 + rng.uniform(-0.3, 0.3, 500)) / (1.0 - 0.0666)
    shape = shape_of(readings, readings - truth, EXACT)
    assert not shape.relative and shape.slope == pytest.approx(0.0666, abs=1e-3)
    model = fit_range(readings, readings - truth, EXACT, shape)
    assert all(map(range_holds, repeat(model), readings.tolist(), truth.tolist()))
    assert model.max_error_m - model.min_error_m < 0.65
    off_m = [likeliest_distance_m(model, reading) for reading in readings] - truth
    assert abs(np.median(off_m)) < 0.01 and np.abs(off_m).max() < 0.4


def test_a_scatter_as_wide_as_the_bounds_needs_none_wider():
    scatter = np.linspace(-0.1, 0.3, 41)
    assert missing_m(scatter, np.full(41, 0.2), EXACT) == (pytest.approx(0.0, abs=1e-9), 0)
    assert missing_m(scatter, np.full(41, 0.15), EXACT) == (pytest.approx(0.05), 0)
    assert missing_m(scatter, np.full(41, 0.2), Choice(1.0, 0.1))[0] == pytest.approx(0.04)


def test_each_reading_is_held_by_bounds_as_wide_as_its_own():
    """The wide bounds of far readings do not count for near ones."""
    scatter, halves = np.array([-0.2, 0.2] * 20), np.array([0.03, 0.03] + [0.6] * 38)
    assert missing_m(scatter, halves, EXACT) == (pytest.approx(0.17), 0)
    # Errors that grow with the range need no more than bounds that do.
    assert missing_m(0.9 * halves * np.array([-1.0, 1.0] * 20), halves, EXACT)[0] == 0.0


def test_readings_that_no_bias_brings_between_the_bounds_are_counted():
    scatter, halves = np.append(np.zeros(99), 0.9), np.full(100, 0.5)
    choice = Choice(0.99, 0.0)
    assert missing_m(scatter, halves, choice) == (0.0, 0)
    assert missing_m(scatter + np.append(np.zeros(99), 0.2), halves, choice) == (0.0, 1)


def test_no_half_width_is_more_than_half_a_turn():
    assert fit_half_width_rad([3.1], Choice(1.0, 1.0)) == math.pi


STAMPS = np.arange(0.0, 30.0, 0.1)


def test_a_steady_motion_and_a_bias_leave_no_residual():
    found = residuals(STAMPS, 5.0 + 0.3 * STAMPS)
    assert np.isnan(found[:2]).all() and np.isnan(found[-2:]).all()
    np.testing.assert_allclose(found[2:-2], 0.0, atol=1e-9)


def test_lonely_readings_tell_nothing():
    assert np.isnan(residuals(np.arange(10.0), np.zeros(10))).all()


def test_angles_are_compared_the_short_way_round():
    rng = np.random.default_rng(0)
    turned_rad = 3.0 + 0.5 * STAMPS + rng.uniform(-0.02, 0.02, len(STAMPS))
    found = residuals(STAMPS, np.remainder(turned_rad, 2.0 * np.pi), angles=True)
    np.testing.assert_allclose(found, residuals(STAMPS, turned_rad), atol=1e-9)
