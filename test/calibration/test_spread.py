# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What readings tell of their errors without a truth: the scatter, never the bias."""

import numpy as np
import pytest

from dg_localization.calibration.spread import (
    direction_differences,
    residuals,
    triangle_contradictions,
)

STAMPS = np.arange(0.0, 30.0, 0.1)


def test_a_steady_motion_and_a_bias_leave_no_residual():
    found = residuals(STAMPS, 5.0 + 0.3 * STAMPS)
    assert np.isnan(found[:2]).all() and np.isnan(found[-2:]).all()
    np.testing.assert_allclose(found[2:-2], 0.0, atol=1e-9)


def test_the_scatter_is_found_whatever_the_bias():
    rng = np.random.default_rng(0)
    noise = rng.uniform(-0.1, 0.1, len(STAMPS))
    motion = 5.0 + np.sin(0.2 * STAMPS)
    first = residuals(STAMPS, motion + noise)
    np.testing.assert_allclose(residuals(STAMPS, motion + noise + 0.7), first, atol=1e-9)
    known = np.isfinite(first)
    # The median of neighbors scatters, too.
    assert 0.1 <= np.abs(first[known]).max() <= 0.2
    assert np.std(first[known]) == pytest.approx(np.std(noise), rel=0.35)


def test_one_jump_stands_out_and_leaves_its_neighbors_alone():
    readings = np.full(len(STAMPS), 4.0)
    readings[100] = 9.0
    found = residuals(STAMPS, readings)
    assert found[100] == 5.0
    assert np.nanmax(np.abs(np.delete(found, 100))) == 0.0


def test_lonely_readings_tell_nothing():
    assert np.isnan(residuals(np.arange(10.0), np.zeros(10))).all()


def test_directions_differ_by_their_biases():
    back = STAMPS + 0.03
    there = 5.0 + 0.1 * STAMPS + 0.25
    gaps = direction_differences(STAMPS, there, back, 5.0 + 0.1 * back)
    np.testing.assert_allclose(gaps, 0.25, atol=1e-9)
    assert len(gaps) == len(STAMPS) - 1
    assert len(direction_differences(STAMPS, there, back[::20], back[::20])) == 0


def test_sides_that_make_no_triangle_are_counted():
    stamps = np.arange(10) * 0.5
    sides = np.array([[3.0] * 10, [4.0] * 10, [5.0] * 10])
    sides[2, 3] = 9.0
    apart = [stamps, stamps + 0.05, stamps[:-1] + 0.02]
    lower, upper = [*(sides[:2] - 0.1), sides[2, :-1] - 0.1], [*(sides[:2] + 0.1), sides[2, :-1]]
    assert triangle_contradictions(apart, lower, upper, 0.0) == (1, 9)
    # What the points may have moved in 0.05 s closes a gap of 1.7 m.
    assert triangle_contradictions(apart, lower, upper, 30.0) == (0, 9)
    # So do clocks that may differ by so much.
    assert triangle_contradictions(apart, lower, upper, 15.0) == (1, 9)
    assert triangle_contradictions(apart, lower, upper, 15.0, between_stamps_s=0.05) == (0, 9)
    assert triangle_contradictions([stamps, stamps + 9.0, stamps], sides, sides, 0.0) == (0, 0)


def test_one_reading_of_a_side_is_enough():
    one = np.array([1.0])
    found = triangle_contradictions([one, one, one], [one, one, 3 * one], [one, one, 3 * one], 0.0)
    assert found == (1, 1)


def test_angles_are_compared_the_short_way_round():
    rng = np.random.default_rng(0)
    turned_rad = 3.0 + 0.5 * STAMPS + rng.uniform(-0.02, 0.02, len(STAMPS))
    found = residuals(STAMPS, np.remainder(turned_rad, 2.0 * np.pi), angles=True)
    np.testing.assert_allclose(found, residuals(STAMPS, turned_rad), atol=1e-9)


def test_misread_angles_leave_all_others_alone():
    """Two in a row, nearly a turn apart: the way from one to the other is the short one."""
    misread = np.zeros(len(STAMPS))
    misread[100:102] = 1.8, -1.8
    found = residuals(STAMPS, misread, angles=True)
    np.testing.assert_allclose(found[100:102], [1.8, -1.8])
    assert np.nanmax(np.abs(np.delete(found, [100, 101]))) < 1e-9
