# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pose sets of earlier estimates: a robot is not lost while its odometry goes on."""

import math

from circling import ERROR, Circling
import numpy as np
import pytest
from sensing import anchors_at

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
