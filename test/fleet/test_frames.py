# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Frames of anchors and of odometry, mirror images, sides of anchors in line, what is not connected.

Without anchors the frame is the odometry frame of the reference robot, while that is known.
"""

import math

from circling import START_S, Circling
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, anchors_at, new_localizer
from shapes import holds, in_space, missing, turn

from dg_localization import Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel
from dg_localization.fleet.rotations import yaw_of
from dg_localization.simulation.moving_fleet import EDGES, ROBOTS, START_POSITIONS_M

NOW_S = 10.0
TIGHT = RangeErrorModel(min_error_relative=-1e-4, max_error_relative=1e-4)
SQUARE = {'a': (0.0, 0.0), 'b': (4.0, 0.0), 'c': (3.0, 3.0), 'd': (-1.0, 4.0)}


def make_localizer(robots, **settings):
    defaults = {
        'max_speed_m_s': 0.0,
        'max_turn_rate_rad_s': 0.0,
        'range_error': TIGHT,
        'bearing_half_width_rad': 0.01,
        'solver': {'resolution': 0.05, 'max_boxes': 200},
    }
    return new_localizer(robots, **{**defaults, **settings})


def range_pairs(localizer, places, pairs=None):
    names = list(places)
    pairs = pairs or [(a, b) for i, a in enumerate(names) for b in names[i + 1 :]]
    for first, second in pairs:
        add_ranges(localizer, first, places[first], {second: places[second]}, NOW_S)


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
    range_pairs(localizer, SQUARE)
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
    range_pairs(localizer, SQUARE)
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
    range_pairs(localizer, SQUARE)
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
    range_pairs(localizer, SQUARE)
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
    range_pairs(localizer, SQUARE)
    estimate = localizer.step(NOW_S)
    assert estimate.frame.points == ('a', 'd')
    assert 'reference robot lost is not connected: the frame is that of a' in estimate.reason
    assert estimate.n_hypotheses == 2
    for placement in estimate.placements:
        assert np.isnan(placement.positions_m[2]).all()
        assert placement.positions_m[3] == pytest.approx([0.0, 0.0])


def test_a_change_of_the_frame_is_announced_once():
    localizer = make_localizer(SQUARE)
    range_pairs(localizer, SQUARE)
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
    range_pairs(localizer, SQUARE)
    assert localizer.step(NOW_S).previous_frame == second.frame


FAR = {'e': (50.0, 50.0), 'f': (53.0, 50.0), 'g': (50.0, 54.0)}


def test_two_groups_have_a_frame_each():
    localizer = make_localizer([*SQUARE, *FAR, 'lost'])
    range_pairs(localizer, SQUARE)
    range_pairs(localizer, FAR)
    add_bearings(localizer, FAR, 'e', ['f', 'g'])
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
    assert not missing(placement, np.vstack([np.zeros((4, 2)), rows(FAR) - FAR['e'], [0.0, 0.0]]))


@pytest.mark.parametrize('beacons', [(), ('far', 'away')])
def test_what_a_limit_left_open_among_the_others_is_open_in_the_fleet(beacons):
    others = dict(zip(ROBOTS, START_POSITIONS_M, strict=True))
    localizer = make_localizer(
        ['first', 'second', *others],
        anchors={name: (90.0, float(x)) for x, name in enumerate(beacons)},
        range_error=(-0.05, 0.05, -0.03, 0.03),
        solver={'resolution': 0.01, 'max_boxes': 3},
    )
    range_pairs(localizer, {'first': (50.0, 0.0), 'second': (53.0, 0.0)})
    estimate = localizer.step(NOW_S)
    assert estimate.verdict is (None if beacons else Verdict.COVERED)
    assert 'its budget' not in estimate.reason
    range_pairs(localizer, others, [(ROBOTS[i], ROBOTS[j]) for i, j in EDGES])
    estimate = localizer.step(NOW_S)
    assert len(estimate.groups[-1].robots) == 6
    assert estimate.verdict is (None if beacons else Verdict.OUT_OF_BUDGET)
    assert 'the search stopped at its budget' in estimate.reason


def test_headings_that_contradict_rays_are_found_in_every_group():
    localizer = make_localizer([*SQUARE, *FAR])
    range_pairs(localizer, SQUARE)
    range_pairs(localizer, FAR)
    add_bearings(localizer, FAR, 'e', ['f'])
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
    range_pairs(localizer, CUBE)
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


def answer(anchors, places, peers=(), seen=(), bound_m=0.0, **settings):
    """Return the answer to ranges of robots to anchors, all or those seen, and to some peers."""
    rng = np.random.default_rng(5)
    localizer = new_localizer(
        places,
        anchors=anchors_at(anchors, bound_m),
        range_error=(-0.05, 0.05, 0.0, 0.0),
        memory_s=0.0,
        max_speed_m_s=0.0,
        **settings,
    )
    points = {**anchors, **places}
    links = [(robot, anchor) for robot in places for anchor in seen or anchors]
    for observer, target in (*links, *peers):
        aim = {target: points[target]}
        add_ranges(localizer, observer, points[observer], aim, 100.0, rng.uniform(-0.04, 0.04))
    return localizer.step(100.0)


def nearest_deviations(estimate, places):
    """Return how many deviations the best of the points is off on its worst axis."""
    truth_m = np.array(list(places.values()))
    found = []
    for one in estimate.placements:
        sigma_m = np.sqrt([np.diag(c)[: truth_m.shape[1]] for c in one.covariances])
        found.append(np.max(np.abs(one.positions_m - truth_m) / sigma_m))
    return min(found)


def n_holding(estimate, places):
    """Return how many placements have all robots in their enclosures."""
    return sum(not missing(one, [*places.values()]) for one in estimate.placements)


WALL = {'w0': (0.0, 0.0), 'w1': (5.0, 0.0), 'w2': (9.0, 0.0)}
CEILING = {'c0': (0, 0, 3), 'c1': (8, 0, 3), 'c2': (8, 6, 3), 'c3': (0, 6, 3)}


def bent(anchors, bump_m):
    """Return anchors in a line or a plane, the second one a little out of it."""
    name, place = [*anchors.items()][1]
    return {**anchors, name: (*place[:-1], place[-1] + bump_m)}


@pytest.mark.parametrize('bump_m', [1e-6, 1e-3, 0.03])
@pytest.mark.parametrize(
    ('anchors', 'place'),
    [(WALL, (3.0, -3.0)), (WALL, (3.0, 1.5)), (CEILING, (3.0, 2.0, 1.0))],
    ids=['below', 'above', 'under a ceiling'],
)
def test_each_side_of_anchors_nearly_in_line_or_in_a_plane_is_a_hypothesis(anchors, place, bump_m):
    estimate = answer(bent(anchors, bump_m), {'r': place}, dimension=len(place))
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert n_holding(estimate, {'r': place}) == 1
    assert nearest_deviations(estimate, {'r': place}) < 4.0
    low, high = np.array([one.enclosure_m[0, :, -1] for one in estimate.placements]).T
    at = anchors[next(iter(anchors))][-1]
    assert sorted(zip(low > at, high < at, strict=True)) == [(False, True), (True, False)]


def test_ranges_between_robots_leave_the_sides_that_agree():
    """Of four combinations of sides, two have the robots as far apart as they measured."""
    places = {'r': (3.0, 2.0), 's': (5.0, 3.0)}
    assert answer(bent(WALL, 0.002), places).n_hypotheses == 4
    estimate = answer(bent(WALL, 0.002), places, peers=[('r', 's')])
    assert estimate.n_hypotheses == len(estimate.placements) == 2
    assert n_holding(estimate, places) == 1


def test_one_place_is_one_hypothesis():
    """Where the robot is near the line, or the anchors are far from one, the places touch."""
    assert answer(bent(WALL, 1e-3), {'r': (3.0, 0.1)}).n_hypotheses == 1
    hall = {'a': (0.0, 0.0), 'b': (9.0, 0.0), 'c': (0.0, 7.0)}
    assert answer(hall, {'r': (3.0, 2.0), 's': (6.0, 5.0)}).n_hypotheses == 1


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_one_anchor_off_the_line_is_found_among_many(dimension):
    """In space one is off in each direction. Anchors that may be anywhere near tell no side."""
    anchors = {f'w{k}': (0.5 * k, 0.3 * (k == 21), 0.3 * (k == 22)) for k in range(28)}
    anchors = {name: place[:dimension] for name, place in anchors.items()}
    places = {'r': (10.0, -4.0, -3.0)[:dimension]}
    for bound_m in (0.0, 0.01):
        estimate = answer(anchors, places, bound_m=bound_m, dimension=dimension)
        assert estimate.n_hypotheses == n_holding(estimate, places) == 1
    assert answer(anchors, places, bound_m=0.4, dimension=dimension).n_hypotheses == 2


TRUTH = {'r0': (3.0, 2.0), 'r1': (6.5, 5.0)}
MAP = {f'a{k}': (1.7 * (k % 4), 2.9 * (k // 4) + 0.3 * (k % 3)) for k in range(12)}
SEEN = ('a1', 'a6', 'a9')


@pytest.mark.parametrize('bound_m', [0.0, 0.02])
def test_idle_anchors_change_no_answer_and_keep_their_places(bound_m):
    estimate = answer(MAP, TRUTH, seen=SEEN, bound_m=bound_m)
    alone = answer({name: MAP[name] for name in SEEN}, TRUTH, bound_m=bound_m)
    assert estimate.verdict is alone.verdict is Verdict.COVERED
    (placement,), (other,) = estimate.placements, alone.placements
    assert placement.enclosure_m == pytest.approx(other.enclosure_m, abs=1e-9)
    assert placement.proved and other.proved
    assert holds(estimate, [*TRUTH.values()])
    landmarks = np.array([MAP[name] for name in estimate.landmarks])
    assert placement.landmarks_m == pytest.approx(landmarks, abs=bound_m + 1e-9)
    off = np.abs(placement.landmark_enclosure_m - landmarks[:, None])
    assert np.all(off <= bound_m + 1e-9)


def circling_fleet(**settings):
    defaults = {'odometry_frame': 'odom', 'cameras': True, 'bearing_half_width_rad': 0.02}
    return Circling(3, **{**defaults, 'max_age_s': 0.5, **settings})


def drive(fleet, seconds, **measured):
    return fleet.drive(seconds, every_s=0.5, **measured)


def test_in_the_frame_a_robot_is_where_its_messages_say_however_they_are_scaled():
    error = OdometryErrorModel(
        translation_per_m=0.02, rotation_per_rad=0.02, translation_scale=0.8
    )
    fleet = circling_fleet(odometry_error=error)
    fleet.scale = 0.8
    for estimate in drive(fleet, 5.0):
        assert estimate.frame.name == 'odom'
        places, _ = fleet.poses()
        # The newest odometry states where the robot is; all else is as far from it as it truly is.
        assert holds(estimate, places + places[0] / 0.8 - places[0])
        (placement,) = estimate.placements
        assert np.ptp(placement.enclosure_m[0], axis=0).max() < 1e-6


def test_coordinates_do_not_jump_when_the_bearings_stop():
    fleet = circling_fleet()
    *_, last = drive(fleet, 5.0)
    assert str(last.frame) == 'odometry frame odom of r0'
    assert last.placements[0].heading_known.all()
    assert np.all(np.ptp(last.placements[0].enclosure_m, axis=1) < 1.0)
    # The robots go on to range each other; with what they remember that is enough.
    for estimate in drive(fleet, 40.0, bearings=False):
        assert estimate.frame == last.frame
        (placement,) = fleet.holding(estimate)
        step_m = placement.positions_m - last.placements[0].positions_m
        assert np.abs(step_m).max() < 0.7
        last = estimate


def test_the_frame_does_not_come_and_go_with_the_odometry():
    fleet = circling_fleet(max_age_s=0.3)
    assert [e.frame.kind for e in drive(fleet, 1.0)] == ['odometry', 'odometry']
    for _ in range(8):
        for odometry in (None, ('r1', 'r2')):
            (estimate,) = drive(fleet, 0.5, odometry=odometry)
            assert estimate.frame.kind == 'odometry' and estimate.frame_changes == 0
            assert fleet.holding(estimate)
    # Two seconds without it are too many, and two with it bring it back.
    kinds = [e.frame.kind for e in drive(fleet, 3.0, odometry=('r1', 'r2'))]
    assert kinds == ['odometry'] * 2 + ['heading'] * 4
    estimates = list(drive(fleet, 3.0))
    assert [e.frame.kind for e in estimates[:4]] == ['heading'] * 4
    assert estimates[-1].frame.kind == 'odometry' and estimates[-1].frame_changes == 2


@pytest.mark.parametrize('name', ['odom', ''])
def test_a_frame_is_kept_for_two_seconds_without_a_heading(name):
    fleet = circling_fleet(memory_s=0.0, odometry_frame=name)
    *_, before = drive(fleet, 2.0)
    kinds, changes = [], 0
    for estimate in drive(fleet, 4.0, bearings=False):
        kinds.append(str(estimate.frame.kind))
        changes += bool(estimate.frame_change)
        if name and estimate.frame == before.frame:
            places, _ = fleet.poses()
            off_m = [np.abs(one.positions_m - places).max() for one in fleet.holding(estimate)]
            assert min(off_m) < 1.0
    assert kinds == [str(before.frame.kind)] * 4 + ['robots'] * 4
    assert changes == estimate.frame_changes == 1


def test_odometry_that_starts_anew_has_another_frame():
    fleet = circling_fleet()
    *_, before = drive(fleet, 2.0)
    fleet.started_m = np.array([30.0, 0.0])
    estimates = list(drive(fleet, 4.0))
    changes = [e.frame_change for e in estimates if e.frame_change]
    assert {e.frame.kind for e in estimates[:3]} == {'heading'}
    assert {e.frame.kind for e in estimates[5:]} == {'odometry'}
    assert len(changes) == 2
    assert f'frame odom of r0, started anew at {START_S + 2.25:.3f} s now' in changes[1]
    assert estimates[-1].frame != before.frame
    assert estimates[-1].placements[0].positions_m[0] == pytest.approx(
        fleet.poses()[0][0] + fleet.started_m, abs=0.2
    )


@pytest.mark.parametrize(('tilt_rad', 'kind'), [(0.15, 'odometry'), (0.25, 'heading')])
def test_a_tilted_odometry_frame_does_not_fit_the_plane(tilt_rad, kind):
    localizer = new_localizer(('a', 'b'))
    orientation = [math.sin(tilt_rad / 2.0), 0.0, 0.0, math.cos(tilt_rad / 2.0)]
    localizer.add_odometry('a', [1.0, 2.0, 3.0], orientation, START_S, START_S, 'odom')
    localizer.add_range('a', 'b', 3.0, START_S, START_S)
    localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], START_S, START_S)
    assert localizer.step(START_S).frame.kind == kind


def test_late_odometry_may_state_where_the_robot_was_or_will_be():
    localizer = new_localizer(
        ('a', 'b'), max_speed_m_s=0.5, odometry_error=OdometryErrorModel(latency_s=0.2)
    )
    add_odometry(localizer, 'a', (1.0, 2.0), START_S, frame='odom')
    localizer.add_range('a', 'b', 3.0, START_S, START_S)
    localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], START_S, START_S)
    (placement,) = localizer.step(START_S).placements
    assert np.all(np.ptp(placement.enclosure_m[0], axis=0) >= 2 * 0.5 * 0.2)


def test_old_odometry_widens_the_answer():
    widths_m = []
    for age_s in (0.0, 0.2):
        localizer = new_localizer(('a', 'b'), max_speed_m_s=0.5, max_turn_rate_rad_s=1.0)
        now_s = START_S + age_s
        add_odometry(localizer, 'a', (1.0, 2.0), START_S, 0.5, frame='odom')
        localizer.add_range('a', 'b', 3.0, now_s, now_s)
        localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], now_s, now_s)
        localizer.add_bearing('b', 'a', [1.0, 0.0, 0.0], now_s, now_s)
        estimate = localizer.step(now_s)
        (placement,) = estimate.placements
        assert estimate.frame.kind == 'odometry'
        assert age_s + 0.05 < placement.heading_half_width_rad[1] < age_s + 0.3
        assert placement.heading_half_width_rad[0] == pytest.approx(age_s, abs=1e-6)
        assert np.ptp(placement.enclosure_m[0], axis=0) == pytest.approx(2 * 0.5 * age_s)
        assert placement.positions_m[0] == pytest.approx([1.0, 2.0])
        covariance = placement.covariances[0]
        assert covariance[5, 5] == pytest.approx(age_s**2, abs=1e-6)
        assert np.diag(covariance)[:2] == pytest.approx((0.5 * age_s) ** 2, abs=1e-6)
        along = [math.cos(0.5), math.sin(0.5)]
        assert placement.positions_m[1] == pytest.approx(
            [1.0 + 3.0 * along[0], 2.0 + 3.0 * along[1]], abs=0.1
        )
        widths_m.append(np.ptp(placement.enclosure_m[1], axis=0).max())
    assert widths_m[1] > widths_m[0] + 2 * 3.0 * math.cos(0.5) * 0.19
