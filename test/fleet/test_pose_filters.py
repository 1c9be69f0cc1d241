# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Robots among anchors that are followed from estimate to estimate."""

from dataclasses import replace
from types import SimpleNamespace

from histories import History, localizer_of, truth_is_inside
import numpy as np
import pytest

from dg_localization import Verdict
from dg_localization.fleet import answers
from dg_localization.fleet.estimation import estimate_snapshot
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.pose_filters import FILTERS, _Walk

MEMORY_S = 6.0


@pytest.fixture(autouse=True)
def _even_in_short_memories(monkeypatch):
    monkeypatch.setattr('dg_localization.fleet.window.pose_filters.LEAST_FOLLOWED_S', 0.0)


def draw(seed, seconds, **settings):
    settings = {'memory_s': MEMORY_S, **settings}
    return History.draw(seed, 2, 3, seconds, **settings)


def filters_of(localizer):
    return localizer._follower.filters._filters


def add_wrong_ranges(history, count, seconds):
    """Have a robot and an anchor measure so many wrong ranges in every memory."""
    robot, anchor = history.config.robots[0], next(iter(history.config.anchors))
    for time_s in np.arange(0.11, seconds, MEMORY_S / max(count, 1)) if count else ():
        stamp_s = history.start_s + time_s

        def call(localizer, now_s, stamp_s=stamp_s):
            return localizer.add_range(robot, anchor, 14.0, stamp_s, now_s)

        history.calls.append((stamp_s, call))
    history.calls.sort(key=lambda call: call[0])


@pytest.mark.parametrize('seed', range(8))
@pytest.mark.parametrize('outliers', [0, 2])
def test_no_truth_is_lost_while_chains_follow_each_other(seed, outliers):
    history = draw([seed, outliers], 16.0, window_outliers=outliers)
    add_wrong_ranges(history, outliers, 16.0)
    localizer = localizer_of(history)
    starts = set()
    for time_s, estimate in history.play(localizer, np.arange(0.9, 16.0, 0.7)):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert truth_is_inside(history, time_s, estimate), time_s
        for filters in filters_of(localizer).values():
            since_s = [one.since_s for one in filters]
            assert len(since_s) <= FILTERS + 1
            assert all(start_s >= estimate.stamp_s - MEMORY_S for start_s in since_s)
            assert np.all(np.diff(since_s) >= MEMORY_S / FILTERS)
            starts |= {*since_s}
    if all(localizer.snapshot(estimate.stamp_s).motion.odometry.get(r) for r in ('r0', 'r1')):
        assert len(starts) >= 3


@pytest.mark.parametrize('seed', range(4))
def test_followed_and_started_anew_both_hold_the_truth(seed):
    history = draw([seed, 7], 10.0)
    localizer = localizer_of(history)
    for time_s, followed in history.play(localizer, np.arange(1.0, 10.0, 1.0)):
        anew, _ = estimate_snapshot(localizer.snapshot(history.start_s + time_s))
        assert truth_is_inside(history, time_s, followed)
        assert truth_is_inside(history, time_s, anew)


@pytest.mark.parametrize('seed', range(3))
def test_steps_that_are_used_again_are_those_that_would_be_taken(seed, monkeypatch):
    steps = []

    def counted(walk, pose_filter, until_s):
        steps.append(until_s)
        return to(walk, pose_filter, until_s)

    to = _Walk._to
    monkeypatch.setattr(_Walk, '_to', counted)
    taken = []
    for again in (True, False):
        history = draw([seed, 11], 9.0, window_outliers=1)
        localizer = localizer_of(history)
        found, steps[:] = [], []
        for _time_s, estimate in history.play(localizer, np.arange(1.0, 9.0, 0.1)):
            found.append([p.enclosure_m for p in estimate.placements])
            if not again:
                localizer._follower.filters._steps.clear()
        taken.append((found, len(steps)))
    (reused, few), (anew, many) = taken
    assert few < many
    assert all(np.array_equal(a, b) for a, b in zip(reused, anew, strict=True))


def test_bounds_are_not_tightened_where_all_robots_have_pose_sets(monkeypatch):
    tightened = []

    def counted(problem, options, *arguments):
        tightened.append(options.tighten_slices > 0)
        return solve(problem, options, *arguments)

    solve = answers.solve
    monkeypatch.setattr(answers, 'solve', counted)
    for memory_s, always in ((0.0, True), (MEMORY_S, False)):
        tightened.clear()
        for seed in range(4):
            history = draw([seed, 3], 3.0)
            solver = replace(history.config.solver, tighten_slices=4)
            history.config = replace(history.config, solver=solver, memory_s=memory_s)
            for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 3.0, 0.5)):
                assert truth_is_inside(history, time_s, estimate), (seed, time_s)
        assert tightened and all(tightened) is always


def test_chains_end_with_the_memory_with_what_is_forgotten_and_at_a_reset():
    history = draw(3, 30.0, window_outliers=0)
    history.calls = [
        call
        for call in history.calls
        if call[0] - history.start_s < 8.0 or 'odometry' in str(call)
    ]
    localizer = localizer_of(history)
    for _time_s, estimate in history.play(localizer, np.arange(1.0, 8.0, 1.0)):
        assert not estimate.forgotten
    filters = filters_of(localizer)
    assert filters and all(filters.values())
    robot, (oldest, *_) = next(iter(filters.items()))
    name = history.config.robots[robot]

    def forgotten(before_s, ends):
        return [Forgotten(frozenset([ends]), before_s, 'a test')]

    all_filters = localizer._follower.filters
    all_filters.forget(history.config, forgotten(oldest.since_s + 0.1, (name, 'another')))
    assert filters[robot][0] is oldest
    all_filters.forget(history.config, forgotten(oldest.since_s, (name, 'a1')))
    assert filters[robot][0] is oldest
    all_filters.forget(history.config, forgotten(oldest.since_s + 0.1, ('a1', name)))
    assert oldest not in filters[robot]
    localizer.reset()
    assert not filters_of(localizer)


def test_a_robot_that_was_carried_away_ends_its_filters():
    history = draw([1, 5], 16.0, window_outliers=0)
    history.drives[0].kick(80, [1.5, -2.0])
    localizer = localizer_of(history)
    forgot = []
    for time_s, estimate in history.play(localizer, np.arange(1.0, 16.0, 0.5)):
        forgot += [item.text for item in estimate.forgotten]
        if time_s < 7.8 or time_s > 8.0 + MEMORY_S:
            assert truth_is_inside(history, time_s, estimate), time_s
    assert any('contradict' in text for text in forgot)


def test_where_the_time_is_up_a_chain_waits_and_is_carried_on_without_readings():
    history = draw(3, 12.0)
    localizer = localizer_of(history)
    list(history.play(localizer, np.arange(1.0, 9.0, 1.0)))
    filters = localizer._follower.filters
    robot, (before, *_) = next(iter(filters_of(localizer).items()))
    snapshot = localizer.snapshot(history.start_s + 9.0)
    place = filters.place(snapshot, robot, lambda: True)
    assert filters_of(localizer)[robot][0] is before
    truth, yaws = history.truth(9.0, SimpleNamespace(kind='anchors'))
    at = np.array([*truth[robot], 0.0]), float(yaws[robot])
    assert place.contains(*at)
    sharper = filters.place(snapshot, robot, lambda: False)
    assert sharper.contains(*at)
    assert sharper.area_m2 < place.area_m2
