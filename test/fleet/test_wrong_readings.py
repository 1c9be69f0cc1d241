# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The first readings of a pair may be wrong as well as later ones."""

import math

import numpy as np
import pytest

from dg_localization import Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel


@pytest.mark.parametrize('others', [False, True], ids=['nothing', 'others'])
def test_the_first_readings_of_a_pair_are_not_trusted_either(others):
    """They are stamped after the answer: of the pair nothing is remembered by then."""
    places_m = {'r0': (3.0, 2.0), 'r1': (4.0, 5.0)}
    anchors_m = {'west': (0.0, 0.0), 'east': (10.0, 0.0), 'north': (4.0, 8.0)}
    localizer = Localizer(
        FleetConfig(
            robots=tuple(places_m),
            anchors={name: Anchor(place_m) for name, place_m in anchors_m.items()},
            range_error=RangeErrorModel(min_error_m=-0.1, max_error_m=0.1),
            window_outliers=1,
        )
    )

    def measure(robot, stamp_s, off_m=0.0):
        for name, place_m in anchors_m.items():
            range_m = math.dist(place_m, places_m[robot]) + off_m * (name == 'west')
            assert localizer.add_range(robot, name, range_m, stamp_s, stamp_s) is None

    stamps_s = 100.0 + 0.1 * np.arange(20)
    for stamp_s in stamps_s:
        for robot in places_m:
            localizer.add_odometry(robot, (0, 0, 0), (0, 0, 0, 1), stamp_s, stamp_s, robot)
        if others:
            measure('r1', stamp_s)
    measure('r0', stamp_s + 0.05, off_m=1.0)
    estimate = localizer.step(localizer.answer_time(stamp_s + 0.06))
    assert estimate.stamp_s == stamp_s and estimate.verdict is not Verdict.INFEASIBLE
    assert not estimate.forgotten
    for placement in estimate.placements:
        low, high = placement.enclosure_m[0]
        assert np.all((low <= places_m['r0']) & (places_m['r0'] <= high))
    assert bool(estimate.placements) is others
