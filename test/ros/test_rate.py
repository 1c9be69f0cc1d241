# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The rate of estimates, and the time that they may spend on bounds."""

import pytest

from dg_localization.ros.node.clock import LEAST_TIGHTEN_S, SHARE_OF_PERIOD, Pace, RateMeter


@pytest.mark.parametrize(
    ('period_s', 'until_s', 'wanted_hz', 'now_s', 'rate_hz'),
    [
        (0.2, 20.0, 5.0, 120.1, 5.0),
        (2.4, 12.0, 5.0, 112.1, 1.0 / 2.4),
        (0.2, 1.0, 5.0, 101.1, None),
        (0.2, 0.0, 5.0, 110.0, 0.1),
        (10.0, 100.0, 0.1, 209.0, 0.1),
    ],
    ids=['met', 'not met', 'too early', 'an estimate that does not end', 'slow'],
)
def test_the_rate_is_that_of_the_last_estimates(period_s, until_s, wanted_hz, now_s, rate_hz):
    meter = RateMeter(wanted_hz)
    for number in range(int(until_s / period_s) + 1):
        meter.count(100.0 + number * period_s)
    assert meter.rate_hz(now_s) == (None if rate_hz is None else pytest.approx(rate_hz))
    meter.clear()
    assert meter.rate_hz(now_s) is None


def follow(pace, base_s, number=30):
    """Let estimates take some time, and besides all that they may spend."""
    for _ in range(number):
        pace.note(base_s + pace.tighten_s)


def test_bounds_are_tightened_for_as_long_as_the_rate_allows():
    pace = Pace(5.0)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2)
    follow(pace, base_s=0.05)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2 - 0.05)
    follow(pace, base_s=1.0)
    assert pace.tighten_s == LEAST_TIGHTEN_S == Pace(1000.0).tighten_s
    follow(pace, base_s=0.02)
    assert pace.tighten_s == pytest.approx(SHARE_OF_PERIOD * 0.2 - 0.02)


def test_at_a_low_rate_the_limit_of_the_solver_is_what_late_estimates_lower():
    pace = Pace(1.0, limit_s=0.1)
    assert pace.tighten_s == 0.1
    pace.note(SHARE_OF_PERIOD + 0.1)
    assert pace.tighten_s == pytest.approx(0.05)
    # What is left of the period is measured by the period, not by the limit.
    pace.note(0.5)
    assert pace.tighten_s == 0.1
