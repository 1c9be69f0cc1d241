# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Five real robots with cameras among fifteen landmarks: the surveyed truth is never lost."""

from dataclasses import replace

import numpy as np
import pytest
from shapes import holds

from benchmarks.fleet_in_time import EXCERPT, Excerpt, answers, mrclam_config
from dg_localization.fleet.rotations import rotations_about_z

pytestmark = pytest.mark.filterwarnings('ignore:loadtxt')


def answered(shared, name, after_s, outliers=0, memory_s=30.0, **settings):
    """Yield the answers some seconds after the start, and whether the truth is in them."""
    excerpt = Excerpt(shared / 'data/mrclam', name)
    config = replace(mrclam_config(excerpt, outliers, memory_s), **settings)
    for now_s, estimate, _ in answers(excerpt, config, excerpt.events[0].stamp_s + after_s):
        places, yaws = excerpt.truth(now_s)
        yield estimate, holds(estimate, places, rotations_about_z(yaws))


def test_the_surveyed_truth_is_in_a_placement_at_every_tick(shared):
    after_s = np.arange(2.0, 30.0, 1.5)
    limits = {'max_speed_m_s': 0.2, 'max_turn_rate_rad_s': 0.6}
    for estimate, inside in answered(shared, 'excerpt_D7_t515_545', after_s, **limits):
        assert estimate.frame.kind == 'anchors'
        assert inside, estimate.stamp_s


@pytest.mark.parametrize(('outliers', 'width_m'), [(0, 4.5), (5, 6.0)])
def test_four_minutes_of_memory_bound_every_robot(shared, outliers, width_m):
    widths_m = []
    after_s = np.array([40.0, 70.0, 100.0, 130.0])
    for estimate, inside in answered(shared, EXCERPT, after_s, outliers, 60.0):
        # Some readings are gross errors.
        assert inside or not outliers, estimate.stamp_s
        widths_m.append(np.ptp(estimate.placements[0].enclosure_m, axis=1).max(axis=1))
        assert estimate.placements[0].heading_known.sum() >= 4
    assert np.isfinite(widths_m).all()
    assert np.median(widths_m) < width_m
