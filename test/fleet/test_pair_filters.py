# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Two robots with ranges and odometry alone, which are followed from estimate to estimate."""

from dataclasses import replace
import math
from threading import Event

from histories import History, localizer_of, truth_is_inside
import numpy as np
import pytest

from dg_localization import Verdict
from dg_localization.fleet import (
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
    estimation,
    localizer as localizer_room,
)
from dg_localization.fleet.answers import Answer
from dg_localization.fleet.estimate import FixedFrame, FrameKind
from dg_localization.fleet.estimation import estimate_snapshot
from dg_localization.fleet.frames.finders import FittedPlacement
from dg_localization.fleet.frames.plan import FramePlan, Plans
from dg_localization.fleet.window import pair_filters
from dg_localization.fleet.window.allowance import Allowance
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.narrowing import narrow_answer
from dg_localization.fleet.window.pair_filters import FILTERS, Directions, PairFilters
from dg_localization.fleet.window.recollection import Recollection
from dg_localization.interval.kernels import COMPILED
from dg_localization.solver.result import Statistics

pytestmark = pytest.mark.skipif(not COMPILED, reason='without numba no pairs are followed')

MEMORY_S = 6.0


def draw(seed, seconds, **settings):
    """Draw two robots that have odometry, measure each other, and see nothing."""
    for attempt in range(100):
        history = History.draw(
            [seed, attempt], 2, 0, seconds, **{'memory_s': MEMORY_S, **settings}
        )
        localizer = localizer_of(history)
        for _time_s, estimate in history.play(localizer, [0.9 * seconds]):
            snapshot = localizer.snapshot(estimate.stamp_s)
        tracked = snapshot.motion.odometry.keys() >= {'r0', 'r1'}
        if tracked and snapshot.distances and not snapshot.rays:
            return history
    raise AssertionError(seed)


def filters_of(localizer):
    return localizer._follower.pair_filters._filters


def widths(estimate):
    """Return the widths of the headings of the first placement."""
    return np.minimum(2.0 * estimate.placements[0].heading_half_width_rad, 2.0 * math.pi)


@pytest.mark.parametrize('seed, mounted', [*((seed, 0) for seed in range(12)), (12, 1), (13, 2)])
def test_no_truth_is_lost_while_filters_follow_each_other(seed, mounted):
    history = draw(seed, 16.0, mounted=mounted)
    localizer = localizer_of(history)
    starts = set()
    for time_s, estimate in history.play(localizer, np.arange(0.9, 16.0, 0.35)):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert truth_is_inside(history, time_s, estimate), time_s
        since_s = [known.since_s for known in filters_of(localizer)]
        assert len(since_s) <= FILTERS + 1
        assert all(start_s >= estimate.stamp_s - MEMORY_S for start_s in since_s)
        assert np.all(np.diff(since_s) >= MEMORY_S / FILTERS - 1e-6)
        assert all(
            known.knot_s <= estimate.stamp_s - history.config.max_age_s
            for known in filters_of(localizer)
        )
        starts |= {*since_s}
    assert len(starts) >= 3


def test_headings_are_narrower_than_by_all_readings_seen_from_now(monkeypatch):
    found = {}
    for followed in (True, False):
        if not followed:
            monkeypatch.setattr(PairFilters, 'follow', lambda *_: None)
        for seed in range(6):
            history = draw(100 + seed, 15.0, memory_s=30.0)
            *_, (time_s, estimate) = history.play(localizer_of(history), np.arange(1.0, 15.0, 1.0))
            assert truth_is_inside(history, time_s, estimate)
            found.setdefault(followed, []).append(np.median(widths(estimate)))
    assert np.mean(found[True]) < 0.85 * np.mean(found[False])


@pytest.mark.parametrize('seed', range(4))
def test_followed_and_started_anew_both_hold_the_truth(seed):
    history = draw(200 + seed, 10.0)
    localizer = localizer_of(history)
    for time_s, followed in history.play(localizer, np.arange(1.0, 10.0, 1.0)):
        anew, _ = estimate_snapshot(localizer.snapshot(history.start_s + time_s))
        assert truth_is_inside(history, time_s, followed)
        assert truth_is_inside(history, time_s, anew)


