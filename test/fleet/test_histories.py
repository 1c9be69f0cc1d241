# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Over histories no truth is lost while bounds hold, nor by estimates that hang or fail."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations, product
import math
import os
from threading import Event

from drives import SAMPLE_S
from habits import draw_habits, has_resets
from histories import (
    SECONDS,
    History,
    draw_any,
    play_seed,
    play_without_a_loss,
    ticks_of,
    truth_is_inside,
)
from hypothesis import example, given, settings, strategies as st
import numpy as np
import pytest
from shapes import check_form

from dg_localization import Verdict
from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import FrameKind, Localizer, OdometryErrorModel, RangeErrorModel
import dg_localization.fleet.localizer as localizer_room
from dg_localization.fleet.rotations import quaternion_of
from dg_localization.fleet.window.forgetting import Forgotten

STEPS = int(os.environ.get('DG_HISTORY_STEPS', '240'))
"""Estimates of each test, one a second; `python test/fleet/histories.py` plays many more."""
MOMENTS = int(os.environ.get('DG_FLEET_EXAMPLES', '400')) // 2


@pytest.mark.parametrize('dimension', [2, 3])
@settings(max_examples=max(1, STEPS // round(SECONDS)), derandomize=False)
@given(seed=st.integers(0, 2**32 - 1))
@example(seed=20051)
def test_the_truth_is_never_lost(dimension, seed):
    history = draw_habits(draw_any(seed, dimension), seed)
    play_without_a_loss(history, ticks_of(history, SECONDS), has_resets(seed))


def test_variances_are_positive_where_past_poses_are_known_far_better():
    assert play_seed(12001940)


@pytest.mark.parametrize('dimension', [2, 3])
@settings(max_examples=MOMENTS, derandomize=False)
@given(seed=st.integers(0, 2**32 - 1))
def test_no_truth_of_a_moment_is_lost(dimension, seed):
    """Fleets of up to six robots that move for half a second, with tiny and with large errors."""
    rng = np.random.default_rng([seed, dimension, 3])
    error, pace = float(rng.choice([1e-6, 0.01, 0.1])), float(rng.choice([0.0, 0.3, 3.0]))
    history = History.draw(
        seed,
        int(rng.integers(1, 7)),
        int(rng.choice([0, 0, 1, 2, 3, 4])),
        0.5,
        dimension=dimension,
        cameras=bool(rng.random() < 0.8),
        pace=pace,
        odometry=float(rng.choice([0.0, 0.0, 0.5])),
        max_speed_m_s=pace + 0.35,
        range_error=RangeErrorModel(-error, 3.0 * error, -error, error, min_reading_m=-1.0),
        bearing_half_width_rad=float(rng.choice([0.0, 1e-3, 0.05, 0.5])),
        max_hypotheses=10_000,
    )
    estimate = play_without_a_loss(draw_habits(history, seed), [0.5])
    assert estimate.n_hypotheses == len(estimate.placements)
    for answer in (estimate, *estimate.groups):
        for placement in answer.placements:
            check_form(placement)


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(('robots', 'anchors', 'mounted'), [(3, 0, 0), (3, 3, 0), (2, 3, 2)])
def test_after_a_broken_bound_the_window_recovers(seed, robots, anchors, mounted):
    memory_s, kicked_s = 4.0, 5.0
    # The search for the wrong readings is not tried here.
    settings = {'memory_s': memory_s, 'max_conflict_seconds': 0.2}
    history = History.draw([seed, anchors], robots, anchors, 14.0, mounted, **settings)
    history.drives[0].kick(round(kicked_s / 0.1), [1.5, -2.0, 0.0])
    forgot = []
    for time_s, estimate in history.play(Localizer(history.config), np.arange(1.0, 14.0, 0.7)):
        forgot += estimate.forgotten
        if time_s < kicked_s - 0.1 or time_s > kicked_s + memory_s:
            assert truth_is_inside(history, time_s, estimate), time_s
        if time_s > kicked_s + memory_s:
            assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
    if anchors:
        assert any('contradict' in forgotten.text for forgotten in forgot)
        points = {end for forgotten in forgot for ends in forgotten.ends for end in ends}
        assert points >= set(history.config.points_on(history.config.robots[0]))


@pytest.mark.parametrize('outliers', [0, 1])
@pytest.mark.parametrize('seed', range(10))
def test_no_pose_is_lost_by_sensors_without_odometry(seed, outliers):
    """The two sensors see all anchors and range some of them; one observation may be wrong."""
    kind = {'cameras': True, 'window_outliers': outliers}
    history = History.draw([seed, 41], 1, 3 + seed % 5, 2.0, 1, **kind)
    history.lies = dict.fromkeys(history.observed[3 : 3 + outliers], 2.0)
    points = history.config.points
    history.unranged = {*product(range(len(points)), (points.index('a0'), points.index('a2')))}
    localizer = Localizer(history.config)
    localizer.add_odometry = lambda *_: None
    known = []
    for time_s, estimate in history.play(localizer, np.arange(0.5, 2.0, 0.25)):
        assert truth_is_inside(history, time_s, estimate), time_s
        known += [estimate.placements[0].heading_known[0]] if estimate.placements else []
    assert all(known) and len(known) >= (3 if outliers else 6)


ERROR = OdometryErrorModel(
    translation_per_m=0.05,
    translation_per_rad=0.01,
    rotation_per_m=0.01,
    rotation_per_rad=0.05,
    constant_m=0.02,
    constant_rad=0.02,
    tilt_rad=0.03,
)
FLIGHT_S = 12.0


@pytest.mark.parametrize('steepest_rad', [0.3, 1.2, 1.57])
@pytest.mark.parametrize('seed', range(2))
def test_no_pose_is_lost_by_rays_of_tilted_cameras(seed, steepest_rad):
    """Near a pitch of 90 degrees roll and yaw are not told apart, and nothing is claimed."""
    kind = {'dimension': 3, 'error': ERROR, 'memory_s': 15.0, 'cameras': True}
    history = History.draw(seed, 2, 4, FLIGHT_S, steepest_rad=steepest_rad, **kind)
    play_without_a_loss(history, np.arange(1.0, FLIGHT_S))


WHOLE_S = np.arange(1.0, 6.0, 1.0)


def dense_track(history, robot):
    """Return the true track of a robot, with a sample at every time that is asked for."""
    times_s = np.union1d(np.arange(0.0, 6.5, 0.1), WHOLE_S)
    places, turns = zip(*[history.drives[robot].pose(time_s) for time_s in times_s], strict=True)
    if history.config.dimension == 2:
        places = np.array(places) + [0.0, 0.0, 7.0]
    # The stamps are large in some histories, and are kept as the odometry has them.
    stamps_s = history.start_s + times_s
    return TrueTrack(stamps_s, places, [quaternion_of(turn) for turn in turns])


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_truth_is_put_in_every_kind_of_frame(dimension):
    seen = set()
    for seed in range(16):
        history = History.draw(
            seed, 3, (0, 0, 3)[seed % 3], 6.0, dimension=dimension, cameras=seed % 2 == 0
        )
        if history.config.stamp_error_s > 0.0:
            continue
        fleet, localizer = history.config, Localizer(history.config)
        if seed % 4 == 0:
            localizer.add_odometry = lambda *_: None
        tracks = {name: dense_track(history, row) for row, name in enumerate(fleet.robots)}
        for name, anchor in fleet.anchors.items():
            tracks[name] = TrueTrack.at_rest(anchor.coordinates_m)
        for time_s, estimate in history.play(localizer, WHOLE_S):
            snapshot = localizer.snapshot(history.start_s + time_s)
            answers = [estimate, *estimate.groups] if estimate.frame else estimate.groups
            for answer in answers:
                if answer.frame.kind == 'robots' and len(answer.frame.points) < dimension:
                    continue  # other axes are any
                wanted_m, turns, _ = history.truth(time_s, answer.frame)
                found = FleetTruth(fleet, tracks).beside(answer.frame, snapshot)
                # Samples of a time of 1.7e9 s are as far apart as its rounding.
                close = {'rtol': 0.0, 'atol': 1e-5}
                np.testing.assert_allclose(found.positions_m, wanted_m, **close)
                np.testing.assert_allclose(found.rotations, turns, **close)
                if answer.placements:
                    missed = [found.outside(one).any() for one in answer.placements]
                    assert not all(missed)
                seen.add(answer.frame.kind)
    assert seen >= set(FrameKind) - ({FrameKind.HEADING} if dimension == 3 else set())


TICKS_S, CHANGED_S = np.arange(1.0, 6.0, 0.5), 3.0
POOR = OdometryErrorModel(translation_per_m=0.2, rotation_per_rad=0.2, max_gap_s=0.15)
GOOD = OdometryErrorModel(translation_per_m=0.01, rotation_per_rad=0.01, max_gap_s=0.15)
ALL_ENDS = frozenset(combinations(('r0', 'r1', 'a0', 'a1', 'a2'), 2))
real = localizer_room.estimate_snapshot


def known_of(estimate):
    """Return what two localizers that know the same agree on."""
    numbers = [placement.number for placement in estimate.placements]
    enclosures = [placement.enclosure_m.tolist() for placement in estimate.placements]
    return numbers, enclosures, estimate.reason, estimate.forgotten, estimate.previous_frame


def forgetting(*arguments):
    """Estimate, and find that nothing may be remembered."""
    estimate, proved = real(*arguments)
    forgotten = Forgotten(ALL_ENDS, math.inf, 'a test', now_too=True)
    return replace(estimate, forgotten=(forgotten,)), proved


def failing(snapshot, *others):
    """Estimate, lose what earlier sets know, and fail then."""
    real(snapshot, *others)
    others[-1].forget(snapshot.config, [Forgotten(ALL_ENDS, math.inf, 'a test')])
    raise RuntimeError('a defect')


def sets_of(localizer):
    return dict(localizer._follower.earlier._sets)


def estimate_by(localizer, snapshot, monkeypatch, how):
    with monkeypatch.context() as patched:
        patched.setattr(localizer_room, 'estimate_snapshot', how)
        return localizer.estimate(snapshot)


@pytest.mark.parametrize('seed', range(6))
def test_bounds_that_become_narrower_keep_what_was_measured(seed):
    """Robots are slow, and their odometry good, from the change on; before it neither holds."""
    kind = {'cameras': True, 'odometry_error': GOOD, 'robot_odometry_error': {}}
    count = 3 * (seed % 2)
    history = History.draw([seed, 51], 3, count, 12.0, error=GOOD, pace=0.2, **kind)
    fast = History.draw([seed, 52], 3, count, 12.0, error=POOR)
    for drive, before in zip(history.drives, fast.drives, strict=True):
        drive.follow(before, round(CHANGED_S / SAMPLE_S))
    narrow = replace(history.config, memory_s=3.0, max_speed_m_s=0.35)
    wider = replace(narrow.range_error, min_error_m=-0.1, max_error_m=0.3)
    wide = replace(
        narrow,
        memory_s=2.0,
        range_error=wider,
        bearing_half_width_rad=0.2,
        odometry_error=POOR,
        max_speed_m_s=1.0,
    )

    def between(localizer, time_s):
        history.config = wide if time_s <= CHANGED_S else narrow
        assert localizer.configure(history.config)
        return localizer

    localizer = Localizer(wide)
    for time_s, estimate in history.play(localizer, np.arange(0.5, 12.0, 0.7), between):
        assert truth_is_inside(history, time_s, estimate) and not estimate.forgotten, time_s
        snapshot = localizer.snapshot(history.start_s + time_s)
        remembered = [seen[0].stamp_s for seen in snapshot.window.observations.values()]
        if CHANGED_S < time_s < 2.0 * CHANGED_S:
            assert snapshot.config.max_speed_m_s == 1.0
            assert min(remembered) < history.start_s + CHANGED_S
    assert snapshot.config == narrow
    crossed = replace(narrow.range_error, min_error_relative=0.1)
    scaled = replace(GOOD, translation_scale=1.1)
    changes = {'range_error': crossed}, {'odometry_error': scaled}, {'memory_s': 0.0}
    for other in (*(replace(narrow, **change) for change in changes), wide):
        assert not localizer.configure(other)


@pytest.fixture(params=[0, 3])
def history(request):
    """Two robots with and without anchors, whose pose sets are carried on."""
    return History.draw([1, 5], 2, request.param, 6.0, memory_s=30.0)


def test_an_estimate_that_was_overtaken_changes_nothing(history, monkeypatch):
    hangs, goes_on = Event(), Event()

    def hanging(*arguments):
        hangs.set()
        assert goes_on.wait(60.0)
        return forgetting(*arguments)

    localizer, undisturbed = Localizer(history.config), Localizer(history.config)
    wanted = [known_of(estimate) for _, estimate in history.play(undisturbed, TICKS_S)]
    found = []
    with ThreadPoolExecutor(1) as pool:
        for time_s, estimate in history.play(localizer, TICKS_S):
            found.append(known_of(estimate))
            if time_s == 2.0:
                snapshot = localizer.snapshot(history.start_s + time_s)
                with monkeypatch.context() as patched:
                    patched.setattr(localizer_room, 'estimate_snapshot', hanging)
                    overtaken = pool.submit(localizer.estimate, snapshot)
                    assert hangs.wait(60.0)
            if time_s == 3.0:
                goes_on.set()
                assert overtaken.result().forgotten
    assert found == wanted


def test_an_estimate_that_fails_changes_nothing(history, monkeypatch):
    localizer = Localizer(history.config)
    for time_s, _ in history.play(localizer, TICKS_S):
        known = sets_of(localizer)
        with pytest.raises(RuntimeError, match='a defect'):
            snapshot = localizer.snapshot(history.start_s + time_s)
            estimate_by(localizer, snapshot, monkeypatch, failing)
        assert sets_of(localizer) == known
    assert any(known)


def test_the_estimate_of_a_snapshot_from_before_a_reset_changes_nothing(history, monkeypatch):
    localizer, undisturbed = Localizer(history.config), Localizer(history.config)
    for time_s, estimate in history.play(localizer, TICKS_S):
        snapshot, before = localizer.snapshot(history.start_s + time_s), known_of(estimate)
    localizer.reset()
    assert estimate_by(localizer, snapshot, monkeypatch, forgetting).forgotten
    # The clock was set back: it all happens once more.
    anew = zip(history.play(localizer, TICKS_S), history.play(undisturbed, TICKS_S), strict=True)
    for (_, found), (_, wanted) in anew:
        assert known_of(found)[1:4] == known_of(wanted)[1:4]
        # Numbers are not used again.
        assert min(known_of(found)[0]) > max(before[0])
