# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Sensors that repeat themselves although robots move are noticed, and dropped only if wanted."""

import math

import pytest
from sensing import add_odometry, new_localizer

from dg_localization.fleet import LinkKey, LinkKind, RejectionReason

START_S = 100.0


def watched(value_of, motion, count=30, **settings):
    """Return a localizer, and what it says of an input after some readings of it."""
    localizer = new_localizer(('a', 'b'), stuck_readings=10, **settings)
    for step in range(count):
        now_s = START_S + 0.1 * step
        for robot, (x_m, yaw_rad) in motion(step).items():
            add_odometry(localizer, robot, (x_m, 0.0), now_s, yaw_rad)
        value = value_of(step)
        if isinstance(value, float):
            localizer.add_range('a', 'b', value, now_s, now_s)
        else:
            localizer.add_bearing('a', 'b', value, now_s, now_s)
    kind = LinkKind.RANGE if isinstance(value, float) else LinkKind.BEARING
    states = {state.key: state for state in localizer.input_states(now_s)}
    return localizer, states[LinkKey(kind, 'a', 'b')]


def driving(step):
    return {'a': (0.0, 0.0), 'b': (0.1 * step, 0.0)}


def turning(step):
    return {'a': (0.0, 0.1 * step), 'b': (0.0, 0.0)}


def parked(step):
    return {'a': (0.0, 0.0), 'b': (0.0, 0.0)}


def unknown(step):
    return {}


def test_the_sensor_the_value_and_the_time_are_named():
    _, state = watched(lambda step: 3.0 + 0.01 * step if step < 5 else 3.217, driving)
    assert state.stuck == (
        'stuck: 25 readings in a row are 3.217 m, since 100.500 s, while b moved by 0.5 m'
    )
    assert state.accepted == 30


@pytest.mark.parametrize(
    ('value_of', 'motion', 'count', 'stuck'),
    [
        (lambda step: 3.0, parked, 400, False),
        (lambda step: 3.0, driving, 9, False),
        (lambda step: 3.0 + 1e-15 * (step % 2), driving, 30, False),
        (lambda step: math.inf, driving, 30, False),
        (lambda step: 3.0, unknown, 99, False),
        (lambda step: 3.0, unknown, 100, True),
        (lambda step: 3.0, turning, 30, False),
        (lambda step: [1.0, 0.5, 0.0], turning, 30, True),
        (lambda step: [1.0, 0.5, 0.0], parked, 30, False),
        (lambda step: [1.0, 0.1 * step, 0.0], turning, 30, False),
    ],
)
def test_what_is_stuck(value_of, motion, count, stuck):
    _, state = watched(value_of, motion, count)
    assert bool(state.stuck) == stuck


def test_stuck_readings_are_dropped_only_if_wanted():
    _, state = watched(lambda step: 3.0, driving, 30, drop_stuck=True)
    assert 0 < state.rejected[RejectionReason.STUCK] < 30
    assert 'stuck' in state.last_reason_text
    _, state = watched(lambda step: 3.0, driving, 30)
    assert not state.rejected


def test_odometry_that_starts_anew_is_no_motion():
    def jumping(step):
        return {'a': (0.0, 0.0), 'b': (0.0 if step < 15 else 100.0, 0.0)}

    _, state = watched(lambda step: 3.0, jumping, max_speed_m_s=1.0)
    assert state.stuck == ''
    moving_after = {'a': (0.0, 0.0), 'b': (0.0, 0.0)}
    _, state = watched(
        lambda step: 3.0,
        lambda step: moving_after if step < 5 else {'b': (100.0 + 0.1 * step, 0.0)},
        max_speed_m_s=1.0,
    )
    assert state.stuck.endswith('while b moved by 0.5 m')


@pytest.mark.parametrize(
    ('value_of', 'motion', 'frozen'),
    [
        (lambda step: 3.0 + 0.1 * step, parked, True),
        (lambda step: 3.0 + 0.1 * step, driving, False),
        (lambda step: 3.0 + 0.002 * step, parked, False),
        (lambda step: 5.0 if step % 5 == 0 else 3.0, parked, False),
        (lambda step: 3.0 + 0.1 * step, unknown, False),
    ],
)
def test_odometry_that_never_changes_while_ranges_show_motion_is_told(value_of, motion, frozen):
    localizer, _ = watched(value_of, motion)
    now_s = START_S + 2.9
    states = {state.key: state.warning for state in localizer.input_states(now_s)}
    of_b = states.get(LinkKey(LinkKind.ODOMETRY, 'b', ''), '')
    assert of_b.startswith('the pose has not changed since 100.000 s, while range a->b') == frozen
    told = [text for text in localizer.snapshot(now_s).warnings if 'is frozen' in text]
    assert len(told) == (2 if frozen else 0)
