# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bounds of plain numbers against exact rationals."""

from fractions import Fraction
import math

from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.interval import arrays, bounds, rounding

LAWS = settings(derandomize=True, deadline=None, max_examples=300)
FINITE = st.floats(-1e150, 1e150)
POSITIVE = st.floats(1e-150, 1e150)


def near(low, high, *parts):
    """Tell whether two bounds are a few units of the largest part apart."""
    unit = math.ulp(max(map(abs, (low, high, *parts))))
    return abs(high - low) <= 8.0 * unit


@LAWS
@given(st.lists(FINITE, min_size=1, max_size=5))
@example([1.0, 2.0**-60, -1.0])
def test_sums_hold_the_exact_one(terms):
    exact = sum(map(Fraction, terms))
    assert bounds.sum_down(*terms) <= exact <= bounds.sum_up(*terms)


def test_a_sum_of_one_term_is_exact():
    assert bounds.sum_up(0.1) == bounds.sum_down(0.1) == 0.1


def test_infinite_terms_are_missing_bounds():
    assert bounds.sum_up(1.0, math.inf, -math.inf) == math.inf
    assert bounds.sum_down(1.0, math.inf, -math.inf) == -math.inf
    assert bounds.sum_up(-math.inf, 1.0) < -1e308


@LAWS
@given(FINITE, FINITE)
@example(0.0, math.inf)
@example(-math.inf, 0.0)
def test_products_hold_the_exact_one(x, y):
    low, high = bounds.product_down(x, y), bounds.product_up(x, y)
    if x == 0.0 or y == 0.0:
        assert low == high == 0.0
        return
    assert low <= Fraction(x) * Fraction(y) <= high
    assert near(low, high)


@LAWS
@given(POSITIVE, POSITIVE)
def test_quotients_hold_the_exact_one(x, y):
    low, high = bounds.quotient_down(x, y), bounds.quotient_up(x, y)
    assert 0.0 <= low <= Fraction(x) / Fraction(y) <= high
    assert near(low, high)


def test_a_quotient_by_zero_is_not_bounded():
    assert bounds.quotient_up(1.0, 0.0) == math.inf
    assert bounds.quotient_down(1.0, 0.0) == 0.0


@LAWS
@given(st.floats(0.0, 1e150))
@example(1e-170)
def test_squares_and_roots_hold_the_exact_one(x):
    exact = Fraction(x)
    assert 0.0 <= bounds.square_down(x) <= exact**2 <= bounds.square_up(x)
    assert Fraction(bounds.sqrt_down(x)) ** 2 <= exact <= Fraction(bounds.sqrt_up(x)) ** 2


@LAWS
@given(st.floats(allow_nan=False))
def test_they_are_the_bounds_of_the_kernels(x):
    for name in ('square_up', 'square_down', 'sqrt_up', 'sqrt_down'):
        assert getattr(bounds, name)(x) == getattr(rounding, name)(x)
    assert rounding.up(x) == rounding.step_up(x)
    assert rounding.down(x) == rounding.step_down(x)


@LAWS
@given(st.floats(0.0, 1e150), st.floats(0.0, 1e150))
def test_squared_distances(lower_m, width_m):
    upper_m = lower_m + width_m
    lower_m2, upper_m2 = bounds.squared_distance(lower_m, upper_m)
    assert 0.0 <= lower_m2 <= Fraction(lower_m) ** 2
    assert Fraction(upper_m) ** 2 <= upper_m2


@pytest.mark.parametrize('lower_m', [-2.0, 0.0, 1.0, math.inf])
def test_no_distance_is_negative(lower_m):
    lower_m2, upper_m2 = bounds.squared_distance(lower_m, -1.0)
    assert lower_m2 > upper_m2


def test_a_negative_lower_bound_of_a_distance_says_nothing():
    assert bounds.squared_distance(-3.0, math.inf) == (0.0, math.inf)


@LAWS
@given(st.integers(0, 2**61), st.integers(0, 10**11))
@example(1_700_000_000_123_456_789, 0)
@example(1_700_000_000_123_456_789, 50_000_000)
def test_elapsed_time_of_stamps_in_nanoseconds(stamp_ns, passed_ns):
    first_s, second_s = stamp_ns / 10**9, (stamp_ns + passed_ns) / 10**9
    elapsed_s = Fraction(passed_ns, 10**9)
    of_arrays = arrays.elapsed_up(np.array([first_s, second_s]), np.array([second_s, first_s]))
    for bound_s in (
        bounds.elapsed_up(first_s, second_s),
        bounds.elapsed_up(second_s, first_s),
        *of_arrays.tolist(),
    ):
        assert elapsed_s <= bound_s <= elapsed_s + 8 * Fraction(math.ulp(second_s))


@LAWS
@given(st.lists(st.floats(-1e3, 1e3), min_size=4, max_size=4))
def test_rounding_error_bounds_a_sum_of_products(numbers):
    a, b, c, d = numbers
    computed = a * b - c * d
    exact = Fraction(a) * Fraction(b) - Fraction(c) * Fraction(d)
    magnitude = abs(a * b) + abs(c * d)
    assert abs(computed - exact) <= rounding.rounding_error(magnitude, 3.0)
