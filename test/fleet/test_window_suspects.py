# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which ranges between two robots are to blame where a window contradicts itself."""

from dataclasses import replace
import math

from histories import History, localizer_of
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization.fleet.contradictions.window_suspects import (
    explain_window,
    suspects_in_window,
)
from dg_localization.fleet.window.mutual_walk import MutualWalk
from dg_localization.fleet.window.recollection import recall
from dg_localization.interval.kernels import COMPILED
from dg_localization.pairs import MutualCover

pytestmark = pytest.mark.skipif(not COMPILED, reason='without numba no pairs are followed')

PAIR = (0, 1)
SECONDS = 5.0


def draw(seed, outliers=1):
    """Draw two robots that have odometry and range each other."""
    for attempt in range(100):
        history = History.draw(
            [seed, attempt], 2, 0, SECONDS, memory_s=10.0, window_outliers=outliers
        )
        snapshot = snapshot_of(history, {})
        if len(snapshot.motion.odometry) == 2 and snapshot.distances and not snapshot.rays:
            return history
    raise AssertionError(seed)


class Told:
    """A localizer that is told some ranges, counted from the first, that are off."""

    def __init__(self, history, lies_m):
        self.localizer = localizer_of(history)
        self.lies_m = lies_m
        self.liars = set()
        self.count = 0

    def add_range(self, observer, target, range_m, stamp_s, now_s):
        if self.count in self.lies_m:
            range_m = max(0.0, range_m + self.lies_m[self.count])
            self.liars.add((observer, target, stamp_s))
        self.count += 1
        return self.localizer.add_range(observer, target, range_m, stamp_s, now_s)

    def __getattr__(self, name):
        return getattr(self.localizer, name)


def tell(history, lies_m):
    """Return a localizer that was told all of a history, some ranges wrong."""
    told = Told(history, lies_m)
    for arrival_s, call in history.calls:
        call(told, arrival_s)
    return told


def snapshot_of(history, lies_m):
    return tell(history, lies_m).localizer.snapshot(history.start_s + SECONDS)


def shown_by(snapshot):
    """Return whom the pose sets make suspect."""
    return suspects_in_window(snapshot, recall(snapshot, (), None).pose_sets, lambda: False)


def names_of(suspects):
    return {(one.name, one.target, one.stamp_s) for one in suspects}


@settings(max_examples=12, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), off_m=st.floats(-3.0, 3.0), number=st.integers(0, 15))
def test_who_lies_alone_is_named_by_a_contradiction(seed, off_m, number):
    history = draw(seed)
    told = tell(history, {number: off_m})
    snapshot = told.localizer.snapshot(history.start_s + SECONDS)
    config = replace(snapshot.config, max_conflict_solves=10_000, max_conflict_seconds=math.inf)
    walk = MutualWalk.of(snapshot.carried, PAIR, config.memory_s)
    if walk.contradicts(lambda: False):
        shown = {PAIR: frozenset()}
        explained = explain_window(replace(snapshot, config=config), shown, lambda: False)
        assert told.liars <= names_of(explained[PAIR])


def test_pairs_that_agree_take_no_limited_time(lying):
    shown = {PAIR: frozenset()}
    limited = replace(lying, config=replace(lying.config, memory_max_seconds=1e3))
    assert explain_window(limited, shown, lambda: False) == shown
    assert explain_window(lying, shown, lambda: False) != shown


def test_readings_that_are_right_contradict_nothing():
    for seed in range(6):
        snapshot = snapshot_of(draw(seed), {})
        walk = MutualWalk.of(snapshot.carried, PAIR, snapshot.config.memory_s)
        assert not walk.contradicts(lambda: False)
        assert not any(explain_window(snapshot, {PAIR: frozenset()}, lambda: False).values())


def test_ranges_name_liars_that_pose_sets_do_not():
    by_poses, by_ranges = 0, 0
    for seed in range(8):
        history = draw(seed)
        told = tell(history, {7: 1.2})
        snapshot = told.localizer.snapshot(history.start_s + SECONDS)
        shown = shown_by(snapshot)
        explained = explain_window(snapshot, shown, lambda: False)
        by_poses += names_of(shown[PAIR]) == told.liars
        by_ranges += names_of(explained[PAIR]) == told.liars
    assert by_ranges > by_poses


@pytest.fixture
def lying():
    """Return the snapshot of a lie that ranges and odometry prove."""
    for seed in range(20):
        snapshot = snapshot_of(draw(seed), {7: 3.0})
        walk = MutualWalk.of(snapshot.carried, PAIR, snapshot.config.memory_s)
        if walk.contradicts(lambda: False):
            return snapshot
    raise AssertionError


def test_what_is_not_known_in_time_is_not_said(lying):
    shown = {PAIR: frozenset()}
    assert explain_window(lying, shown, lambda: True) == shown
    walk = MutualWalk.of(lying.carried, PAIR, lying.config.memory_s)
    assert not walk.contradicts(lambda: True)


def test_at_a_limit_those_of_the_pose_set_stay(lying):
    shown = shown_by(lying)
    limited = replace(lying, config=replace(lying.config, max_conflict_solves=0))
    assert explain_window(limited, shown, lambda: False) == shown


def test_ways_that_cannot_be_followed_contradict_nothing(lying, monkeypatch):
    monkeypatch.setattr(MutualCover, 'carried', lambda *_: None)
    walk = MutualWalk.of(lying.carried, PAIR, lying.config.memory_s)
    assert not walk.contradicts(lambda: False)


def test_ranges_before_the_odometry_of_both_say_nothing(lying):
    walk = MutualWalk.of(lying.carried, PAIR, lying.config.memory_s)
    early = replace(walk.seen[0], stamp_s=walk.known_s - 1.0, lower_m=1e3, upper_m=1e3 + 1.0)
    right = [one for one in walk.seen if one.stamp_s < walk.seen[1].stamp_s]
    assert not MutualWalk(walk.paths, [early, *right], 10.0).contradicts(lambda: False)


def test_ranges_of_any_size_are_no_bounds():
    snapshot = snapshot_of(draw(0), {})
    walk = MutualWalk.of(snapshot.carried, PAIR, snapshot.config.memory_s)
    open_m = [replace(one, upper_m=math.inf) for one in walk.seen]
    assert not MutualWalk(walk.paths, open_m, 10.0).contradicts(lambda: False)
    assert np.all(np.diff([one.stamp_s for one in walk.seen]) >= 0.0)
