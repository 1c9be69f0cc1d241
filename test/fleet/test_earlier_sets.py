# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pose sets of earlier estimates: a robot is not lost while its odometry goes on."""

import math

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from shapes import holds, turn

ANCHORS = {'a': (0.0, 0.0), 'b': (12.0, 0.0), 'c': (12.0, 9.0), 'd': (0.0, 9.0)}
START_S = 100.0
ERROR = 0.02
STATED = {'translation_per_m': ERROR, 'rotation_per_rad': ERROR}


def pose(time_s):
    """Return the true pose of a robot that drives a circle."""
    angle = 0.1 * time_s
    return np.array([6.0 + 2.5 * math.sin(angle), 4.5 - 2.5 * math.cos(angle)]), angle


def odometry(time_s):
    """Return what odometry says: all ways and turns are too long by the same share."""
    angle = 0.1 * time_s * (1.0 + 0.5 * ERROR)
    radius = 2.5 * (1.0 + 0.3 * ERROR)
    return (radius * math.sin(angle), -radius * math.cos(angle)), angle


def restarted(place, yaw):
    """Return a pose of odometry in another frame, far away."""
    return turn(2, 2.0)[:2, :2] @ place + [90.0, -40.0], yaw + 2.0


def drive(
    memory_s, ranged, end_s, tick_s=1.0, restart_s=math.inf, odometry=odometry, error=STATED
):
    """Yield times and estimates of a robot that ranges anchors while `ranged`."""
    localizer = new_localizer(
        ('r',),
        anchors=ANCHORS,
        range_error=(-0.1, 0.1, 0.0, 0.0),
        max_speed_m_s=1.0,
        max_turn_rate_rad_s=0.5,
        odometry_error=error,
        memory_s=memory_s,
        memory_max_seconds=math.inf,
    )
    for step in range(round(end_s / 0.2)):
        time_s = 0.2 * step
        now_s = START_S + time_s
        place, yaw = odometry(time_s)
        if time_s >= restart_s:
            place, yaw = restarted(place, yaw)
        add_odometry(localizer, 'r', place, now_s, yaw, frame='odom')
        if ranged(time_s):
            add_ranges(localizer, 'r', pose(time_s)[0], ANCHORS, now_s)
        if step % round(tick_s / 0.2) == 0:
            yield time_s, localizer.step(now_s)


@pytest.mark.parametrize('memory_s', [5.0, 15.0])
def test_a_gap_of_any_length_is_bridged_by_odometry(memory_s):
    gap_s = 4.0 * memory_s
    widths = []
    for time_s, estimate in drive(memory_s, lambda t: t < 10.0, 10.0 + gap_s):
        if time_s < 5.0:
            continue
        (placement,) = estimate.placements
        assert holds(estimate, pose(time_s)[0]), time_s
        widths.append(np.ptp(placement.enclosure_m[0], axis=0).max())
    # Its greatest speed alone allows this much in both directions.
    assert max(widths) < 0.25 * 2.0 * gap_s


@pytest.mark.parametrize('restart_s', [math.inf, 7.0, 15.0])
def test_the_likely_point_is_carried_through_a_gap(restart_s):
    """Also where odometry starts anew in another frame: the limits bound the motion to it."""
    for time_s, estimate in drive(5.0, lambda t: t < 10.0, 40.0, 1.0, restart_s):
        if time_s < 10.0:
            continue
        (placement,) = estimate.placements
        assert holds(estimate, pose(time_s)[0]), time_s
        off_m = np.linalg.norm(placement.positions_m[0] - pose(time_s)[0])
        assert off_m < (0.2 if restart_s == math.inf else 0.6), time_s
        deviation_m = math.sqrt(np.linalg.eigvalsh(placement.covariances[0][:2, :2])[-1])
        assert off_m < 3.0 * deviation_m


@pytest.mark.parametrize('tick_s', [1.0, 7.0, 11.0])
def test_a_set_that_odometry_does_not_reach_any_more_claims_nothing(tick_s):
    """Answers that are asked for less often than memory lasts, without readings in between."""

    def ranged(time_s):
        return time_s < 8.0 or time_s > 27.0

    for time_s, estimate in drive(5.0, ranged, 34.0, tick_s):
        assert holds(estimate, pose(time_s)[0]) or not estimate.placements, time_s
    assert len(estimate.placements) == 1


@pytest.mark.parametrize('side', [-1.0, 0.0, 1.0])
@pytest.mark.parametrize('scale', [0.7, 1.0, 1.3])
def test_odometry_that_is_scaled_and_errs_at_its_bound_loses_no_truth(scale, side):
    error = {'translation_per_m': 0.05, 'translation_scale': scale}

    def stated(time_s):
        radius, angle = 2.5 / (scale * (1.0 + 0.0499 * side)), 0.1 * time_s
        return (radius * math.sin(angle), -radius * math.cos(angle)), angle

    for time_s, estimate in drive(30.0, lambda t: t < 6.0, 16.0, odometry=stated, error=error):
        assert holds(estimate, pose(time_s)[0])
        assert not estimate.forgotten
    # Ten seconds of it without a look at anything.
    assert np.ptp(estimate.placements[0].enclosure_m[0], axis=0).max() < 2.5 * scale
