# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Ranges of sines, cosines and angles against evaluation in many digits."""

import math

from hypothesis import example, given, settings, strategies as st
import mpmath
import numpy as np
import pytest

from dg_localization.interval import angles
from dg_localization.interval.arrays import Interval

LAWS = settings(derandomize=True, deadline=None, max_examples=300)
ANGLES_RAD = st.floats(-angles.LARGEST_ANGLE_RAD, angles.LARGEST_ANGLE_RAD)
FRACTIONS = st.floats(0.0, 1.0)


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@LAWS
@given(low_rad=ANGLES_RAD, width_rad=st.floats(0.0, 7.0), fraction=FRACTIONS)
@example(low_rad=0.0, width_rad=math.pi, fraction=1.0)
@example(low_rad=-math.pi, width_rad=0.0, fraction=0.0)
@example(low_rad=math.pi / 2, width_rad=math.pi, fraction=1.0)
@example(low_rad=2.0 * math.pi, width_rad=1e-16, fraction=0.0)
def test_every_value_between_the_ends_is_in_the_range(name, low_rad, width_rad, fraction):
    high_rad = min(low_rad + width_rad, angles.LARGEST_ANGLE_RAD)
    low, high = getattr(angles, f'{name}_bounds')(low_rad, high_rad)
    inside_rad = min(max(low_rad + fraction * (high_rad - low_rad), low_rad), high_rad)
    function = {'cosine': mpmath.cos, 'sine': mpmath.sin}[name]
    with mpmath.workprec(200):
        assert -1.0 <= low <= function(mpmath.mpf(inside_rad)) <= high <= 1.0


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@LAWS
@given(low_rad=st.floats(-6.0, 6.0), width_rad=st.floats(0.0, 6.0))
def test_ranges_are_tight(name, low_rad, width_rad):
    samples = getattr(math, name[:3])
    values = [samples(low_rad + k / 400 * width_rad) for k in range(401)]
    low, high = getattr(angles, f'{name}_bounds')(low_rad, low_rad + width_rad)
    # Between two samples the function leaves their range by the square of their distance only.
    missed = (width_rad / 400) ** 2 + 1e-13
    assert min(values) - missed <= low
    assert high <= max(values) + missed


@pytest.mark.parametrize('angle_rad', [15.0, -1e9, math.inf, -math.inf])
def test_angles_that_went_round_too_often_bound_nothing(angle_rad):
    assert angles.cosine_bounds(angle_rad, angle_rad) == (-1.0, 1.0)
    assert angles.sine_bounds(angle_rad, angle_rad) == (-1.0, 1.0)


def test_arrays_give_what_single_numbers_do():
    low_rad, high_rad = np.linspace(-4.0, 4.0, 20), np.linspace(-3.9, 6.0, 20)
    found = angles.cosine(Interval(low_rad, high_rad))
    singles = [angles.cosine_bounds(*ends) for ends in zip(low_rad, high_rad, strict=True)]
    assert np.array_equal(np.stack([found.lower, found.upper], axis=1), singles)


@LAWS
@given(st.floats(0.0, 1.0))
@example(1.0)
@example(1e-300)
def test_arcsines(x):
    with mpmath.workprec(200):
        exact_rad = mpmath.asin(mpmath.mpf(x))
        assert exact_rad <= angles.arcsine_up(x) <= exact_rad + 2e-14


def test_an_arcsine_beyond_one_is_a_right_angle():
    assert math.pi / 2 < angles.arcsine_up(1.5) < math.pi / 2 + 1e-13


@LAWS
@given(st.floats(0.0, math.pi))
def test_chords(angle_rad):
    with mpmath.workprec(200):
        exact = 2 * mpmath.sin(mpmath.mpf(angle_rad) / 2)
        assert exact <= angles.chord_up(angle_rad) <= exact + 1e-13


@LAWS
@given(st.floats(-math.pi, math.pi), st.floats(-math.pi, math.pi))
def test_a_computed_angle_lies_between_its_bounds(yaw_rad, other_rad):
    computed_rad = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad)) + other_rad
    with mpmath.workprec(200):
        exact_rad = mpmath.mpf(yaw_rad) + mpmath.mpf(other_rad)
    assert angles.angle_down(computed_rad) <= exact_rad <= angles.angle_up(computed_rad)


@LAWS
@given(ANGLES_RAD, st.floats(0.0, 4.0), st.floats(-1.0, 1.0))
def test_rotations_hold_every_matrix_within_the_half_width(angle_rad, half_width_rad, fraction):
    matrix = angles.rotation_2d(angle_rad, half_width_rad)
    with mpmath.workprec(200):
        inside_rad = mpmath.mpf(angle_rad) + mpmath.mpf(fraction) * mpmath.mpf(half_width_rad)
        x, y = mpmath.cos(inside_rad), mpmath.sin(inside_rad)
        for row, column, value in ((0, 0, x), (0, 1, -y), (1, 0, y), (1, 1, x)):
            assert matrix.lower[row, column] <= value <= matrix.upper[row, column]
