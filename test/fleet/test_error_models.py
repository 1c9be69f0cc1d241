# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Readings to bounds: the stated error is inside, to the last bit, and REP-117 is followed."""

from fractions import Fraction
from itertools import product
import math

from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.fleet import ConfigError, RangeErrorModel, RejectionReason, error_models
from dg_localization.fleet.error_models import (
    distance_bounds_m,
    likeliest_distance_m,
    projected_half_width_rad,
)
from dg_localization.fleet.vocabulary import RangeMessage, RefusedError

EXACT = RangeErrorModel(min_error_relative=0.0, max_error_relative=0.0)
UWB = RangeErrorModel(
    min_error_m=-0.1, max_error_m=1.3, min_error_relative=0.0, max_error_relative=0.02
)
FAR = RangeErrorModel(beyond_max_is_far=True)


def interpret_range(model, *values, variance_m2=None):
    """Return what a range says, or why it is refused."""
    message = RangeMessage(*values)._replace(variance_m2=variance_m2)
    try:
        return error_models.interpret_range(model, message)
    except RefusedError as refused:
        return refused.rejection


finite = st.floats(-2.0, 2.0)
fraction = st.floats(-0.9, 0.9)


@settings(derandomize=False)
@given(
    reading=st.floats(0.0, 1e3),
    absolute=st.tuples(finite, finite),
    relative=st.tuples(fraction, fraction),
    share=st.fractions(0, 1),
)
def test_every_true_distance_of_the_model_is_inside(reading, absolute, relative, share):
    model = RangeErrorModel(
        min_error_m=min(absolute),
        max_error_m=max(absolute),
        min_error_relative=min(relative),
        max_error_relative=max(relative),
    )
    lower, upper = distance_bounds_m(model, reading)
    exact = Fraction(reading)
    low = Fraction(min(absolute)) + Fraction(min(relative)) * exact
    high = Fraction(max(absolute)) + Fraction(max(relative)) * exact
    true = exact - (low + share * (high - low))
    if true >= 0:
        assert Fraction(lower) <= true <= Fraction(upper)


def test_bounds_that_grow_with_the_range_may_cross():
    model = RangeErrorModel(-1.0, 1.0, 0.07, 0.05)
    for reading, share in product((0.0, 10.0, 100.0, 200.0), (0.0, 0.5, 1.0)):
        ends = -1.0 + 0.07 * reading, 1.0 + 0.05 * reading
        distance = max(0.0, reading - (ends[0] + share * (ends[1] - ends[0])))
        low, high = distance_bounds_m(model, reading)
        assert low <= distance <= high
    with pytest.raises(ConfigError, match='min_error_relative'):
        RangeErrorModel(0.0, 0.0, 0.07, 0.05)


@pytest.mark.parametrize(
    ('bounds', 'expected_m', 'likeliest_m'),
    [((-0.2, 1.0), None, 4.8), ((0.2, 0.4), None, 4.75), ((-0.2, 1.0), 0.3, 4.7)],
)
def test_the_likeliest_error_is_near_zero_or_as_is_stated(bounds, expected_m, likeliest_m):
    model = RangeErrorModel(*bounds, 0.0, 0.0, expected_error_m=expected_m)
    assert likeliest_distance_m(model, 5.0) == pytest.approx(likeliest_m)
    assert math.isnan(likeliest_distance_m(model, math.inf))


def test_the_likeliest_error_may_grow_with_the_range():
    model = RangeErrorModel(-1.0, 1.0, 0.0, 0.1, expected_error_relative=0.0625)
    assert likeliest_distance_m(model, 32.0) == 30.0
    model = RangeErrorModel(-1.0, 1.0, 0.0, 0.1, 0.0, False, 0.5, 0.0625)
    assert likeliest_distance_m(model, 32.0) == 29.5


def test_variance_counts_with_a_sigma_factor():
    model = RangeErrorModel(sigma_factor=3.0, min_error_relative=0.0, max_error_relative=0.0)
    assert interpret_range(model, 5.0, variance_m2=0.01) == pytest.approx((4.7, 5.3))
    assert interpret_range(model, 5.0) == pytest.approx((5.0, 5.0))
    assert interpret_range(model, 5.0, variance_m2=math.inf) == (0.0, math.inf)
    assert interpret_range(EXACT, 5.0, variance_m2=math.nan) == pytest.approx((5.0, 5.0))
    for wrong in (math.nan, -1.0):
        rejection = interpret_range(model, 5.0, variance_m2=wrong)
        assert rejection.reason is RejectionReason.INVALID_VARIANCE
        assert str(wrong) in rejection.text


@pytest.mark.parametrize('limits', [(0.0, 0.0), (None, None), (math.nan, math.nan), (0.0, 100.0)])
def test_limits_that_are_not_given_exclude_nothing(limits):
    assert interpret_range(EXACT, 42.0, *limits) == pytest.approx((42.0, 42.0))


def test_beyond_the_maximum_is_a_lower_bound_only_where_stated():
    lower, upper = interpret_range(FAR, math.inf, 0.1, 8.0)
    assert lower == pytest.approx(8.0 * 0.97)
    assert upper == math.inf
    for model, limits in ((FAR, (0.0, 0.0)), (UWB, (0.1, 8.0))):
        assert interpret_range(model, math.inf, *limits).reason is RejectionReason.NOTHING_IN_RANGE


def test_closer_than_the_minimum_is_an_upper_bound():
    assert interpret_range(UWB, -math.inf, 0.3, 8.0) == pytest.approx((0.0, 0.4))


def test_the_projection_of_a_steep_ray_turns_more_than_the_ray():
    half_width_rad, rise = 0.05, math.atan2(3.0, 0.8)
    true = np.array([math.cos(rise), 0.0, math.sin(rise)])
    random = np.random.default_rng(0)
    largest_share = 0.0
    for _ in range(2000):
        across = np.cross(true, random.normal(size=3))
        across /= np.linalg.norm(across)
        seen = math.cos(half_width_rad) * true + math.sin(half_width_rad) * across
        bound_rad = projected_half_width_rad(seen, half_width_rad)
        off_rad = abs(math.atan2(seen[1], seen[0]))
        assert off_rad <= bound_rad
        largest_share = max(largest_share, off_rad / bound_rad)
    assert largest_share > 0.99
    assert projected_half_width_rad(np.array([0.01, 0.0, 1.0]), half_width_rad) == math.pi
