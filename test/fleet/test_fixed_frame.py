# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Fixed frames, mirror images, headings, and what is not connected, where the answer is known."""

import math

import numpy as np
import pytest
import sensing
from sensing import new_localizer
from shapes import in_space, missing, turn

from dg_localization import Verdict
from dg_localization.fleet import RangeErrorModel
from dg_localization.fleet.rotations import yaw_of
from dg_localization.simulation.moving_fleet import EDGES, ROBOTS, START_POSITIONS_M

NOW_S = 10.0
TIGHT = RangeErrorModel(min_error_relative=-1e-4, max_error_relative=1e-4)
SQUARE = {'a': (0.0, 0.0), 'b': (4.0, 0.0), 'c': (3.0, 3.0), 'd': (-1.0, 4.0)}


def make_localizer(robots, **settings):
    defaults = {
        'robots': tuple(robots),
        'max_speed_m_s': 0.0,
        'max_turn_rate_rad_s': 0.0,
        'range_error': TIGHT,
        'bearing_half_width_rad': 0.01,
        'solver': {'resolution': 0.05, 'max_boxes': 200},
    }
    return new_localizer(**{**defaults, **settings})


def add_ranges(localizer, places, pairs=None):
    names = list(places)
    pairs = pairs or [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for first, second in pairs:
        sensing.add_ranges(localizer, first, places[first], {second: places[second]}, NOW_S)


def add_bearings(localizer, places, observer, targets, yaw=0.0):
    for target in targets:
        seen = turn(2, -yaw) @ in_space(np.subtract(places[target], places[observer]))
        assert localizer.add_bearing(observer, target, seen, NOW_S, NOW_S) is None


def rows(places):
    return np.array(list(places.values()))


def assert_holds(placement, positions):
    """The truth is inside, and what is published is close to it."""
    assert not missing(placement, positions)
    assert np.abs(placement.positions_m - positions).max() < 0.05


def test_without_bearings_both_mirror_images_are_there():
    localizer = make_localizer(SQUARE)
    add_ranges(localizer, SQUARE)
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is Verdict.COVERED
    assert str(estimate.frame) == 'origin at a, x towards b'
    original, twin = estimate.placements
    assert (original.mirrored, twin.mirrored) == (False, True)
    assert_holds(original, rows(SQUARE))
    assert_holds(twin, rows(SQUARE) * [1.0, -1.0])
    assert original.proved
    assert not original.flexible
    assert not original.heading_known.any()
    assert np.isnan(original.orientations_xyzw).all()


def test_one_robot_that_sees_two_rules_the_mirror_image_out():
    localizer = make_localizer(SQUARE)
    add_ranges(localizer, SQUARE)
    add_bearings(localizer, SQUARE, 'c', ['a', 'b'], yaw=0.4)
    estimate = localizer.step(NOW_S)
    (placement,) = estimate.placements
    assert str(estimate.frame) == 'origin at a, x towards b'
    assert_holds(placement, rows(SQUARE))
    assert placement.heading_known.tolist() == [False, False, True, False]
    assert yaw_of(placement.orientations_xyzw[2]) == pytest.approx(0.4, abs=0.05)
    assert 0.0 < placement.heading_half_width_rad[2] < 0.05


@pytest.mark.parametrize('yaw', [0.0, 0.7, -2.5, math.pi])
def test_the_heading_of_the_reference_robot_is_the_x_axis(yaw):
    localizer = make_localizer(SQUARE)
    add_ranges(localizer, SQUARE)
    add_bearings(localizer, SQUARE, 'a', ['b', 'c', 'd'], yaw + 0.0099)  # within what rays may err
    estimate = localizer.step(NOW_S)
    (placement,) = estimate.placements
    assert str(estimate.frame) == 'body frame of a'
    cosine, sine = math.cos(yaw), math.sin(yaw)
    assert_holds(placement, rows(SQUARE) @ np.array([[cosine, -sine], [sine, cosine]]))
    assert placement.orientations_xyzw[0].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert placement.heading_half_width_rad[0] == 0.0


def test_a_fleet_away_from_the_anchors_has_no_place():
    localizer = make_localizer(SQUARE, anchors={'p': (10.0, 10.0), 'q': (-5.0, 9.0)})
    add_ranges(localizer, SQUARE)
    estimate = localizer.step(NOW_S)
    assert estimate.placements == ()
    assert estimate.verdict is None
    assert 'no robot is connected to the anchors p, q' in estimate.reason
    (group,) = estimate.groups
    assert str(group.frame) == 'origin at a, x towards b'
    for placement, sign in zip(group.placements, (1.0, -1.0), strict=True):
        assert_holds(placement, rows(SQUARE) * [1.0, sign])


def test_the_next_robot_stands_in_for_a_silent_reference_robot():
    localizer = make_localizer(['b', 'c', 'lost', 'a', 'd'], reference_robot='lost')
    add_ranges(localizer, SQUARE)
    estimate = localizer.step(NOW_S)
    assert estimate.frame.points == ('a', 'd')
    assert 'reference robot lost is not connected: the frame is that of a' in estimate.reason
    assert estimate.n_hypotheses == 2
    for placement in estimate.placements:
        assert np.isnan(placement.positions_m[2]).all()
        assert placement.positions_m[3] == pytest.approx([0.0, 0.0])


def test_a_change_of_the_frame_is_announced_once():
    localizer = make_localizer(SQUARE)
    add_ranges(localizer, SQUARE)
    first = localizer.step(NOW_S)
    assert first.previous_frame is None and first.frame_change == ''
    add_bearings(localizer, SQUARE, 'a', ['b', 'c'])
    second = localizer.step(NOW_S)
    assert second.previous_frame == first.frame != second.frame
    assert second.frame_change == (
        'the frame has changed: origin at a, x towards b before, body frame of a now'
    )
    assert localizer.step(NOW_S).previous_frame is None
    # What is published afterwards must not turn silently either.
    localizer.reset()
    assert localizer.step(NOW_S).frame_change == ''
    add_ranges(localizer, SQUARE)
    assert localizer.step(NOW_S).previous_frame == second.frame


def test_two_groups_have_a_frame_each():
    far = {'e': (50.0, 50.0), 'f': (53.0, 50.0), 'g': (50.0, 54.0)}
    localizer = make_localizer([*SQUARE, *far, 'lost'])
    add_ranges(localizer, SQUARE)
    add_ranges(localizer, far)
    add_bearings(localizer, far, 'e', ['f', 'g'])
    estimate = localizer.step(NOW_S)
    assert str(estimate.frame) == 'origin at a, x towards b'
    assert 'not connected: lost; in a frame of their own: e, f, g' in estimate.reason
    for placement in estimate.placements:
        assert np.isnan(placement.positions_m[4:]).all()
    (group,) = estimate.groups
    assert (group.robots, str(group.frame)) == (('e', 'f', 'g'), 'body frame of e')
    assert group.n_hypotheses == 1
    (placement,) = group.placements
    assert np.isnan(placement.positions_m[:4]).all()
    assert not missing(placement, np.vstack([np.zeros((4, 2)), rows(far) - far['e'], [0.0, 0.0]]))


@pytest.mark.parametrize('beacons', [(), ('far', 'away')])
def test_what_a_limit_left_open_among_the_others_is_open_in_the_fleet(beacons):
    others = dict(zip(ROBOTS, START_POSITIONS_M, strict=True))
    localizer = make_localizer(
        ['first', 'second', *others],
        anchors={name: (90.0, float(x)) for x, name in enumerate(beacons)},
        range_error=(-0.05, 0.05, -0.03, 0.03),
        solver={'resolution': 0.01, 'max_boxes': 3},
    )
    add_ranges(localizer, {'first': (50.0, 0.0), 'second': (53.0, 0.0)})
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is (None if beacons else Verdict.COVERED)
    assert 'its budget' not in estimate.reason
    add_ranges(localizer, others, [(ROBOTS[i], ROBOTS[j]) for i, j in EDGES])
    estimate = localizer.step(NOW_S)
    assert len(estimate.groups[-1].robots) == 6
    assert estimate.verdict is (None if beacons else Verdict.OUT_OF_BUDGET)
    assert 'the search stopped at its budget' in estimate.reason


def test_headings_that_contradict_rays_are_found_in_every_group():
    far = {'e': (50.0, 50.0), 'f': (53.0, 50.0), 'g': (50.0, 54.0)}
    localizer = make_localizer([*SQUARE, *far])
    add_ranges(localizer, SQUARE)
    add_ranges(localizer, far)
    add_bearings(localizer, far, 'e', ['f'])
    localizer.add_bearing('e', 'g', (1.0, 0.0, 0.0), NOW_S, NOW_S)
    assert localizer.step(NOW_S).verdict is Verdict.INFEASIBLE


CUBE = {
    'a': (0.0, 0.0, 0.0),
    'b': (4.0, 0.0, 0.0),
    'c': (1.0, 3.0, 0.0),
    'd': (2.0, 1.0, 3.0),
    'e': (-1.0, 2.0, -2.0),
}


def test_in_space_two_rays_fix_a_heading_and_three_the_chirality():
    localizer = make_localizer(CUBE, dimension=3)
    add_ranges(localizer, CUBE)
    add_bearings(localizer, CUBE, 'b', ['a', 'c'])
    add_bearings(localizer, CUBE, 'a', ['b', 'c'])
    estimate = localizer.step(NOW_S)
    assert estimate.frame.kind == 'heading'
    assert len(estimate.placements) == 2
    original = next(p for p in estimate.placements if p.positions_m[3, 2] > 0)
    assert_holds(original, rows(CUBE))
    assert original.heading_known.tolist() == [True, True, False, False, False]
    assert original.orientations_xyzw[1] == pytest.approx([0.0, 0.0, 0.0, 1.0], abs=0.05)
    add_bearings(localizer, CUBE, 'd', ['a', 'b', 'c'])
    (placement,) = localizer.step(NOW_S).placements
    assert_holds(placement, rows(CUBE))
