# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node: its jumps, the rate of estimates, and what these may spend on bounds."""

import pytest

from dg_localization.ros.interface.diagnostics import TOLERATED_RATE
from dg_localization.ros.node.clock import NodeTime, Pace, RateMeter


@pytest.mark.parametrize(
    ('period_s', 'until_s', 'wanted_hz', 'now_s', 'rate_hz'),
    [
        (0.2, 20.0, 5.0, 120.1, 5.0),
        (2.4, 12.0, 5.0, 112.1, 1.0 / 2.4),
        (0.2, 1.0, 5.0, 101.1, None),
        (0.2, 0.0, 5.0, 110.0, 0.1),
        (10.0, 100.0, 0.1, 209.0, 0.1),
        (10.0, 0.0, 0.1, 103.0, None),
    ],
    ids=['met', 'not met', 'too early', 'an estimate that does not end', 'slow', 'slow at first'],
)
def test_the_rate_is_that_of_the_last_estimates(period_s, until_s, wanted_hz, now_s, rate_hz):
    meter = RateMeter(wanted_hz)
    for number in range(int(until_s / period_s) + 1):
        meter.count(100.0 + number * period_s)
    assert meter.rate_hz(now_s) == (None if rate_hz is None else pytest.approx(rate_hz))
    meter.clear()
    assert meter.rate_hz(now_s) is None


def follow(pace, base_s, number=30):
    """Let estimates take some time, and all that they may spend besides."""
    for _ in range(number):
        pace.note(base_s + pace.tighten_s)


def test_bounds_are_tightened_for_as_long_as_the_rate_allows():
    pace = Pace(5.0)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2)
    follow(pace, base_s=0.05)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2 - 0.05)
    follow(pace, base_s=1.0)
    assert pace.tighten_s == 0.0
    follow(pace, base_s=0.02)
    assert pace.tighten_s == pytest.approx(TOLERATED_RATE * 0.2 - 0.02)


def test_at_a_low_rate_the_limit_of_the_solver_is_what_late_estimates_lower():
    pace = Pace(1.0, limit_s=0.1)
    assert pace.tighten_s == 0.1
    pace.note(TOLERATED_RATE + 0.1)
    assert pace.tighten_s == pytest.approx(0.05)
    # What is left of the period is measured by the period, not by the limit.
    pace.note(0.5)
    assert pace.tighten_s == 0.1


@pytest.mark.parametrize('step_s', [0.02, 1.0])
def test_the_steps_of_a_simulated_time_are_measured(step_s):
    clock = {'s': 100.0}
    node_time = NodeTime(lambda: clock['s'], True)
    for _ in range(20):
        clock['s'] += step_s
        for _ in range(5):
            node_time.now()
    assert node_time.step_s() == pytest.approx(step_s)


@pytest.mark.parametrize('is_simulated', [False, True])
def test_a_clock_that_was_set_back_by_less_than_since_the_last_call_is_seen(is_simulated):
    """A simulated clock may run slowly."""
    clock, steady = {'s': 100.0}, {'s': 0.0}
    node_time = NodeTime(lambda: clock['s'], is_simulated, lambda: steady['s'])
    clock['s'], steady['s'] = 100.2, 0.2
    assert node_time.now() == (100.2, 0.0)
    clock['s'], steady['s'] = 100.3, 0.5
    now_s, back_s = node_time.now()
    assert now_s == 100.3
    assert back_s == (0.0 if is_simulated else pytest.approx(0.2))
    assert (node_time.arrived_s(0.01) is None) is not is_simulated
    clock['s'], steady['s'] = 100.4, 0.6
    assert node_time.now() == (100.4, 0.0)
    assert node_time.arrived_s(0.01) is not None


def test_what_interrupts_a_call_sets_no_clock_back():
    """The thread may have to wait between looks at the two clocks."""
    time_s = {'s': 0.0}

    def look():
        time_s['s'] += 0.07
        return time_s['s']

    node_time = NodeTime(lambda: 100.0 + look(), steady_s=look)
    assert [node_time.now()[1] for _ in range(5)] == [0.0] * 5


@pytest.mark.parametrize('is_simulated, arrived_s', [(False, 97.0), (True, 100.0)])
def test_what_has_waited_arrived_before(is_simulated, arrived_s):
    """By a simulated clock, which may be paused or fast, it is not known how long it waited."""
    node_time = NodeTime(lambda: 100.0, is_simulated, steady_s=lambda: 5.0)
    node_time.now()
    assert node_time.arrived_s(3.0) == arrived_s
    assert node_time.arrived_s(0.0) == 100.0


@pytest.mark.parametrize('is_simulated', [False, True])
def test_what_arrived_before_the_time_jumped_back_never_looks_new(is_simulated):
    clock, steady = {'s': 100.0}, {'s': 0.0}
    node_time = NodeTime(lambda: clock['s'], is_simulated, lambda: steady['s'])
    clock['s'], steady['s'] = 1.0, 10.0
    assert node_time.now() == (1.0, 99.0)
    assert node_time.arrived_s(0.001) is None
    steady['s'] = 11.0
    assert node_time.arrived_s(1.001) is None
    assert node_time.arrived_s(0.5) is not None
