# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A hostile day: the node stays up, comes back, and shows no old answer as a new one."""

import os
import random

import pytest

from benchmarks.chaos.disturbances import DISTURBANCES
from benchmarks.chaos.run import live_through, old_ones
from benchmarks.chaos.world import Seen

# The long run: DG_CHAOS_ROUNDS=20 make test PYTEST_ARGS=test/ros/test_chaos.py
ROUNDS = int(os.environ.get('DG_CHAOS_ROUNDS', '0'))
SHORT = ('sensors silent', 'robot restarts', 'wrong types', 'flood', 'clock +7 s', 'reset')
SHORT += ('deactivated', 'slow, clock -7 s')


@pytest.mark.timeout(300 + 120 * ROUNDS)
def test_the_node_survives_and_no_old_answer_looks_new():
    order = list(SHORT)
    for seed in range(ROUNDS):
        order += random.Random(seed).sample(list(DISTURBANCES), len(DISTURBANCES))
    day = live_through(order)
    assert not day.faults, f'{day.faults}\n{day.output}'
    assert [outcome.name for outcome in day.outcomes] == order
    assert day.exit_code == 0 and 'Traceback' not in day.output, day.output
    assert day.world.answers > len(order)


class Screen:
    def __init__(self, level, ages_s):
        stamps_s = [None if age_s is None else 50.0 - age_s for age_s in ages_s]
        self.seen = [Seen(0.1 * k, 50.0, s, level, '') for k, s in enumerate(stamps_s)]


def test_an_old_answer_that_looks_new_is_noticed():
    assert old_ones(Screen(0, [2.0] * 60))
    assert not old_ones(Screen(1, [2.0] * 60))
    assert not old_ones(Screen(0, [0.5] * 60))
    assert not old_ones(Screen(0, [None] * 60))
    assert not old_ones(Screen(0, [2.0] * 30 + [0.2] + [2.0] * 30))
