# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A beacon that is always wrong is named and dropped; first readings may be wrong, too."""

import numpy as np
import pytest
from sensing import add_odometry, add_ranges, new_localizer
from shapes import holds, missing

from dg_localization import Verdict

TICKS = 12
ANCHORS_M = {
    'b1': (0.0, 0.0, 0.1),
    'b2': (8.0, 0.5, 2.0),
    'b3': (0.5, 6.0, 3.0),
    'b4': (8.0, 6.5, 0.4),
    'b5': (4.0, -3.0, 1.7),
}


def estimates(
    wrong, *, error_m=1.5, n_anchors=4, dimension=2, speed_m_s=0.2, from_tick=0, **settings
):
    """Yield estimates of a robot with odometry, and where it truly is."""
    anchors_m = {name: place[:dimension] for name, place in [*ANCHORS_M.items()][:n_anchors]}
    localizer = new_localizer(
        ('r1',),
        dimension=dimension,
        anchors=anchors_m,
        range_error=(-0.05, 0.3, 0.0, 0.0),
        max_speed_m_s=0.5,
        **settings,
    )
    for tick in range(TICKS):
        for step in range(5):
            now_s = 1000.0 + 0.5 * tick + 0.1 * step
            place = np.array([2.0 + speed_m_s * (now_s - 1000.0), 2.0, 0.0])
            for name, anchor_m in anchors_m.items():
                off_m = error_m if name == wrong and tick >= from_tick else 0.05
                add_ranges(localizer, 'r1', place[:dimension], {name: anchor_m}, now_s, off_m)
            add_odometry(localizer, 'r1', place, now_s)
        yield localizer.step(now_s), place[:dimension]


@pytest.mark.parametrize(
    'case',
    [
        {'wrong': 'b2'},
        {'wrong': 'b3', 'speed_m_s': 0.0},
        {'wrong': 'b1', 'n_anchors': 5, 'error_m': -1.2},
        {'wrong': 'b2', 'n_anchors': 5, 'dimension': 3},
        {'wrong': 'b2', 'window_outliers': 1},
        {'wrong': 'b4', 'max_outliers': 2},
        {'wrong': 'b2', 'memory_s': 0.0},
    ],
)
def test_it_is_dropped_at_every_tick(case):
    for estimate, place in estimates(**{'max_outliers': 1, **case}):
        assert estimate.placements
        assert holds(estimate, place)
        assert any(case['wrong'] in str(suspect) for suspect in estimate.suspects)


def test_it_is_named_where_nothing_may_be_dropped():
    for estimate, _ in estimates('b2'):
        assert estimate.verdict is Verdict.INFEASIBLE
        assert 'range r1->b2' in map(str, estimate.suspects)


def test_what_was_remembered_before_it_went_wrong_stays():
    widths_m = []
    for tick, (estimate, place) in enumerate(estimates('b2', from_tick=6, max_outliers=1)):
        assert holds(estimate, place)
        if tick >= 6:
            assert any('b2' in str(suspect) for suspect in estimate.suspects)
        widths_m.append(float(np.ptp(estimate.placements[0].enclosure_m, axis=1).max()))
    assert max(widths_m[6:]) < 3.0 * max(widths_m[:6])


@pytest.mark.parametrize('others', [False, True], ids=['nothing', 'others'])
def test_the_first_readings_of_a_pair_are_not_trusted_either(others):
    """They are stamped after the answer, before anything of the pair is remembered."""
    places_m = {'r0': (3.0, 2.0), 'r1': (4.0, 5.0)}
    anchors_m = {'west': (0.0, 0.0), 'east': (10.0, 0.0), 'north': (4.0, 8.0)}
    localizer = new_localizer(
        tuple(places_m),
        anchors=anchors_m,
        range_error=(-0.1, 0.1, -0.03, 0.03),
        window_outliers=1,
    )

    stamps_s = 100.0 + 0.1 * np.arange(20)
    for stamp_s in stamps_s:
        for robot in places_m:
            add_odometry(localizer, robot, (0.0, 0.0), stamp_s, frame=robot)
        if others:
            add_ranges(localizer, 'r1', places_m['r1'], anchors_m, stamp_s)
    for name, anchor_m in anchors_m.items():
        target, off_m = {name: anchor_m}, float(name == 'west')
        add_ranges(localizer, 'r0', places_m['r0'], target, stamp_s + 0.05, off_m)
    estimate = localizer.step(localizer.answer_time(stamp_s + 0.06))
    assert estimate.stamp_s == stamp_s and estimate.verdict is not Verdict.INFEASIBLE
    assert not estimate.forgotten
    assert not any(missing(one, [*places_m.values()]) for one in estimate.placements)
    assert bool(estimate.placements) is others
