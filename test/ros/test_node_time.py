# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The time of a node: jumps, and standing still."""

import pytest

from dg_localization.ros.node.clock import NodeTime


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
    """A simulated one may run slowly."""
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