def test_a_reading_that_comes_late_cuts_as_if_it_had_come_in_time():
    answers = []
    for late_s in (0.0, 0.15):
        history = draw(5, 9.0)
        history.calls = [
            (stamp_s + (late_s if 'range' in call.__qualname__ else 0.0), call)
            for stamp_s, call in history.calls
        ]
        history.calls.sort(key=lambda call: call[0])
        localizer = localizer_of(history)
        for time_s, estimate in history.play(localizer, np.arange(1.0, 9.0, 0.5)):
            assert truth_is_inside(history, time_s, estimate)
        answers.append([(known.knot_s, len(known.cover)) for known in filters_of(localizer)])
    assert answers[0] == answers[1]


def test_filters_end_with_what_is_forgotten_at_a_reset_and_when_time_goes_back():
    history = draw(7, 12.0)
    localizer = localizer_of(history)
    for _time_s, estimate in history.play(localizer, np.arange(1.0, 12.0, 1.0)):
        assert not estimate.forgotten
    oldest, *others = filters_of(localizer)
    assert others
    of_pair, config = localizer._follower.pair_filters, history.config

    def forgotten(before_s, ends, after_s=-math.inf):
        return [Forgotten(frozenset([ends]), before_s, 'a test', after_s)]

    of_pair.forget(config, forgotten(oldest.since_s + 0.1, ('r0', 'another')))
    of_pair.forget(config, forgotten(oldest.since_s - 0.01, ('r1', 'r0')))
    of_pair.forget(config, forgotten(math.inf, ('r1', 'r0'), oldest.knot_s))
    assert filters_of(localizer)[0] is oldest
    of_pair.forget(config, forgotten(oldest.since_s, ('r1', 'r0')))
    assert oldest not in filters_of(localizer) and others[0] in filters_of(localizer)
    localizer.estimate(localizer.snapshot(estimate.stamp_s - 4.0))
    assert all(known.knot_s <= estimate.stamp_s - 4.0 for known in filters_of(localizer))
    localizer.reset()
    assert not filters_of(localizer)


def test_what_a_cancelled_estimate_forgets_is_forgotten(monkeypatch):
    history = draw(7, 12.0)
    localizer = localizer_of(history)
    estimates = [estimate for _, estimate in history.play(localizer, np.arange(1.0, 12.0, 1.0))]
    assert filters_of(localizer)
    forgotten = Forgotten(frozenset([('r0', 'r1')]), math.inf, 'a test')
    broken = replace(estimates[-1], forgotten=(forgotten,))
    asked = []

    def estimate_snapshot(snapshot, cancel, proved, *_):
        asked.append((snapshot, proved))
        return broken, ()

    monkeypatch.setattr(localizer_room, 'estimate_snapshot', estimate_snapshot)
    cancel = Event()
    cancel.set()
    # The second one is taken before the first is answered.
    snapshots = [localizer.snapshot(broken.stamp_s) for _ in range(2)]
    localizer.estimate(snapshots[0], cancel)
    assert not filters_of(localizer)
    assert not localizer.snapshot(broken.stamp_s).window.observations
    localizer.estimate(snapshots[1], cancel)
    (first, proved), (second, proved_after) = asked
    assert first.window.observations and not second.window.observations
    assert proved and not proved_after


@pytest.mark.parametrize(
    ('robots', 'anchors', 'settings'),
    [(3, 0, {}), (2, 2, {}), (2, 0, {'window_outliers': 1}), (2, 0, {'memory_s': 0.0})],
)
def test_only_two_robots_without_anchors_and_outliers_are_followed(robots, anchors, settings):
    history = History.draw(7, robots, anchors, 3.0, **{'memory_s': MEMORY_S, **settings})
    localizer = localizer_of(history)
    for time_s, estimate in history.play(localizer, [1.0, 2.0, 3.0]):
        assert truth_is_inside(history, time_s, estimate)
        assert not filters_of(localizer)


