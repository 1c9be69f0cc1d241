# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""With as many wrong readings as a window tolerates, the truth is never lost."""

import math
import os

from histories import History, localizer_of, truth_is_inside
from hypothesis import given, settings, strategies as st
import numpy as np

from dg_localization import Verdict

HISTORIES = int(os.environ.get('DG_HISTORIES', '30'))
SECONDS = 6.0


class Lying:
    """A localizer that is told some wrong observations: range and ray are wrong together."""

    def __init__(self, history, wrong, agreeing):
        self.localizer = localizer_of(history)
        self.rng = np.random.default_rng(wrong)
        self.left = wrong
        self.agreeing = agreeing
        self.off_m = self.rng.uniform(-4.0, 4.0)
        self.lies = {}
        self.told = set()

    def _lies(self, observer, target, stamp_s):
        """Return by how much an observation is off, or None; the same for range and ray."""
        key = (observer, target, stamp_s)
        if key not in self.told:
            self.told.add(key)
            # Those that agree are of one pair, one after the other.
            started = self.lies and self.agreeing
            chosen = (observer, target) in {k[:2] for k in self.lies} if started else True
            if self.left and chosen and (started or self.rng.random() < 0.05):
                self.left -= 1
                off_m = self.off_m if self.agreeing else self.rng.uniform(-4.0, 4.0)
                self.lies[key] = off_m
        return self.lies.get(key)

    def add_range(self, observer, target, range_m, stamp_s, now_s):
        off_m = self._lies(observer, target, stamp_s) or 0.0
        range_m = max(0.0, range_m + off_m)
        return self.localizer.add_range(observer, target, range_m, stamp_s, now_s)

    def add_bearing(self, observer, target, ray, stamp_s, now_s):
        angle = math.atan2(ray[1], ray[0]) + (self._lies(observer, target, stamp_s) or 0.0)
        ray = [math.cos(angle), math.sin(angle), 0.0]
        return self.localizer.add_bearing(observer, target, ray, stamp_s, now_s)

    def add_odometry(self, *arguments):
        return self.localizer.add_odometry(*arguments)

    def step(self, now_s):
        return self.localizer.step(now_s)


def all_have_odometry(history):
    """Return whether the tolerance covers everything: it needs odometry of all robots."""
    localizer = localizer_of(history)
    for arrival_s, call in history.calls:
        call(localizer, arrival_s)
    observers = {s.key.observer for s in localizer.input_states(0.0) if s.key.kind == 'odometry'}
    return observers == set(history.config.robots)


def accused(history, estimate):
    """Return the suspects of the window by the two bodies that they are of, as they were told."""
    robots = {*history.config.robots}
    found = {}
    for one in estimate.suspects_in_window:
        told = (one.name, one.target, one.stamp_s)
        found.setdefault(frozenset(robots & {one.name, one.target}), set()).add(told)
    return found


@settings(max_examples=HISTORIES, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.integers(2, 4),
    anchors=st.sampled_from([0, 0, 2, 3]),
    memory_s=st.sampled_from([3.0, 30.0]),
    wrong=st.sampled_from([1, 2, 5]),
    agreeing=st.booleans(),
)
def test_the_truth_is_never_lost(seed, robots, anchors, memory_s, wrong, agreeing):
    history = History.draw(
        seed, robots, anchors, SECONDS, memory_s=memory_s, window_outliers=wrong
    )
    if not all_have_odometry(history):
        return
    liar = Lying(history, wrong, agreeing)
    for time_s, estimate in history.play(liar, [1.5, 3.0, 4.5, 6.0]):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert truth_is_inside(history, time_s, estimate), (time_s, liar.lies)
        # None where nobody lies.
        assert all(told & liar.lies.keys() for told in accused(history, estimate).values())
