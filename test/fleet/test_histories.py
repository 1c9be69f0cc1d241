# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Over complete histories the truth is never lost while every measurement obeys its bound."""

from itertools import product
import os

from habits import draw_habits, has_resets
from histories import (
    SECONDS,
    History,
    draw_any,
    localizer_of,
    play_without_a_loss,
    ticks_of,
    truth_is_inside,
)
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization import Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel

STEPS = int(os.environ.get('DG_HISTORY_STEPS', '240'))
"""Estimates of each test, one a second; `python test/fleet/histories.py` plays many more."""
MOMENTS = int(os.environ.get('DG_FLEET_EXAMPLES', '400')) // 2


@pytest.mark.parametrize('dimension', [2, 3])
@settings(max_examples=max(1, STEPS // round(SECONDS)), derandomize=False)
@given(seed=st.integers(0, 2**32 - 1))
def test_the_truth_is_never_lost(dimension, seed):
    history = draw_habits(draw_any(seed, dimension), seed)
    play_without_a_loss(history, ticks_of(history, SECONDS), has_resets(seed))


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


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize(('robots', 'anchors', 'mounted'), [(3, 0, 0), (3, 3, 0), (2, 3, 2)])
def test_after_a_broken_bound_the_window_recovers(seed, robots, anchors, mounted):
    memory_s, kicked_s = 4.0, 5.0
    # The search for the wrong readings is not tried here.
    settings = {'memory_s': memory_s, 'max_conflict_seconds': 0.2}
    history = History.draw([seed, anchors], robots, anchors, 14.0, mounted, **settings)
    history.drives[0].kick(round(kicked_s / 0.1), [1.5, -2.0, 0.0])
    forgot = []
    for time_s, estimate in history.play(localizer_of(history), np.arange(1.0, 14.0, 0.7)):
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
@pytest.mark.parametrize('seed', range(20))
def test_no_pose_is_lost_by_sensors_without_odometry(seed, outliers):
    """The two sensors see all anchors and range some of them; one observation may be wrong."""
    kind = {'cameras': True, 'window_outliers': outliers}
    history = History.draw([seed, 41], 1, 3 + seed % 5, 2.0, 1, **kind)
    history.lies = dict.fromkeys(history.observed[3 : 3 + outliers], 2.0)
    points = history.config.points
    history.unranged = {*product(range(len(points)), (points.index('a0'), points.index('a2')))}
    localizer = localizer_of(history)
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


def fly(seed, *, robots=2, memory_s=15.0, lies_m=0.0, **kind):
    """Play a flight among four anchors, of which some readings lie; return the last answer."""
    kind |= {'dimension': 3, 'error': ERROR, 'memory_s': memory_s}
    history = History.draw(seed, robots, 4, FLIGHT_S, **kind)
    history.lies = dict.fromkeys(history.observed[3:300:99] if lies_m else (), lies_m)
    return play_without_a_loss(history, np.arange(1.0, FLIGHT_S))


@pytest.mark.parametrize('steepest_rad', [0.3, 1.2])
@pytest.mark.parametrize('seed', range(3))
def test_no_pose_is_lost_by_rays_of_tilted_cameras(seed, steepest_rad):
    fly(seed, steepest_rad=steepest_rad, cameras=True)


def test_positions_are_sharper_and_headings_known():
    of_memory, of_moment = (
        fly(1, memory_s=memory_s, steepest_rad=0.3, cameras=False) for memory_s in (15.0, 0.0)
    )
    widths = [
        np.max([np.ptp(p.enclosure_m, axis=1) for p in e.placements], axis=0)
        for e in (of_memory, of_moment)
    ]
    assert np.all(widths[0][:, :2] < 1.5) and np.all(widths[0] < 0.6 * widths[1])
    (placement,) = of_memory.placements
    assert placement.heading_known.all() and np.all(placement.heading_half_width_rad < 1.0)
    assert not any(p.heading_known.any() for p in of_moment.placements)


def test_wrong_readings_lose_nothing_where_they_are_tolerated():
    fly(5, window_outliers=3, lies_m=-2.0)


def test_a_body_that_stands_on_end_has_no_heading():
    """Near a pitch of 90 degrees roll and yaw are not told apart, and nothing is claimed."""
    fly(2, robots=1, steepest_rad=1.57)
