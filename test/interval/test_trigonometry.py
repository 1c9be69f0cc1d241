# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Angles in kernels against evaluation in many digits."""

import math

from hypothesis import example, given, settings, strategies as st
import mpmath
import pytest

from dg_localization.interval import trigonometry
from dg_localization.interval.angles import ANGLE_ROUNDING

LAWS = settings(derandomize=True, deadline=None, max_examples=300)
ANGLES_RAD = st.floats(-math.pi, math.pi)
FRACTIONS = st.floats(0.0, 1.0)
COORDINATES = st.floats(-1e100, 1e100)


def between(low, high, fraction):
    return min(max(low + fraction * (high - low), low), high)


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@LAWS
@given(ends=st.tuples(ANGLES_RAD, ANGLES_RAD), fraction=FRACTIONS)
@example(ends=(-math.pi, math.pi), fraction=0.75)
@example(ends=(0.5 * math.pi, 0.5 * math.pi), fraction=0.0)
@example(ends=(-1e-9, 1e-9), fraction=1.0)
def test_every_value_between_the_ends_is_bounded(name, ends, fraction):
    low_rad, high_rad = sorted(ends)
    low, high = getattr(trigonometry, name)(low_rad, high_rad)
    function = {'cosine': mpmath.cos, 'sine': mpmath.sin}[name]
    with mpmath.workprec(200):
        value = function(mpmath.mpf(between(low_rad, high_rad, fraction)))
        assert -1.0 <= low <= value <= high <= 1.0
        ends = [function(mpmath.mpf(x)) for x in (low_rad, high_rad)]
        quarters = [k * mpmath.pi / 2 for k in range(-2, 3)]
        ends += [function(x) for x in quarters if low_rad < x < high_rad]
        assert low >= min(ends) - 3.0 * ANGLE_ROUNDING
        assert high <= max(ends) + 3.0 * ANGLE_ROUNDING


def test_the_cosine_of_a_tiny_angle_loses_nothing():
    assert trigonometry.cosine(-1e-14, 1e-14)[0] >= 1.0 - 2.0**-51


@pytest.mark.parametrize('name', ['cosine', 'sine'])
@pytest.mark.parametrize('ends', [(-4.0, 0.0), (0.0, 3.2), (-math.inf, math.inf)])
def test_angles_beyond_half_a_turn_bound_nothing(name, ends):
    assert getattr(trigonometry, name)(*ends) == (-1.0, 1.0)


@pytest.mark.parametrize('name', ['arccosine', 'arcsine'])
@LAWS
@given(ends=st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)), fraction=FRACTIONS)
@example(ends=(1.0, 1.0), fraction=0.0)
@example(ends=(-1.0, -1.0), fraction=0.0)
def test_inverse_functions_bound_every_angle(name, ends, fraction):
    low, high = sorted(ends)
    least_rad, most_rad = getattr(trigonometry, name)(low, high)
    function = {'arccosine': mpmath.acos, 'arcsine': mpmath.asin}[name]
    value = between(low, high, fraction)
    if abs(value) <= 1.0:
        with mpmath.workprec(200):
            assert least_rad <= function(mpmath.mpf(value)) <= most_rad


@LAWS
@given(a=st.tuples(COORDINATES, COORDINATES), b=st.tuples(COORDINATES, COORDINATES))
@example(a=(1.0, 0.0), b=(-1.0, 0.0))
@example(a=(1e-160, 0.0), b=(0.0, 1e-160))
@example(a=(0.0, 0.0), b=(1.0, 0.0))
@example(a=(1.0, 1.0 + 2.0**-52), b=(1.0, 1.0))
def test_the_angle_between_two_vectors_is_bounded(a, b):
    low_rad, high_rad = trigonometry.angle_between(*a, *b)
    with mpmath.workprec(2400):
        x, y, u, v = (mpmath.mpf(value) for value in (*a, *b))
        if (x, y) != (0, 0) and (u, v) != (0, 0):
            assert low_rad <= mpmath.atan2(x * v - y * u, x * u + y * v) <= high_rad
    assert high_rad - low_rad <= 3.0 * ANGLE_ROUNDING or math.isinf(high_rad)


@pytest.mark.parametrize('scale', [0.0, 1e-200, 1e200])
def test_vectors_whose_products_are_no_numbers_bound_nothing(scale):
    ends = trigonometry.angle_between(scale, scale, scale, -scale)
    assert ends == (-math.inf, math.inf)
