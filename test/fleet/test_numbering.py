# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses keep their numbers, in whatever order they come."""

import numpy as np
import pytest

from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel
from dg_localization.fleet.window.follow import Framed, matches

STAMP_S = 10.0


def reading_fleet(robots, anchors, places_m):
    """Return a localizer that has heard every range, and its estimate."""
    config = FleetConfig(
        robots=robots,
        anchors=anchors,
        range_error=RangeErrorModel(min_error_m=-0.01, max_error_m=0.01),
    )
    localizer = Localizer(config)
    for row, first in enumerate(places_m):
        for second in list(places_m)[row + 1 :]:
            if not (first in anchors and second in anchors):
                distance_m = float(np.linalg.norm(places_m[first] - places_m[second]))
                localizer.add_range(first, second, distance_m, STAMP_S, STAMP_S)
    snapshot = localizer.snapshot(STAMP_S)
    return snapshot, localizer.estimate(snapshot)


@pytest.fixture
def twins():
    """Return what is heard of a robot between two anchors, and where it may be."""
    anchors = {'p': Anchor((0.0, 0.0)), 'q': Anchor((4.0, 0.0))}
    places_m = {'p': np.zeros(2), 'q': np.array([4.0, 0.0]), 'a': np.array([1.0, 2.0])}
    return reading_fleet(('a',), anchors, places_m)


def test_twins_beside_two_anchors_keep_their_numbers(twins):
    """They have one shape, so that only their positions tell them apart."""
    snapshot, estimate = twins
    first, second = (Framed(one, estimate.frame) for one in estimate.placements)
    assert matches(snapshot, STAMP_S, [first, second], [second, first]) == {0: 1, 1: 0}
