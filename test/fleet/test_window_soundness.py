# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Over complete histories the truth is never lost while every measurement obeys its bound."""

import os

from histories import History, localizer_of, truth_is_inside
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization import Verdict

HISTORIES = int(os.environ.get('DG_HISTORIES', '30'))
SECONDS = float(os.environ.get('DG_HISTORY_SECONDS', '8'))


@settings(max_examples=HISTORIES, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.integers(1, 4),
    anchors=st.sampled_from([0, 0, 1, 2, 3]),
    memory_s=st.sampled_from([0.0, 2.0, 6.0, 30.0]),
    window_outliers=st.sampled_from([0, 0, 1]),
    resets=st.booleans(),
)
def test_the_truth_is_never_lost(seed, robots, anchors, memory_s, window_outliers, resets):
    history = History.draw(
        seed, robots, anchors, SECONDS, memory_s=memory_s, window_outliers=window_outliers
    )
    ticks_s = np.sort(history.rng.uniform(0.3, SECONDS, round(SECONDS)))

    def between(localizer, time_s):
        if resets and history.rng.random() < 0.15:
            localizer.reset()
        return localizer

    for time_s, estimate in history.play(localizer_of(history), ticks_s, between):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert estimate.n_hypotheses == len(estimate.placements)
        assert truth_is_inside(history, time_s, estimate), time_s


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('anchors', [0, 3])
def test_after_a_broken_bound_the_window_recovers(seed, anchors):
    memory_s, kicked_s = 4.0, 5.0
    history = History.draw([seed, anchors], 3, anchors, 14.0, memory_s=memory_s)
    history.drives[0].kick(round(kicked_s / 0.1), [1.5, -2.0])
    forgot = []
    for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 14.0, 0.7)):
        forgot += [forgotten.text for forgotten in estimate.forgotten]
        if time_s < kicked_s - 0.1 or time_s > kicked_s + memory_s:
            assert truth_is_inside(history, time_s, estimate), time_s
        if time_s > kicked_s + memory_s:
            assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
    if anchors:
        assert any('contradict' in text for text in forgot)
