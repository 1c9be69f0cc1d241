# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Nothing older than the memory has an effect, and memory never withholds what is measured now."""

import math

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer

from dg_localization import Verdict

START_S, MEMORY_S, STEP_S = 100.0, 10.0, 0.2
ANCHORS_M = {'a': (0.0, 5.0), 'b': (0.0, -5.0), 'c': (8.0, 4.0)}
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
        anchors=ANCHORS_M,
        range_error=(-0.01, 0.01, -0.3, 0.3),
        window_outliers=outliers,
    )
    found = {}
    for step in range(80):
        since_s, now_s = step * STEP_S, START_S + step * STEP_S
        for robot, place_m in PLACES_M.items():
            add_odometry(localizer, robot, place_m, now_s, frame=f'{robot}/odom')
            off_m = first_error_m if since_s < 0.5 else 0.0
            add_ranges(localizer, robot, place_m, ANCHORS_M, now_s, off_m)
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
