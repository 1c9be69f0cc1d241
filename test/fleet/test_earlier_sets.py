# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Earlier sets carry a robot on; nothing older than the memory counts or withholds an answer."""

import math

from circling import ERROR, Circling
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, anchors_at, new_localizer

from dg_localization import Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel

ANCHORS_M = {'a': (-6.0, -4.5), 'b': (6.0, -4.5), 'c': (6.0, 4.5), 'd': (-6.0, 4.5)}
TOO_LONG = 1.006
"""Of the ways that odometry states."""


def driving(memory_s, error=ERROR):
    """Return a robot that circles among anchors, by odometry that errs."""
    fleet = Circling(
        1,
        odometry_frame='odom',
        anchors=anchors_at(ANCHORS_M),
        range_error=RangeErrorModel(-0.1, 0.1, 0.0, 0.0),
        max_age_s=0.5,
        max_speed_m_s=1.0,
        max_turn_rate_rad_s=1.0,
        odometry_error=error,
        memory_s=memory_s,
    )
    fleet.scale = 1.0 / TOO_LONG
    return fleet


@pytest.mark.parametrize('memory_s', [5.0, 15.0])
def test_a_gap_of_any_length_is_bridged_by_odometry(memory_s):
    fleet, gap_s, widths_m = driving(memory_s), 4.0 * memory_s, []
    list(fleet.drive(10.0))
    for estimate in fleet.drive(gap_s, anchors=False):
        (placement,) = fleet.holding(estimate)
        widths_m.append(np.ptp(placement.enclosure_m[0], axis=0).max())
    # Its greatest speed alone allows this much in both directions.
    assert max(widths_m) < 0.25 * 2.0 * gap_s


@pytest.mark.parametrize('restart_s', [math.inf, 7.0, 15.0])
def test_the_likely_point_is_carried_through_a_gap(restart_s):
    """Also where odometry starts anew in another frame: the limits bound the motion to it."""
    fleet = driving(5.0)
    for second in range(40):
        if second == restart_s:
            fleet.started_m, fleet.started_rad = np.array([90.0, -40.0]), 2.0
        (estimate,) = fleet.drive(1.0, anchors=second < 10)
        if second < 10:
            continue
        (placement,) = fleet.holding(estimate)
        off_m = np.linalg.norm(placement.positions_m[0] - fleet.poses()[0][0])
        assert off_m < (0.2 if restart_s == math.inf else 0.6), second
        deviation_m = math.sqrt(np.linalg.eigvalsh(placement.covariances[0][:2, :2])[-1])
        assert off_m < 3.0 * deviation_m


@pytest.mark.parametrize('every_s', [1.0, 7.0, 11.0])
def test_a_set_that_odometry_does_not_reach_any_more_claims_nothing(every_s):
    """Answers that are asked for less often than memory lasts, without readings in between."""
    fleet = driving(5.0)
    for seconds, anchors in ((8.0, True), (19.0, False), (7.0, True)):
        for estimate in fleet.drive(seconds, every_s, anchors=anchors):
            assert not estimate.placements or fleet.holding(estimate)
    assert len(fleet.localizer.step(fleet.now_s).placements) == 1


@pytest.mark.parametrize('side', [-1.0, 0.0, 1.0])
@pytest.mark.parametrize('scale', [0.7, 1.0, 1.3])
def test_odometry_that_is_scaled_and_errs_at_its_bound_loses_no_truth(scale, side):
    fleet = driving(30.0, OdometryErrorModel(translation_per_m=0.05, translation_scale=scale))
    fleet.scale = scale * (1.0 + 0.0499 * side)
    for seconds, anchors in ((6.0, True), (10.0, False)):
        for estimate in fleet.drive(seconds, anchors=anchors):
            assert fleet.holding(estimate) and not estimate.forgotten
    # Ten seconds of it without a look at anything.
    assert np.ptp(estimate.placements[0].enclosure_m[0], axis=0).max() < 2.5 * scale


START_S, MEMORY_S, STEP_S = 100.0, 10.0, 0.2
BEACONS_M = {'a': (0.0, 5.0), 'b': (0.0, -5.0), 'c': (8.0, 4.0)}
PLACES_M = {'r': (2.0, 0.0), 's': (3.0, 1.0)}


