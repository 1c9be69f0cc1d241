# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What readings tell of their errors without a truth: the scatter, never the bias."""

import numpy as np
import pytest

from dg_localization.calibration.bounds import residuals

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


def test_lonely_readings_tell_nothing():
    assert np.isnan(residuals(np.arange(10.0), np.zeros(10))).all()


def test_angles_are_compared_the_short_way_round():
    rng = np.random.default_rng(0)
    turned_rad = 3.0 + 0.5 * STAMPS + rng.uniform(-0.02, 0.02, len(STAMPS))
    found = residuals(STAMPS, np.remainder(turned_rad, 2.0 * np.pi), angles=True)
    np.testing.assert_allclose(found, residuals(STAMPS, turned_rad), atol=1e-9)
