# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Over complete histories the truth is never lost while every measurement obeys its bound."""

import os

from habits import draw_habits, has_resets
from histories import (
    SECONDS,
    History,
    draw_any,
    localizer_of,
    play_without_a_loss,
    truth_is_inside,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization import Verdict

STEPS = int(os.environ.get('DG_HISTORY_STEPS', '240'))
"""Estimates of each test, one a second; `python test/fleet/histories.py` plays many more."""


@pytest.mark.parametrize('dimension', [2, 3])
@settings(max_examples=max(1, STEPS // round(SECONDS)), deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_truth_is_never_lost(dimension, seed):
    history = draw_habits(draw_any(seed, dimension), seed)
    play_without_a_loss(history, SECONDS, has_resets(seed))


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize(('robots', 'anchors', 'mounted'), [(3, 0, 0), (3, 3, 0), (2, 3, 2)])
def test_after_a_broken_bound_the_window_recovers(seed, robots, anchors, mounted):
    memory_s, kicked_s = 4.0, 5.0
    history = History.draw([seed, anchors], robots, anchors, 14.0, mounted, memory_s=memory_s)
    history.drives[0].kick(round(kicked_s / 0.1), [1.5, -2.0, 0.0])
    forgot = []
    for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 14.0, 0.7)):
        forgot += [forgotten.text for forgotten in estimate.forgotten]
        if time_s < kicked_s - 0.1 or time_s > kicked_s + memory_s:
            assert truth_is_inside(history, time_s, estimate), time_s
        if time_s > kicked_s + memory_s:
            assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
    if anchors:
        assert any('contradict' in text for text in forgot)
