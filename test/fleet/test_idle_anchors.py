# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Anchors that nobody measures change nothing."""

import numpy as np
import pytest
from shapes import holds

from dg_localization import Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel

TRUTH = {'r0': (3.0, 2.0), 'r1': (6.5, 5.0)}
MAP = {f'a{k}': (1.7 * (k % 4), 2.9 * (k // 4) + 0.3 * (k % 3)) for k in range(12)}
SEEN = ('a1', 'a6', 'a9')


def localizer(anchors, bound_m):
    config = FleetConfig(
        robots=tuple(TRUTH),
        anchors={name: Anchor(MAP[name], bound_m) for name in anchors},
        range_error=RangeErrorModel(min_error_m=-0.1, max_error_m=0.1),
        max_age_s=1.0,
    )
    found = Localizer(config)
    for robot, place in TRUTH.items():
        for anchor in SEEN:
            apart = np.linalg.norm(np.subtract(place, MAP[anchor]))
            found.add_range(robot, anchor, float(apart) + 0.04, 1.0, 1.0)
    return found


@pytest.mark.parametrize('bound_m', [0.0, 0.02])
def test_idle_anchors_change_no_answer_and_keep_their_places(bound_m):
    estimate = localizer(MAP, bound_m).step(1.0)
    alone = localizer(SEEN, bound_m).step(1.0)
    assert estimate.verdict is alone.verdict is Verdict.COVERED
    (placement,), (other,) = estimate.placements, alone.placements
    assert placement.enclosure_m == pytest.approx(other.enclosure_m, abs=1e-9)
    assert placement.proved and other.proved
    assert holds(estimate, [*TRUTH.values()])
    landmarks = np.array([MAP[name] for name in estimate.landmarks])
    assert placement.landmarks_m == pytest.approx(landmarks, abs=bound_m + 1e-9)
    off = np.abs(placement.landmark_enclosure_m - landmarks[:, None])
    assert np.all(off <= bound_m + 1e-9)