def test_without_time_nothing_is_said_and_no_truth_lost(monkeypatch):
    said = []

    def follow(filters, snapshot, _stopped):
        said.append(at_once(filters, snapshot, lambda: True))
        return said[-1]

    at_once = PairFilters.follow
    monkeypatch.setattr(PairFilters, 'follow', follow)
    history = draw(4, 6.0)
    for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 6.0, 0.5)):
        assert truth_is_inside(history, time_s, estimate)
    assert said and not any(said)


@pytest.mark.parametrize('seed', range(4))
def test_after_a_broken_bound_two_robots_recover(seed):
    kicked_s = 5.0
    history = draw(300 + seed, 16.0)
    history.drives[0].kick(round(kicked_s / 0.1), [1.5, -2.0])
    for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 16.0, 0.7)):
        if time_s < kicked_s - 0.1 or time_s > kicked_s + MEMORY_S:
            assert truth_is_inside(history, time_s, estimate), time_s


def test_ranges_that_contradict_each_other_are_forgotten_and_the_moment_is_answered(monkeypatch):
    history = draw(8, 6.0)
    localizer = localizer_of(history)
    *_, (_time_s, estimate) = history.play(localizer, np.arange(1.0, 5.0, 0.5))
    assert filters_of(localizer)
    monkeypatch.setattr(PairFilters, 'follow', lambda *_: pair_filters.NOWHERE)
    estimate = localizer.estimate(localizer.snapshot(estimate.stamp_s))
    assert estimate.placements and not filters_of(localizer)
    assert any('contradicts' in forgotten.text for forgotten in estimate.forgotten)


def test_where_not_all_hypotheses_are_listed_directions_contradict_nothing(monkeypatch):
    history = draw(8, 6.0)
    localizer = localizer_of(history)
    *_, (_time_s, estimate) = history.play(localizer, np.arange(1.0, 5.0, 0.5))

    def with_one_more(found, *args):
        return narrow_answer(replace(found, n_hypotheses=found.n_hypotheses + 1), *args)

    narrow_answer = estimation.narrow_answer
    monkeypatch.setattr(estimation, 'narrow_answer', with_one_more)
    monkeypatch.setattr(PairFilters, 'follow', lambda *_: pair_filters.NOWHERE)
    estimate = localizer.estimate(localizer.snapshot(estimate.stamp_s))
    assert estimate.placements and not estimate.forgotten and filters_of(localizer)


def test_where_a_filter_cannot_go_on_the_next_starts_later(monkeypatch):
    history = draw(9, 10.0)
    localizer = localizer_of(history)
    lost, lost_now = [], False

    def carried(cover, way, ranges=None):
        if lost_now:
            lost.append(way)
            return None
        return carry(cover, way, ranges)

    carry = pair_filters.MutualCover.carried
    monkeypatch.setattr(pair_filters.MutualCover, 'carried', carried)
    for time_s, estimate in history.play(localizer, np.arange(1.0, 10.0, 0.5)):
        assert truth_is_inside(history, time_s, estimate)
        if lost_now:
            # At the next estimate none of these goes on any more.
            lost_s = estimate.stamp_s - history.config.max_age_s
        elif lost:
            assert all(known.since_s > lost_s - 1.0 for known in filters_of(localizer))
        lost_now = 4.0 < time_s < 4.8
    assert lost and filters_of(localizer)


def test_in_the_frame_of_one_robot_directions_tell_the_pose_of_the_other():
    place_m, yaw_rad = np.array([3.0, 2.0]), 1.0
    away_m, line_rad = np.linalg.norm(place_m), math.atan2(2.0, 3.0)
    seen_rad = np.array([line_rad, line_rad + math.pi - yaw_rad])
    found = Directions(seen_rad[:, None] + [-0.1, 0.1], away_m - 0.2, away_m + 0.2)
    bounds = found._seen_from(0)
    low_m, high_m = bounds.enclosure_m[1]
    assert np.all((low_m < place_m) & (place_m < high_m)) and np.all(high_m - low_m < 1.2)
    low_rad, high_rad = bounds.arcs_rad[1] - yaw_rad
    assert math.remainder(low_rad + 0.2, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)
    assert high_rad - low_rad == pytest.approx(0.4)


