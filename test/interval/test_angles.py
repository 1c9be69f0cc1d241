# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Sines, cosines and angles, of arrays and in kernels, against evaluation in many digits."""

import math

from hypothesis import example, given, strategies as st
import mpmath
import pytest

from dg_localization.interval import angles
from dg_localization.interval.arrays import Interval

FRACTIONS = st.floats(0.0, 1.0)
HALF_TURN = st.floats(-math.pi, math.pi)
EXACT = {'cosine': mpmath.cos, 'sine': mpmath.sin}


def between(low, high, fraction):
    return min(max(low + fraction * (high - low), low), high)


def holds(name, ends, fraction, bounds, excess):
    """Check that bounds hold a value between two angles, and exceed their range by little."""
    low, high = bounds
    with mpmath.workprec(200):
        value = EXACT[name](mpmath.mpf(between(*ends, fraction)))
        assert -1.0 <= low <= value <= high <= 1.0
        extremes = [EXACT[name](mpmath.mpf(end)) for end in ends]
        quarters = [k * mpmath.pi / 2 for k in range(-9, 10)]
        extremes += [EXACT[name](x) for x in quarters if ends[0] < x < ends[1]]
        assert low >= min(extremes) - excess and high <= max(extremes) + excess


def ends_of(name, low_rad, high_rad):
    """Return the bounds of a function of one angle between two others."""
    found = getattr(angles, name)(Interval.between(low_rad, high_rad))
    return float(found.lower), float(found.upper)


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@given(
    low_rad=st.floats(-angles.LARGEST_ANGLE_RAD, angles.LARGEST_ANGLE_RAD),
    width_rad=st.floats(0.0, 7.0),
    fraction=FRACTIONS,
)
@example(low_rad=0.0, width_rad=math.pi, fraction=1.0)
@example(low_rad=-math.pi, width_rad=0.0, fraction=0.0)
@example(low_rad=math.pi / 2, width_rad=math.pi, fraction=1.0)
@example(low_rad=2.0 * math.pi, width_rad=1e-16, fraction=0.0)
def test_sines_and_cosines_of_arrays(name, low_rad, width_rad, fraction):
    ends = low_rad, min(low_rad + width_rad, angles.LARGEST_ANGLE_RAD)
    # A sine is the cosine of an angle that is a quarter turn less.
    excess = 1e-13 if max(map(abs, ends)) < 10.0 else 2.0
    holds(name, ends, fraction, ends_of(name, *ends), excess)


@pytest.mark.parametrize('angle_rad', [15.0, -1e9, math.inf, -math.inf])
def test_angles_that_went_round_too_often_bound_nothing(angle_rad):
    for name in EXACT:
        assert ends_of(name, angle_rad, angle_rad) == (-1.0, 1.0)


@given(FRACTIONS, st.floats(0.0, math.pi))
@example(1.0, 0.0)
@example(1e-300, 0.0)
def test_arcsines_and_chords(x, angle_rad):
    with mpmath.workprec(200):
        exact_rad = mpmath.asin(mpmath.mpf(x))
        assert exact_rad <= angles.arcsine_up(x) <= exact_rad + 2e-14
        exact = 2 * mpmath.sin(mpmath.mpf(angle_rad) / 2)
        assert exact <= angles.chord_up(angle_rad) <= exact + 1e-13
    assert math.pi / 2 < angles.arcsine_up(1.5) < math.pi / 2 + 1e-13


@given(HALF_TURN, HALF_TURN)
def test_a_computed_angle_lies_between_its_bounds(yaw_rad, other_rad):
    computed_rad = math.atan2(math.sin(yaw_rad), math.cos(yaw_rad)) + other_rad
    with mpmath.workprec(200):
        exact_rad = mpmath.mpf(yaw_rad) + mpmath.mpf(other_rad)
    assert angles.angle_down(computed_rad) <= exact_rad <= angles.angle_up(computed_rad)


@given(st.floats(-12.0, 12.0), st.floats(0.0, 4.0), st.floats(-1.0, 1.0))
def test_rotations_hold_every_matrix_within_the_half_width(angle_rad, half_width_rad, fraction):
    matrix = angles.rotation_2d(angle_rad, half_width_rad)
    with mpmath.workprec(200):
        inside_rad = mpmath.mpf(angle_rad) + mpmath.mpf(fraction) * mpmath.mpf(half_width_rad)
        x, y = mpmath.cos(inside_rad), mpmath.sin(inside_rad)
        for row, column, value in ((0, 0, x), (0, 1, -y), (1, 0, y), (1, 1, x)):
            assert matrix.lower[row, column] <= value <= matrix.upper[row, column]
