# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What robots measured before they moved: mirror images go, headings come, contradictions pass.

Earlier sets carry a robot on; nothing older than the memory counts or withholds an answer.
"""

from dataclasses import replace
import math
from threading import Event

from circling import ERROR, START_S, Circling
import numpy as np
import pytest
from sensing import add_odometry, add_ranges, anchors_at, new_localizer

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import OdometryErrorModel, RangeErrorModel
from dg_localization.fleet.constraints.constrain import constrain
from dg_localization.fleet.frames.finders import fit_with_past
from dg_localization.fleet.frames.plan import plan_frames
from dg_localization.fleet.rotations import yaw_of
from dg_localization.fleet.window.forgetting import CONFIRMING, Doubts
from dg_localization.fleet.window.memory import WORLD

NOISE = 0.02
TWO = anchors_at({'a': (-4.0, -3.0), 'b': (5.0, -3.0)})


@pytest.mark.parametrize('robots', [3, 4])
def test_robots_that_move_lose_their_mirror_image_and_get_headings(robots):
    fleet = Circling(robots)
    numbers, ruled_out = [], []
    for estimate in fleet.drive(15.0):
        assert fleet.holding(estimate)
        numbers.append(fleet.holding(estimate)[0].number)
        ruled_out += estimate.ruled_out
    assert estimate.n_hypotheses == 1
    assert not estimate.placements[0].mirrored
    assert estimate.placements[0].heading_known.all()
    assert np.all(estimate.placements[0].heading_half_width_rad < 1.0)
    assert set(numbers) == {numbers[0]}
    assert any('mirror image ruled out by ' in text for text in ruled_out)
    assert 'mirror image ruled out by' in estimate.reason


@pytest.mark.parametrize('measured', [((0, 1), (2, 3)), ((0, 1),), ()])
def test_what_robots_remember_of_each_other_connects_them(measured):
    fleet = Circling(4)
    *_, estimate = fleet.drive(8.0)
    for estimate in fleet.drive(3.0, pairs=measured):
        assert estimate.groups == ()
        assert estimate.frame.points[0] == 'r0'
        assert fleet.holding(estimate)
        assert all(np.isfinite(p.enclosure_m).all() for p in estimate.placements)
    assert estimate.n_hypotheses == 1
    *_, estimate = fleet.drive(2.0, pairs=(), odometry=())
    assert not estimate.placements


@pytest.mark.parametrize('robots', [3, 4])
def test_the_best_point_is_turned_into_the_odometry_frame_by_the_best_heading(robots):
    fleet, unnamed = (Circling(robots, noise=NOISE, odometry_frame=name) for name in ('odom', ''))
    off_m, off_unturned_m = [], []
    for estimate, before in zip(fleet.drive(15.0), unnamed.drive(15.0), strict=True):
        if estimate.frame.kind != 'odometry' or estimate.n_hypotheses > 1:
            continue
        (placement,), (unturned,) = estimate.placements, before.placements
        assert fleet.holding(estimate)
        places, yaws = fleet.truth(estimate)
        off_m.append(farthest_m(placement, places))
        off_unturned_m.append(farthest_m(unturned, unnamed.truth(before)[0]))
        # The point is turned as a whole, so what was checked of it still holds.
        assert placement.proved == unturned.proved
        assert distances_m(placement) == pytest.approx(distances_m(unturned), abs=1e-9)
        # The odometry states the pose of the reference robot.
        orientations, half_widths_rad = placement.best_headings
        assert placement.positions_m[0] == pytest.approx(places[0], abs=1e-9)
        off_rad = math.remainder(yaw_of(orientations[0]) - yaws[0], math.tau)
        assert off_rad == pytest.approx(0.0, abs=1e-9)
        assert half_widths_rad[0] < 1e-6
        # Least squares knows the heading better than its bounds do.
        assert np.all(np.sqrt(placement.covariances[1:, 5, 5]) < 0.5 * half_widths_rad[1:])
    assert len(off_m) >= 5
    assert np.mean(off_m) < 2.5 * np.mean(off_unturned_m)


def farthest_m(placement, places):
    return np.linalg.norm(placement.positions_m - places, axis=1).max()


def distances_m(placement):
    steps_m = placement.positions_m[:, None] - placement.positions_m[None]
    return np.linalg.norm(steps_m, axis=-1)


def test_a_point_that_the_window_pulls_into_another_hypothesis_stays():
    fleet = Circling(3)
    *_, estimate = fleet.drive(10.0)
    (placement,) = estimate.placements
    snapshot = fleet.localizer.snapshot(fleet.now_s)
    constraints = constrain(snapshot)
    (plans,) = plan_frames(snapshot, constraints, [constraints])
    bare = replace(placement, fitted_yaws_rad=np.full(3, np.nan))
    fitted = fit_with_past(snapshot, constraints, (), plans.main, bare)
    assert np.isfinite(fitted.fitted_yaws_rad).all()
    for share in (1.0 - 1e-9, 1.5):
        elsewhere = replace(bare, lower_m=share * placement.upper_m)
        assert fit_with_past(snapshot, constraints, (), plans.main, elsewhere) is elsewhere


def test_an_answer_is_given_for_the_time_up_to_which_odometry_is_known():
    fleet = Circling(3)
    fleet.time_s = 1.0
    fleet.measure()
    known_s, answer_time = fleet.now_s, fleet.localizer.answer_time

    def hear(name, stamp_s):
        now_s, upright = stamp_s + 0.1, [0.0, 0.0, 0.0, 1.0]
        add = fleet.localizer.add_odometry
        assert add(name, [0.0, 0.0, 0.0], upright, stamp_s, now_s) is None

    assert answer_time(known_s) == known_s
    assert answer_time(known_s + 0.1) == known_s
    hear('r1', known_s + 0.05)
    assert answer_time(known_s + 0.1) == known_s
    # That of the other two is too old.
    assert answer_time(known_s + 0.18) == known_s + 0.05
    assert answer_time(known_s + 0.3) == known_s + 0.3
    # Time does not go back for a robot that is heard again.
    hear('r0', known_s + 0.2)
    assert answer_time(known_s + 0.31) == known_s + 0.3
    # A clock that was set back.
    assert answer_time(known_s - 1.0) == known_s - 1.0
    assert Circling(2, memory_s=0.0).localizer.answer_time(5.0) == 5.0


@pytest.mark.parametrize(
    ('settings', 'odometry'),
    [({'memory_s': 0.0}, None), ({'memory_s': 0.0, 'anchors': TWO}, None), ({}, ())],
)
def test_without_memory_or_odometry_the_mirror_image_stays(settings, odometry):
    """Beside two anchors both images have one shape, and differ in their positions only."""
    for estimate in Circling(3, **settings).drive(10.0, odometry=odometry):
        assert estimate.n_hypotheses == 2
        assert not estimate.placements[0].heading_known.any()
        assert [placement.number for placement in estimate.placements] == [1, 2]


ANCHORS = anchors_at({'west': (-4.0, 0.0), 'east': (6.0, 1.0), 'north': (0.0, 7.0)})


@pytest.mark.parametrize('outliers', [0, 2])
def test_a_robot_that_was_carried_away_is_forgotten_and_found_again(outliers):
    fleet = Circling(2, anchors=ANCHORS, memory_s=10.0, window_outliers=outliers)
    for estimate in fleet.drive(10.0):
        assert not estimate.forgotten
    fleet.shift_m[0] = [1.5, -1.0]
    texts = []
    for estimate in fleet.drive(12.0):
        assert estimate.verdict is Verdict.COVERED
        assert fleet.holding(estimate)
        texts.append([forgotten.text for forgotten in estimate.forgotten])
    assert texts[0] and 'r0' in texts[0][0] and 'contradicts' in texts[0][0]
    # It is in doubt for LONGEST_DOUBT_S; then all is forgotten that its odometry carries.
    for found, carried in zip(texts, (True, False, False, True), strict=False):
        assert ('the odometry of r0 may be wrong' in found) is carried
    assert not any(texts[4:])
    assert estimate.placements[0].heading_known.all()


def test_what_a_robot_in_doubt_measured_of_others_does_not_count():
    """The robot was carried away after the last range to the other robot."""
    fleet = Circling(2, anchors=ANCHORS, memory_s=10.0, window_outliers=2)
    list(fleet.drive(5.0))
    fleet.shift_m[0] = [1.5, -1.0]
    for estimate in fleet.drive(2.0, pairs=()):
        assert fleet.holding(estimate)


def remembered(fleet):
    """Return the stamps that are remembered of each observer and target."""
    observations = fleet.localizer.snapshot(fleet.now_s).window.observations
    return {ends: {seen.stamp_s for seen in kept} for ends, kept in observations.items()}


@pytest.mark.parametrize('arrives_late', [False, True])
def test_one_wrong_range_leaves_what_was_measured_before_and_what_others_measured(arrives_late):
    fleets = [Circling(3, anchors=ANCHORS, memory_s=15.0) for _ in range(2)]
    undisturbed, fleet = fleets
    both = zip(undisturbed.drive(14.0), fleet.drive(14.0), strict=True)
    for second, (expected, estimate) in enumerate(both, 1):
        assert fleet.holding(estimate)
        assert bool(estimate.forgotten) is (second == 9)
        assert all('r0' in ends for item in estimate.forgotten for ends in item.ends)
        widths_m = [np.ptp(e.placements[0].enclosure_m, axis=1) for e in (expected, estimate)]
        assert second == 9 or np.allclose(*widths_m, rtol=0.1, atol=0.02)
        if second == 8:
            for wait_s in (0.06, 0.11):
                stamp_s = fleet.now_s - 0.02 if arrives_late else fleet.now_s + wait_s
                now_s = fleet.now_s + wait_s
                fleet.localizer.add_range('r0', 'west', 0.7, stamp_s, now_s)
    known, expected = remembered(fleet), remembered(undisturbed)
    lost = {ends: stamps - known[ends] for ends, stamps in expected.items()}
    assert {ends for ends, stamps in lost.items() if stamps} == {('r0', name) for name in ANCHORS}
    assert all(START_S + 7.9 <= stamp_s <= START_S + 9.0 for s in lost.values() for stamp_s in s)


def test_a_wrong_range_is_noticed_that_the_memory_thins_out():
    fleet = Circling(3, anchors=ANCHORS, memory_s=40.0)
    list(fleet.drive(8.0))
    before = remembered(fleet)
    # A right one was measured at the same time, nearly: one is remembered of 0.13 s.
    fleet.localizer.add_range('r0', 'west', 0.7, fleet.now_s + 0.11, fleet.now_s + 0.11)
    assert remembered(fleet) == before
    estimate = fleet.localizer.step(fleet.now_s + 0.12)
    assert estimate.forgotten
    # It does not count at the moment, either.
    assert not estimate.placements and any(link.contradicts for link in estimate.links)
    assert all('r0' in ends for item in estimate.forgotten for ends in item.ends)
    # The others are stale by now, and right.
    assert estimate.reason.startswith('all fresh measurements contradict')
    for estimate in fleet.drive(6.0):
        assert fleet.holding(estimate)
        assert not estimate.forgotten and 'doubt' not in estimate.reason
    after = remembered(fleet)
    assert all(len(after[ends]) >= len(stamps) for ends, stamps in before.items())


def test_a_cancelled_estimate_is_that_of_the_moment():
    fleet = Circling(3)
    list(fleet.drive(10.0))
    cancel = Event()
    cancel.set()
    estimate = fleet.localizer.estimate(fleet.localizer.snapshot(fleet.now_s), cancel)
    assert estimate.placements
    assert not estimate.placements[0].heading_known.any()


def test_no_time_for_the_window_leaves_the_answer_of_the_moment():
    fleet = Circling(3, memory_max_seconds=0.0, anchors=ANCHORS)
    for estimate in fleet.drive(6.0):
        assert fleet.holding(estimate)


def test_a_jump_back_in_time_forgets():
    fleet = Circling(3)
    list(fleet.drive(5.0))
    window = fleet.localizer.snapshot(fleet.now_s).window
    assert len(window.observations['r0', 'r1']) == 20
    for max_future_s in (0.5, 0.1):
        assert fleet.localizer.configure(replace(fleet.config, max_future_s=max_future_s))
        stamp_s = fleet.now_s + max_future_s
        for _ in range(2):
            assert fleet.localizer.add_range('r0', 'r1', 3.0, stamp_s, fleet.now_s) is None
    window = fleet.localizer.snapshot(fleet.now_s).window
    assert len(window.observations['r0', 'r1']) == 20
    fleet.time_s -= 4.0
    fleet.localizer.add_range('r0', 'r1', 3.0, fleet.now_s, fleet.now_s)
    window = fleet.localizer.snapshot(fleet.now_s).window
    assert [len(seen) for seen in window.observations.values()] == [1]


def test_a_range_from_before_robots_became_slow_is_not_used_as_if_it_were_newer():
    """Robot r drives away at 10 m/s until 1 s; answers are 0.1 s late, as the odometry of s is."""
    fast = {'max_speed_m_s': 10.0, 'memory_s': 1.0, 'max_future_s': 0.0}
    localizer = new_localizer('rs', {'a': (0.0, 0.0)}, range_error=(-0.01, 0.01, 0.0, 0.0), **fast)
    slow = replace(localizer.config, max_speed_m_s=0.1)
    for step in range(260):
        now_s = START_S + 0.01 * step
        add_odometry(localizer, 's', np.zeros(3), now_s - 0.1, now_s=now_s)
        if step == 97:
            assert localizer.add_range('r', 'a', 1.0, now_s - 0.025, now_s) is None
        if step in (100, 250):
            assert localizer.configure(replace(slow, max_age_s=step / 100.0))
        snapshot = localizer.snapshot(localizer.answer_time(now_s))
        if step > 110:
            assert all(distance.upper_m > 1.55 for distance in snapshot.distances)
    assert snapshot.config.max_speed_m_s == 0.1 and snapshot.links[0].stale


@pytest.mark.parametrize('robot', ['r', 's'])
def test_only_its_own_odometry_carries_a_robot_on(robot):
    places_m = {'a': (0.0, 0.0), 'b': (6.0, 0.0), 'c': (0.0, 6.0)}
    localizer = new_localizer('rs', places_m)
    for stamp_s in np.arange(START_S, START_S + 3.0, 0.1):
        if stamp_s < START_S + 1.0:
            add_odometry(localizer, 'r', np.zeros(3), stamp_s - 0.01)
            add_ranges(localizer, 'r', (1.0, 2.0), places_m, stamp_s)
        add_odometry(localizer, robot, np.zeros(3), stamp_s)
        estimate = localizer.step(stamp_s)
    assert bool(estimate.placements) == (robot == 'r')


def test_anchors_are_where_the_newest_settings_say():
    localizer = new_localizer('r', {'a': (0.0, 0.0), 'b': (2.0, 0.0)})
    places_m = {'a': (10.0, 0.0), 'b': (12.0, 0.0)}
    assert not localizer.configure(replace(localizer.config, anchors=anchors_at(places_m)))
    add_ranges(localizer, 'r', (11.0, 1.0), places_m, START_S)
    first, second = localizer.step(START_S).placements
    assert np.allclose(first.positions_m + second.positions_m, [22.0, 0.0])


@pytest.mark.parametrize('later_s', [0.0, 0.003])
def test_the_memory_is_bounded(later_s):
    """A range and a ray of one time are one observation; otherwise neither displaces the other."""
    localizer = new_localizer(('a', 'b'), memory_s=2.0)
    for step in range(5000):
        ray_s = 1.0 + 0.005 * step
        now_s = ray_s + later_s
        localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], ray_s, ray_s)
        localizer.add_range('a', 'b', 3.0, now_s, now_s)
    (seen,) = localizer.snapshot(now_s).window.observations.values()
    ranges = [item for item in seen if item.upper_m < 4.0]
    rays = [item for item in seen if math.isfinite(item.half_width_rad)]
    assert all(280 <= len(some) <= 301 for some in (ranges, rays))
    assert (len(ranges) == len(seen)) is (later_s == 0.0)
    assert all(now_s - 2.0 < item.stamp_s <= now_s for item in seen)


def test_what_the_window_has_decided_needs_no_measurement():
    fleet = Circling(4)
    two_triangles = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    first, *_, last = fleet.drive(15.0, pairs=two_triangles)
    assert first.n_hypotheses == 4
    remedy, alone, _ = first.would_fix
    assert remedy == 'range r0 - r3 or bearings would decide the reflection in r1, r2'
    assert alone.endswith(' is mirrored in the line r1 - r2: drive it in a curve')
    assert (last.n_hypotheses, last.would_fix) == (1, ())


@pytest.mark.parametrize('least_listed', [None, 1])
def test_one_listed_placement_is_the_one_that_is_left(least_listed):
    """A window that rules out the only placement that is looked at is no contradiction."""
    solver = SolverOptions(max_boxes=200, max_hypotheses=least_listed or 64)
    rng = np.random.default_rng(9)
    fleet = Circling(4, noise=0.01, max_hypotheses=1, max_age_s=1.0, solver=solver)
    fleet.centers_m, fleet.rates = rng.uniform(-3.0, 3.0, (4, 2)), rng.uniform(0.2, 0.6, 4)
    estimates = list(fleet.drive(12.0))
    assert not any(estimate.forgotten for estimate in estimates)
    assert all(len(estimate.placements) == 1 for estimate in estimates)
    if not least_listed:
        assert [estimates[k].n_hypotheses for k in (0, -1)] == [2, 1]


PAIR = (WORLD, 0)


def test_measurements_that_agree_again_end_a_doubt():
    doubts = Doubts()
    assert doubts.settled(PAIR, np.arange(0.0, 5.1, 0.1), 5.0, complete=True)
    assert doubts.contradicted(PAIR, 6.0) == 5.0
    assert doubts.robots == {0}
    assert doubts.contradicted(PAIR, 7.0) == 5.0
    newer_s = 7.0 + 0.1 * np.arange(1, CONFIRMING + 1)
    assert not doubts.settled(PAIR, newer_s[:-1], 8.0, complete=True)
    assert not doubts.settled(PAIR, newer_s, 8.0, complete=False)
    assert doubts.settled(PAIR, newer_s, 8.0, complete=True)
    assert doubts.robots == set()
    assert doubts.contradicted(PAIR, 9.0) == 8.0


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


@pytest.mark.parametrize(('memory_s', 'every_s'), [(5.0, 1.0), (15.0, 1.0), (5.0, 10.0)])
def test_a_gap_of_any_length_is_bridged_by_odometry(memory_s, every_s):
    """Also where answers are asked for less often than memory lasts."""
    fleet, gap_s, widths_m = driving(memory_s), 4.0 * memory_s, []
    list(fleet.drive(10.0, every_s))
    for estimate in fleet.drive(gap_s, every_s, anchors=False):
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


def test_a_set_that_odometry_does_not_reach_any_more_claims_nothing():
    """While no answer is asked for, odometry is not kept for ever."""
    fleet = driving(5.0)
    list(fleet.drive(8.0))
    (estimate,) = fleet.drive(100.0, 100.0, anchors=False)
    assert not estimate.placements
    list(fleet.drive(7.0))
    assert len(fleet.holding(fleet.localizer.step(fleet.now_s))) == 1


@pytest.mark.parametrize('side', [-1.0, 1.0])
@pytest.mark.parametrize('scale', [0.7, 1.3])
def test_odometry_that_is_scaled_and_errs_at_its_bound_loses_no_truth(scale, side):
    fleet = driving(30.0, OdometryErrorModel(translation_per_m=0.05, translation_scale=scale))
    fleet.scale = scale * (1.0 + 0.0499 * side)
    for seconds, anchors in ((6.0, True), (10.0, False)):
        for estimate in fleet.drive(seconds, anchors=anchors):
            assert fleet.holding(estimate) and not estimate.forgotten
    # Ten seconds of it without a look at anything.
    assert np.ptp(estimate.placements[0].enclosure_m[0], axis=0).max() < 2.5 * scale


MEMORY_S, STEP_S = 10.0, 0.2
BEACONS_M = {'a': (0.0, 5.0), 'b': (0.0, -5.0), 'c': (8.0, 4.0)}
PLACES_M = {'r': (2.0, 0.0), 's': (3.0, 1.0)}


def localizer_of(robots, **settings):
    return new_localizer(
        robots,
        odometry_error={'translation_per_m': 0.01},
        memory_s=MEMORY_S,
        max_age_s=0.3,
        **settings,
    )


def enclosures_among_anchors(first_error_m, outliers):
    """Return the enclosures of two parked robots by time since the start."""
    localizer = localizer_of(
        tuple(PLACES_M),
        anchors=BEACONS_M,
        range_error=(-0.01, 0.01, -0.3, 0.3),
        window_outliers=outliers,
    )
    found = {}
    for step in range(80):
        since_s, now_s = step * STEP_S, START_S + step * STEP_S
        for robot, place_m in PLACES_M.items():
            add_odometry(localizer, robot, place_m, now_s, frame=f'{robot}/odom')
            off_m = first_error_m if since_s < 0.5 else 0.0
            add_ranges(localizer, robot, place_m, BEACONS_M, now_s, off_m)
        if step % 4 == 0 and since_s > 5.0:
            found[since_s] = localizer.step(now_s).placements[0].enclosure_m
    return found


@pytest.mark.parametrize('outliers', [0, 1])
def test_what_is_older_than_the_memory_has_no_effect_among_anchors(outliers):
    """Other right readings in the first half second do not change it."""
    some, others = (enclosures_among_anchors(error_m, outliers) for error_m in (0.0, 1.0))
    if not outliers:
        assert any((some[t] != others[t]).any() for t in some if t < MEMORY_S)
    for since_s, enclosure_m in some.items():
        if since_s > MEMORY_S + 0.5:
            np.testing.assert_array_equal(enclosure_m, others[since_s])


def triangle_that_cannot_be(measured_now):
    """Remember three ranges that no triangle has; return the estimates since."""
    localizer = localizer_of(('r', 's', 't'), range_error=(-0.05, 0.05, 0.0, 0.0))
    estimates = []
    for step in range(60):
        since_s, now_s = step * STEP_S, START_S + step * STEP_S
        for robot in 'rst':
            add_odometry(localizer, robot, (0.0, 0.0), now_s, frame=f'{robot}/odom')
        if since_s < 0.5:
            localizer.add_range('r', 's', 1.0, now_s, now_s)
            localizer.add_range('s', 't', 1.0, now_s, now_s)
            if step == 0:
                localizer.add_range('r', 't', 5.0, now_s, now_s)
        elif measured_now:
            localizer.add_range('r', 's', 1.0, now_s, now_s)
        if since_s >= 1.0 and step % 5 == 0:
            estimates.append(localizer.step(now_s))
    return estimates


def test_a_memory_that_contradicts_itself_does_not_contradict_the_moment():
    estimates = triangle_that_cannot_be(measured_now=True)
    assert all(estimate.verdict is Verdict.COVERED for estimate in estimates)
    assert all(estimate.conflicts == () for estimate in estimates)
    assert any(estimate.forgotten for estimate in estimates)


def test_a_memory_alone_that_contradicts_itself_is_forgotten():
    estimates = triangle_that_cannot_be(measured_now=False)
    assert all(estimate.verdict is None for estimate in estimates)
    assert estimates[0].forgotten and not estimates[-1].forgotten


def test_a_robot_that_is_only_known_to_be_far_is_placed_by_what_was_measured_before():
    localizer = new_localizer('abc', range_error={'beyond_max_is_far': True}, odometry_error={})
    for step in range(20):
        now_s = START_S + 0.1 * step
        for robot, x_m in zip('abc', (0.0, 2.0, 1.0 + 0.1 * step), strict=True):
            add_odometry(localizer, robot, (x_m, 0.0, 0.0), now_s)
        localizer.add_range('a', 'b', 2.0, now_s, now_s)
        range_m = 1.0 + 0.1 * step if step < 10 else math.inf
        localizer.add_range('a', 'c', range_m, now_s, now_s, 0.0, 1.5)
    estimate = localizer.step(now_s)
    assert 'not connected' not in estimate.reason
    for placement in estimate.placements:
        assert np.isfinite(placement.positions_m).all()
        assert np.isfinite(placement.enclosure_m).all()
