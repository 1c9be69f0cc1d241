# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Outward rounding against exact rationals."""

from fractions import Fraction
import math

from hypothesis import example, given, settings, strategies as st
import pytest

from dg_localization.interval import rounding

ANY = st.floats(allow_nan=False, allow_infinity=False)
MODERATE = st.floats(-1e150, 1e150)
LAWS = settings(derandomize=True, deadline=None, max_examples=500)


def ulps_between(x, y):
    """Return how many units in the last place of the larger number two numbers are apart."""
    unit = math.ulp(max(abs(x), abs(y)))
    return abs(Fraction(x) - Fraction(y)) / Fraction(unit)


@LAWS
@given(ANY)
@example(0.0)
@example(-0.0)
@example(5e-324)
@example(-5e-324)
@example(2.2250738585072014e-308)
@example(1.0)
@example(math.nextafter(1.0, 0.0))
@example(-1.7976931348623157e308)
def test_up_and_down_move_by_one_or_two_units(x):
    higher, lower = rounding.up(x), rounding.down(x)
    assert higher >= math.nextafter(x, math.inf)
    assert lower <= math.nextafter(x, -math.inf)
    for moved in (higher, lower):
        assert math.isinf(moved) or ulps_between(x, moved) <= 2
    assert lower == -rounding.up(-x)


@pytest.mark.parametrize('scale', [2.0**-300, 2.0**-40, 2.0**77, 2.0**300])
@pytest.mark.parametrize('x', [1.0, 1.5, math.pi, -2.7, 1e12, 1e-12])
def test_steps_scale_with_powers_of_two(x, scale):
    assert rounding.up(x * scale) == rounding.up(x) * scale
    assert rounding.down(x * scale) == rounding.down(x) * scale


def test_the_infinities_stay_bounds():
    assert rounding.up(math.inf) == math.inf
    assert rounding.down(-math.inf) == -math.inf
    assert rounding.square_up(math.inf) == rounding.sqrt_up(math.inf) == math.inf


def test_an_overflow_is_a_bound_on_the_near_side():
    largest = math.nextafter(math.inf, 0.0)
    assert rounding.LARGEST == largest
    assert rounding.down(math.inf) == rounding.square_down(1e200) == rounding.down(largest)
    assert rounding.up(-math.inf) == -rounding.down(math.inf)


@LAWS
@given(MODERATE, MODERATE)
def test_one_operation_rounded_outward_holds_the_exact_result(x, y):
    a, b = Fraction(x), Fraction(y)
    results = [(x + y, a + b), (x - y, a - b), (x * y, a * b)]
    if abs(y) > 1e-150:
        results.append((x / y, a / b))
    for computed, exact in results:
        assert rounding.down(computed) <= exact <= rounding.up(computed)


@LAWS
@given(st.floats(-1e154, 1e154))
@example(0.0)
@example(1e-170)
def test_squares(x):
    exact = Fraction(x) ** 2
    low, high = rounding.square_down(x), rounding.square_up(x)
    assert 0 <= low <= exact <= high
    assert ulps_between(low, high) <= 5


@LAWS
@given(st.floats(0.0, allow_infinity=False))
@example(0.0)
@example(5e-324)
@example(1.7976931348623157e308)
def test_roots(x):
    low, high = rounding.sqrt_down(x), rounding.sqrt_up(x)
    assert 0 <= Fraction(low) ** 2 <= Fraction(x) <= Fraction(high) ** 2
    assert ulps_between(low, high) <= 5


def test_roots_of_what_is_not_positive_are_zero():
    assert rounding.sqrt_up(-4.0) == rounding.sqrt_down(-4.0) == rounding.sqrt_up(0.0) == 0.0
