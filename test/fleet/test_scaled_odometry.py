# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Odometry that reports longer or shorter ways, and errs at its bound beside that."""

import math

import numpy as np
import pytest
from shapes import holds

from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
)

ANCHORS_M = {'a': (0.0, -3.0), 'b': (6.0, 4.0), 'c': (-2.0, 3.0)}
SPEED_M_S, PER_M, TICK_S = 0.3, 0.05, 0.1
SEEN_S = 6.0
"""Then it sees no anchor any more, and odometry alone says where it is."""


def drive(scale, side, stated):
    """Drive along a bend; yield the truth and the estimate of every second."""
    config = FleetConfig(
        ('r',),
        anchors={name: Anchor(place) for name, place in ANCHORS_M.items()},
        range_error=RangeErrorModel(min_error_relative=-0.002, max_error_relative=0.002),
        robot_odometry_error={'r': stated},
        max_age_s=0.3,
        max_speed_m_s=0.5,
        memory_max_seconds=math.inf,
    )
    localizer = Localizer(config)
    place, reported = np.zeros(2), np.zeros(2)
    for tick in range(1, 161):
        now_s, yaw = 100.0 + tick * TICK_S, 0.2 * tick * TICK_S
        ahead = np.array([math.cos(yaw), math.sin(yaw)])
        step_m = SPEED_M_S * TICK_S
        reported = reported + step_m * ahead
        place = place + scale * (1.0 + side * 0.999 * PER_M) * step_m * ahead
        orientation = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
        localizer.add_odometry('r', [*reported, 0.0], orientation, now_s, now_s)
        if tick * TICK_S <= SEEN_S:
            for name, anchor in ANCHORS_M.items():
                apart_m = float(np.linalg.norm(place - anchor))
                localizer.add_range('r', name, apart_m, now_s, now_s)
        if tick % 10 == 0:
            yield place, localizer.step(now_s)


@pytest.mark.parametrize('side', [-1.0, 0.0, 1.0])
@pytest.mark.parametrize('scale', [0.7, 1.0, 1.3])
def test_no_truth_is_lost_at_the_ends_of_the_bounds(scale, side):
    stated = OdometryErrorModel(translation_per_m=PER_M, translation_scale=scale)
    for place, estimate in drive(scale, side, stated):
        assert holds(estimate, place)
        assert not estimate.forgotten
    # Ten seconds of it without a look at anything.
    assert np.ptp(estimate.placements[0].enclosure_m[0], axis=0).max() < 2.5 * scale