def localizer_of(robots, **settings):
    return new_localizer(
        robots,
        odometry_error={'translation_per_m': 0.01},
        memory_s=MEMORY_S,
        memory_max_seconds=math.inf,
        max_age_s=0.3,
        **settings,
    )


def enclosures_among_anchors(first_error_m, outliers):
    """Return the enclosures of two parked robots by time since the start."""
    localizer = localizer_of(
        tuple(PLACES_M),
        anchors=BEACONS_M,
        range_error=(-0.01, 0.01, -0.3, 0.3),
        window_outliers=outliers,
    )
    found = {}
    for step in range(80):
        since_s, now_s = step * STEP_S, START_S + step * STEP_S
        for robot, place_m in PLACES_M.items():
            add_odometry(localizer, robot, place_m, now_s, frame=f'{robot}/odom')
            off_m = first_error_m if since_s < 0.5 else 0.0
            add_ranges(localizer, robot, place_m, BEACONS_M, now_s, off_m)
        if step % 4 == 0 and since_s > 5.0:
            found[since_s] = localizer.step(now_s).placements[0].enclosure_m
    return found


@pytest.mark.parametrize('outliers', [0, 1])
def test_what_is_older_than_the_memory_has_no_effect_among_anchors(outliers):
    """Other right readings in the first half second do not change it."""
    some, others = (enclosures_among_anchors(error_m, outliers) for error_m in (0.0, 1.0))
    if not outliers:
        assert any((some[t] != others[t]).any() for t in some if t < MEMORY_S)
    for since_s, enclosure_m in some.items():
        if since_s > MEMORY_S + 0.5:
            np.testing.assert_array_equal(enclosure_m, others[since_s])


def triangle_that_cannot_be(measured_now):
    """Remember three ranges that no triangle has; return the estimates since."""
    localizer = localizer_of(('r', 's', 't'), range_error=(-0.05, 0.05, 0.0, 0.0))
    estimates = []
    for step in range(60):
        since_s, now_s = step * STEP_S, START_S + step * STEP_S
        for robot in 'rst':
            add_odometry(localizer, robot, (0.0, 0.0), now_s, frame=f'{robot}/odom')
        if since_s < 0.5:
            localizer.add_range('r', 's', 1.0, now_s, now_s)
            localizer.add_range('s', 't', 1.0, now_s, now_s)
            if step == 0:
                localizer.add_range('r', 't', 5.0, now_s, now_s)
        elif measured_now:
            localizer.add_range('r', 's', 1.0, now_s, now_s)
        if since_s >= 1.0 and step % 5 == 0:
            estimates.append(localizer.step(now_s))
    return estimates


def test_a_memory_that_contradicts_itself_does_not_contradict_the_moment():
    estimates = triangle_that_cannot_be(measured_now=True)
    assert all(estimate.verdict is Verdict.COVERED for estimate in estimates)
    assert all(estimate.conflicts == () for estimate in estimates)
    assert any(estimate.forgotten for estimate in estimates)


def test_a_memory_alone_that_contradicts_itself_is_forgotten():
    estimates = triangle_that_cannot_be(measured_now=False)
    assert all(estimate.verdict is None for estimate in estimates)
    assert estimates[0].forgotten and not estimates[-1].forgotten


@pytest.mark.parametrize('odometry_goes_on', [True, False])
def test_memory_answers_while_odometry_says_where_the_robots_go(odometry_goes_on):
    """Measurements have ended; when odometry ends as well, there is no answer."""
    localizer = localizer_of(('r', 's'), range_error=(-0.05, 0.05, 0.0, 0.0))
    for step in range(20):
        now_s = START_S + step * STEP_S
        if step < 10 or odometry_goes_on:
            for x_m, robot in enumerate('rs'):
                place_m = float(x_m), 0.1 * step
                add_odometry(localizer, robot, place_m, now_s, frame=f'{robot}/odom')
        if step < 10:
            localizer.add_range('r', 's', 1.0, now_s, now_s)
    assert bool(localizer.step(now_s).placements) is odometry_goes_on