def test_what_contradicts_itself_leaves_no_placement_in_any_frame():
    history = draw(2, 4.0)
    *_, (_time_s, estimate) = history.play(localizer_of(history), np.arange(1.0, 4.0, 0.5))
    for placement in estimate.placements:
        left = pair_filters.NOWHERE.leave(placement, estimate.frame, history.config.robots)
        assert left is None


def test_a_hypothesis_that_directions_rule_out_is_named():
    history = draw(2, 4.0)
    localizer = localizer_of(history)
    *_, (_time_s, estimate) = history.play(localizer, np.arange(1.0, 4.0, 0.5))
    (placement,) = estimate.placements
    boxes_m = np.array([np.zeros((2, 2)), [[2.9, 1.9], [3.1, 2.1]]])
    mirrored_m = boxes_m * [1.0, -1.0]
    mirrored_m[1] = [[2.9, -2.1], [3.1, -1.9]]
    first, second = (replace(placement, enclosure_m=box_m) for box_m in (boxes_m, mirrored_m))
    frame = FixedFrame(FrameKind.HEADING, ('r0',))
    to_second_rad = math.atan2(-2.0, 3.0) + np.array([-0.1, 0.1])
    directions = Directions(np.array([to_second_rad, [-3.2, 3.2]]), 3.0, 4.0)
    recalled = Recollection(
        localizer.snapshot(estimate.stamp_s), Allowance(math.inf, None), directions=directions
    )
    found = Answer(Verdict.COVERED, (first, replace(second, mirrored=True)), 2, Statistics())
    plans = Plans(FramePlan(frame, (0, 1), ((0, 1),)), '', ())
    narrowed = narrow_answer(found, plans, recalled, lambda _, one: FittedPlacement(one))
    assert [one.mirrored for one in narrowed.answer.placements] == [False]
    (text,) = narrowed.ruled_out
    assert text.startswith('mirror image ruled out by r0 - r1 over ')


def test_two_robots_whose_tags_are_away_from_their_centers_learn_their_headings():
    """They range from tag to tag alone, and drive in circles for 15 s."""
    arms_m = {'a': (0.4, 0.1), 'b': (-0.3, 0.2)}
    error = OdometryErrorModel(
        translation_per_m=0.05, rotation_per_rad=0.05, constant_m=0.01, constant_rad=0.01
    )
    localizer = Localizer(
        FleetConfig(
            robots=('a', 'b'),
            mounts={name: {'tag': arm_m} for name, arm_m in arms_m.items()},
            range_error=RangeErrorModel(0.0, 0.0, -0.03, 0.03),
            odometry_error=error,
            max_turn_rate_rad_s=1.3,
            memory_max_seconds=math.inf,
        )
    )
    for tick in range(151):
        now_s, tags_m = 100.0 + 0.1 * tick, []
        for name, (along, across) in arms_m.items():
            x, y, yaw = circling(name, 0.1 * tick)
            turn = [0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)]
            localizer.add_odometry(name, [x, y, 0.0], turn, now_s, now_s)
            c, s = math.cos(yaw), math.sin(yaw)
            tags_m.append((x + c * along - s * across, y + s * along + c * across))
        if tick % 3 == 0:
            localizer.add_range('a/tag', 'b/tag', math.dist(*tags_m), now_s, now_s)
        if tick % 15 == 0 and tick:
            estimate = localizer.step(now_s)
            assert estimate.verdict is not Verdict.INFEASIBLE and not estimate.forgotten
    (placement,) = estimate.placements
    first, second = 2.0 * np.arctan2(*placement.orientations_xyzw[:, 2:].T)
    true = circling('b', 15.0)[2] - circling('a', 15.0)[2]
    off_rad = abs(math.remainder(second - first - true, 2.0 * math.pi))
    assert off_rad <= placement.heading_half_width_rad.sum() < 1.5


def circling(name, time_s):
    """Return the pose (x, y, yaw) of a robot that drives in a circle, each its own way round."""
    middle, radius, rate = {'a': (0.0, 0.8, 0.7), 'b': (3.5, 1.5, -0.35)}[name]
    angle = rate * time_s
    yaw = angle + math.copysign(0.5 * math.pi, rate)
    return middle + radius * math.cos(angle), radius * math.sin(angle), yaw
