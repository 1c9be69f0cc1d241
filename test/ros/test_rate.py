# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The rate of estimates."""

import pytest

from dg_localization.ros.node.clock import LEAST_TIGHTEN_S, SHARE_OF_PERIOD, Pace, RateMeter


def meter(period_s, until_s, wanted_hz=5.0):
    made = RateMeter(wanted_hz)
    for number in range(int(until_s / period_s) + 1):
        made.count(100.0 + number * period_s)
    return made


def test_rate_that_is_met():
    assert meter(0.2, 20.0).rate_hz(120.1) == pytest.approx(5.0)


def test_rate_that_is_not_met():
    assert meter(2.4, 12.0).rate_hz(112.1) == pytest.approx(1 / 2.4)


def test_nothing_is_known_at_first():
    assert RateMeter(5.0).rate_hz(100.0) is None
    assert meter(0.2, 1.0).rate_hz(101.1) is None


def test_estimate_that_does_not_end_lowers_the_rate():
    one = RateMeter(5.0)
    one.count(100.0)
    assert one.rate_hz(110.0) == pytest.approx(0.1)
    assert meter(0.2, 10.0).rate_hz(120.0) < 2.0


def test_only_the_last_seconds_count():
    one = meter(1.0, 100.0)
    for number in range(1, 101):
        one.count(200.0 + 0.2 * number)
    assert one.rate_hz(220.1) == pytest.approx(5.0)


def test_slow_rates_look_back_further():
    assert meter(10.0, 100.0, wanted_hz=0.1).rate_hz(209.0) == pytest.approx(0.1)


def test_cleared_meter_knows_nothing():
    one = meter(0.2, 20.0)
    one.clear()
    assert one.rate_hz(120.1) is None


def follow(pace, base_s, number=30):
    """Let estimates take some time, and besides all that they may spend; return the last one's."""
    for _ in range(number):
        took_s = base_s + pace.tighten_s
        pace.note(took_s)
    return took_s


def test_bounds_are_tightened_for_as_long_as_the_rate_allows():
    pace = Pace(5.0)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2)
    assert follow(pace, base_s=0.05) == pytest.approx(SHARE_OF_PERIOD * 0.2)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2 - 0.05)


def test_estimates_that_are_late_in_any_case_are_not_tightened_until_they_are_fast_again():
    pace = Pace(5.0)
    follow(pace, base_s=1.0)
    assert pace.tighten_s == LEAST_TIGHTEN_S
    for _ in range(10):
        pace.note(0.02)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2)


def test_one_late_estimate_costs_the_next_ones_little():
    pace = Pace(5.0)
    pace.note(10.0)
    follow(pace, base_s=0.02)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2 - 0.02)


def test_a_very_high_rate_leaves_the_least_time():
    assert Pace(1000.0).tighten_s == LEAST_TIGHTEN_S


def test_at_a_low_rate_the_limit_of_the_solver_is_what_late_estimates_lower():
    pace = Pace(1.0, limit_s=0.1)
    assert pace.tighten_s == 0.1
    pace.note(SHARE_OF_PERIOD + 0.1)
    assert pace.tighten_s == pytest.approx(0.05)
    # What is left of the period is measured by the period, not by the limit.
    pace.note(0.5)
    assert pace.tighten_s == 0.1
    assert Pace(5.0, limit_s=1.0).tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2)
