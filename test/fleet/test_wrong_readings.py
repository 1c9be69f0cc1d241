# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""With as many wrong readings as a window tolerates, the truth is never lost."""

import math
import os

from histories import History, localizer_of, truth_is_inside
from hypothesis import given, settings, strategies as st
import numpy as np
import pytest

from dg_localization import Verdict
from dg_localization.fleet import Anchor, FleetConfig, Localizer, RangeErrorModel

HISTORIES = int(os.environ.get('DG_HISTORIES', '30'))
SECONDS = 6.0


def draw_lies(history, wrong, agreeing):
    """Draw by how much observations are off; those that agree are of one pair, and off alike."""
    rng = np.random.default_rng(wrong)
    observed = history.observed
    if agreeing:
        pair = observed[rng.integers(len(observed))][:2]
        observed = [one for one in observed if one[:2] == pair]
        first = rng.integers(len(observed))
        return dict.fromkeys(observed[first : first + wrong], rng.uniform(-4.0, 4.0))
    chosen = rng.choice(len(observed), min(wrong, len(observed)), replace=False)
    return {observed[k]: rng.uniform(-4.0, 4.0) for k in chosen}


@settings(max_examples=HISTORIES, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    robots=st.integers(2, 4),
    mounted=st.sampled_from([0, 0, 1, 2]),
    anchors=st.sampled_from([0, 0, 2, 3]),
    memory_s=st.sampled_from([3.0, 30.0]),
    wrong=st.sampled_from([1, 2, 5]),
    agreeing=st.booleans(),
)
def test_the_truth_is_never_lost(seed, robots, mounted, anchors, memory_s, wrong, agreeing):
    history = History.draw(
        seed, robots, anchors, SECONDS, mounted, memory_s=memory_s, window_outliers=wrong
    )
    # The tolerance needs odometry of all robots to cover everything.
    if len(history.with_odometry) < robots or not history.observed:
        return
    history.lies = draw_lies(history, wrong, agreeing)
    for time_s, estimate in history.play(localizer_of(history), [1.5, 3.0, 4.5, 6.0]):
        assert estimate.verdict is not Verdict.INFEASIBLE, estimate.reason
        assert not estimate.forgotten
        assert truth_is_inside(history, time_s, estimate), (time_s, history.lies)


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
