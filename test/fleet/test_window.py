# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What robots measured before they moved: mirror images go, headings come, contradictions pass."""

from dataclasses import replace
from itertools import combinations
import math
from threading import Event

import numpy as np
import pytest

from dg_localization import SolverOptions, Verdict
from dg_localization.fleet import (
    Anchor,
    FleetConfig,
    Localizer,
    OdometryErrorModel,
    RangeErrorModel,
)
from dg_localization.fleet.constraints.constrain import constrain
from dg_localization.fleet.estimation import estimate_snapshot
from dg_localization.fleet.frames.finders import fit_with_past
from dg_localization.fleet.frames.plan import plan_frames
from dg_localization.fleet.rotations import yaw_of
from dg_localization.fleet.window.memory import NO_WINDOW

START_S = 100.0
TICK_S = 0.25
CENTERS = np.array([[0.0, 0.0], [4.0, 0.5], [1.5, 3.5], [-2.5, 2.0]])
RADII_M = np.array([0.8, -0.6, 1.0, 0.5])
RATES = np.array([0.5, 0.8, 0.6, -0.7])
"""Of the turn; the sign of a radius and of its rate tell whether a robot drives forward."""
ERROR = OdometryErrorModel(translation_per_m=0.02, rotation_per_rad=0.02)


class Circling:
    """Robots that drive in circles, and a localizer that hears them."""

    def __init__(self, robots, *, odometry_frame='', **settings):
        defaults = {
            'range_error': RangeErrorModel(min_error_relative=-0.02, max_error_relative=0.02),
            'odometry_error': ERROR,
            'max_age_s': 0.1,
            'memory_max_seconds': math.inf,
            'solver': SolverOptions(max_boxes=200),
        }
        self.names = tuple(f'r{i}' for i in range(robots))
        self.config = FleetConfig(robots=self.names, **{**defaults, **settings})
        self.localizer = Localizer(self.config)
        self.odometry_frame = odometry_frame
        self.time_s = 0.0
        self.shift_m = np.zeros((robots, 2))

    @property
    def now_s(self):
        return START_S + self.time_s

    def poses(self):
        """Return true positions (n, 2) and yaws (n,)."""
        n = len(self.names)
        angles = RATES[:n] * self.time_s + np.arange(n)
        around = RADII_M[:n, None] * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        forward = np.sign(RADII_M[:n] * RATES[:n])
        yaws = angles + forward * 0.5 * math.pi
        return CENTERS[:n] + around + self.shift_m, yaws

    def measure(self, *, pairs=None, anchors=True):
        """Measure pairs of robots, or all, once; odometry does not see a shift."""
        places, yaws = self.poses()
        apart = self.names
        for name, place, yaw, shift in zip(self.names, places, yaws, self.shift_m, strict=True):
            orientation = [0.0, 0.0, math.sin(yaw / 2.0), math.cos(yaw / 2.0)]
            stated = [*(place - shift), 0.0]
            rejection = self.localizer.add_odometry(
                name, stated, orientation, self.now_s, self.now_s, self.odometry_frame
            )
            assert rejection is None
        for i, j in combinations(range(len(apart)), 2) if pairs is None else pairs:
            self._range(self.names[i], self.names[j], places[j] - places[i])
        for name, anchor in self.config.anchors.items() if anchors else ():
            for robot, place in zip(self.names, places, strict=True):
                self._range(robot, name, anchor.coordinates_m - place)

    def _range(self, observer, target, gap):
        reading = float(np.linalg.norm(gap))
        self.localizer.add_range(observer, target, reading, self.now_s, self.now_s)

    def drive(self, seconds, **measured):
        """Drive on, measuring; yield an estimate every second."""
        for tick in range(round(seconds / TICK_S)):
            self.time_s += TICK_S
            self.measure(**measured)
            if tick % 4 == 3:
                yield self.localizer.step(self.now_s)

    def truth(self, estimate):
        """Return positions and yaws in the frame of an estimate."""
        places, yaws = self.poses()
        # Odometry frames are those of the world here.
        if estimate.frame.kind in ('anchors', 'odometry'):
            return places, yaws
        origin, towards = (self.names.index(name) for name in estimate.frame.points)
        x, y = places[towards] - places[origin]
        turn = math.atan2(y, x)
        c, s = math.cos(turn), math.sin(turn)
        return (places - places[origin]) @ np.array([[c, -s], [s, c]]), yaws - turn

    def holds(self, placement, estimate):
        places, yaws = self.truth(estimate)
        low, high = placement.enclosure_m[:, 0] - 1e-9, placement.enclosure_m[:, 1] + 1e-9
        known = placement.heading_known
        z, w = placement.orientations_xyzw[known, 2:].T
        off = 2.0 * np.arctan2(z, w) - yaws[known]
        off = np.abs(np.remainder(off + math.pi, 2.0 * math.pi) - math.pi)
        return bool(
            np.all((low <= places) & (places <= high))
            and np.all(off <= placement.heading_half_width_rad[known] + 1e-9)
        )


@pytest.mark.parametrize('robots', [3, 4])
def test_robots_that_move_lose_their_mirror_image_and_get_headings(robots):
    fleet = Circling(robots)
    numbers, ruled_out = [], []
    for estimate in fleet.drive(15.0):
        assert any(fleet.holds(placement, estimate) for placement in estimate.placements)
        numbers.append(next(p.number for p in estimate.placements if fleet.holds(p, estimate)))
        ruled_out += estimate.ruled_out
    assert estimate.n_hypotheses == 1
    assert not estimate.placements[0].mirrored
    assert estimate.placements[0].heading_known.all()
    assert np.all(estimate.placements[0].heading_half_width_rad < 1.0)
    assert set(numbers) == {numbers[0]}
    assert any('mirror image ruled out by ' in text for text in ruled_out)
    assert 'mirror image ruled out by' in estimate.reason


def test_what_was_ruled_out_stays_so_where_the_window_alone_does_not_tell():
    fleet = Circling(3)
    *_, before = fleet.drive(10.0)
    assert before.n_hypotheses == 1
    snapshot = fleet.localizer.snapshot(fleet.now_s)
    forgetful = replace(snapshot, window=NO_WINDOW)
    assert estimate_snapshot(forgetful)[0].n_hypotheses == 2
    after = fleet.localizer.estimate(forgetful)
    assert after.n_hypotheses == 1
    assert fleet.holds(after.placements[0], after)
    assert after.ruled_out == ('mirror image ruled out by the estimate 0.0 s ago',)


def test_the_next_chain_is_ready_when_one_is_dropped():
    fleet = Circling(3, memory_s=6.0)
    *_, estimate = fleet.drive(3.0)
    for estimate in fleet.drive(12.0):
        # What one rules out is ruled out by the next before the first is dropped.
        assert estimate.n_hypotheses == 1


@pytest.mark.parametrize('measured', [((0, 1), (2, 3)), ((0, 1),), ()])
def test_what_robots_remember_of_each_other_connects_them(measured):
    fleet = Circling(4)
    *_, estimate = fleet.drive(8.0)
    for estimate in fleet.drive(3.0, pairs=measured):
        assert estimate.groups == ()
        assert estimate.frame.points[0] == 'r0'
        assert any(fleet.holds(placement, estimate) for placement in estimate.placements)
        assert all(np.isfinite(p.enclosure_m).all() for p in estimate.placements)
    assert estimate.n_hypotheses == 1


def test_robots_are_connected_for_half_the_memory():
    fleet = Circling(3, memory_s=6.0)
    *_, estimate = fleet.drive(6.0)
    *_, estimate = fleet.drive(2.0, pairs=())
    assert estimate.placements
    *_, estimate = fleet.drive(2.0, pairs=())
    assert not estimate.placements
    assert 'stale' in estimate.reason


class Noisy(Circling):
    """Robots whose ranges err anywhere in their bounds."""

    def __init__(self, robots, **settings):
        super().__init__(robots, **settings)
        self._rng = np.random.default_rng(0)

    def _range(self, observer, target, gap):
        super()._range(observer, target, gap / (1.0 + self._rng.uniform(-0.02, 0.02)))


@pytest.mark.parametrize('anchors', [{}, {'a': Anchor((-4.0, -3.0)), 'b': Anchor((5.0, -3.0))}])
def test_the_best_point_of_robots_without_cameras_is_that_of_the_window(anchors):
    fleet = Noisy(3, anchors=anchors)
    off_m, off_of_the_moment_m, off_rad = [], [], []
    for estimate in fleet.drive(15.0):
        if estimate.n_hypotheses > 1 or not estimate.placements[0].heading_known.all():
            continue
        (placement,) = estimate.placements
        assert fleet.holds(placement, estimate)
        low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
        assert np.all((low <= placement.positions_m) & (placement.positions_m <= high))
        places, yaws = fleet.truth(estimate)
        off_m.append(np.linalg.norm(placement.positions_m - places, axis=1).max())
        off_rad += list(2.0 * np.arcsin(np.abs(np.sin(0.5 * (placement.fitted_yaws_rad - yaws)))))
        forgetful = replace(fleet.localizer.snapshot(fleet.now_s), window=NO_WINDOW)
        images = estimate_snapshot(forgetful)[0].placements
        off_of_the_moment_m.append(
            min(np.linalg.norm(image.positions_m - places, axis=1).max() for image in images)
        )
    assert len(off_m) >= 5
    assert np.mean(off_m) < 0.6 * np.mean(off_of_the_moment_m)
    assert np.mean(off_rad) < 0.1


@pytest.mark.parametrize('robots', [3, 4])
def test_the_best_point_is_turned_into_the_odometry_frame_by_the_best_heading(robots):
    fleet, unnamed = Noisy(robots, odometry_frame='odom'), Noisy(robots)
    off_m, off_unturned_m = [], []
    for estimate, before in zip(fleet.drive(15.0), unnamed.drive(15.0), strict=True):
        if estimate.frame.kind != 'odometry' or estimate.n_hypotheses > 1:
            continue
        (placement,), (unturned,) = estimate.placements, before.placements
        assert fleet.holds(placement, estimate)
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


def test_a_heading_that_is_not_fitted_is_as_uncertain_as_its_bound():
    fleet = Noisy(3)
    *_, estimate = fleet.drive(12.0)
    add = fleet.localizer.add_odometry
    fleet.localizer.add_odometry = lambda name, *rest: None if name == 'r2' else add(name, *rest)
    n_unfitted = 0
    for _ in range(4):
        fleet.time_s += TICK_S
        fleet.measure()
        for placement in fleet.localizer.step(fleet.now_s).placements:
            known = placement.heading_known
            unfitted = known & np.isnan(placement.fitted_yaws_rad)
            n_unfitted += int(unfitted.sum())
            half_widths = placement.heading_half_width_rad[unfitted]
            assert np.array_equal(placement.covariances[unfitted, 5, 5], half_widths**2)
            assert np.all(placement.covariances[known, 5, 5] > 0.0)
    assert n_unfitted


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


def test_without_memory_the_mirror_image_stays():
    fleet = Circling(3, memory_s=0.0)
    for estimate in fleet.drive(10.0):
        assert estimate.n_hypotheses == 2
        assert not estimate.placements[0].heading_known.any()
        assert [placement.number for placement in estimate.placements] == [1, 2]


def test_without_odometry_there_is_no_memory():
    fleet = Circling(3)
    fleet.localizer.add_odometry = lambda *_: None
    for estimate in fleet.drive(10.0):
        assert estimate.n_hypotheses == 2


ANCHORS = {'west': Anchor((-4.0, 0.0)), 'east': Anchor((6.0, 1.0)), 'north': Anchor((0.0, 7.0))}


def test_robots_among_anchors_get_headings_and_stay_placed_without_measurements():
    fleet = Circling(2, anchors=ANCHORS)
    for estimate in fleet.drive(10.0):
        assert fleet.holds(estimate.placements[0], estimate)
    assert estimate.n_hypotheses == 1
    assert estimate.placements[0].heading_known.all()
    before_m = np.ptp(estimate.placements[0].enclosure_m, axis=1).max()
    # Ranges between the robots go on.
    for estimate in fleet.drive(4.0, anchors=False):
        (placement,) = estimate.placements
        assert fleet.holds(placement, estimate)
        assert estimate.frame.kind == 'anchors'
    assert before_m < np.ptp(placement.enclosure_m, axis=1).max() < 4.0 * before_m


@pytest.mark.parametrize('outliers', [0, 2])
def test_a_robot_that_was_carried_away_is_forgotten_and_found_again(outliers):
    fleet = Circling(2, anchors=ANCHORS, memory_s=10.0, window_outliers=outliers)
    for estimate in fleet.drive(10.0):
        assert not estimate.forgotten
    fleet.shift_m[0] = [1.5, -1.0]
    texts = []
    for estimate in fleet.drive(12.0):
        assert estimate.verdict is Verdict.COVERED
        assert fleet.holds(estimate.placements[0], estimate)
        texts.append([forgotten.text for forgotten in estimate.forgotten])
    assert texts[0] and 'r0' in texts[0][0] and 'contradicts' in texts[0][0]
    # It is in doubt for LONGEST_DOUBT_S; then all is forgotten that its odometry carries.
    for found, carried in zip(texts, (True, False, False, True), strict=False):
        assert ('the odometry of r0 may be wrong' in found) is carried
    assert not any(texts[4:])
    assert estimate.placements[0].heading_known.all()


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
        assert fleet.holds(estimate.placements[0], estimate)
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
    assert not estimate.placements and [
        link.key.ends for link in estimate.links if link.contradicts
    ]
    assert all('r0' in ends for item in estimate.forgotten for ends in item.ends)
    # The others are stale by now, and right.
    assert estimate.reason.startswith('all fresh measurements contradict')
    for estimate in fleet.drive(6.0):
        assert fleet.holds(estimate.placements[0], estimate)
        assert not estimate.forgotten and 'doubt' not in estimate.reason
    after = remembered(fleet)
    assert all(len(after[ends]) >= len(stamps) for ends, stamps in before.items())


@pytest.mark.parametrize('memory_s', [26.0, 40.0])
def test_a_contradiction_is_dated_where_it_is_known_when_it_began(memory_s):
    fleet = Circling(1, anchors=ANCHORS, memory_s=memory_s)
    list(fleet.drive(0.9 * memory_s))
    fleet.shift_m[0] = [0.3, -0.15]
    first = next(fleet.drive(1.0))
    text = first.forgotten[0].text
    assert 'more than 1.0 s ago contradicts what they measured since' in text


def test_a_robot_that_is_carried_away_again_and_again_costs_the_others_nothing():
    fleet = Circling(3, anchors=ANCHORS, memory_s=12.0)
    list(fleet.drive(3.0))
    forgotten = []
    for times in range(1, 4):
        fleet.shift_m[0] = [1.5 * times, -1.0]
        for estimate in fleet.drive(6.0):
            assert fleet.holds(estimate.placements[0], estimate)
            forgotten += estimate.forgotten
    texts = [item.text for item in forgotten if 'odometry' in item.text]
    assert texts == ['the odometry of r0 may be wrong'] * 6
    assert all('r0' in ends for item in forgotten for ends in item.ends)
    stamps = remembered(fleet)
    for ends in (('r1', 'west'), ('r2', 'north'), ('r1', 'r2')):
        assert len(stamps[ends]) == round(12.0 / TICK_S)


def test_what_the_moment_says_is_answered_when_the_window_contradicts_it():
    fleet = Circling(3)
    assert all(not estimate.forgotten for estimate in fleet.drive(10.0))
    fleet.shift_m[:] = [[3.0, 1.0], [-1.0, 3.0], [0.0, 0.0]]
    forgotten = []
    for estimate in fleet.drive(6.0):
        assert estimate.verdict is Verdict.COVERED
        assert any(fleet.holds(placement, estimate) for placement in estimate.placements)
        forgotten += estimate.forgotten
    assert any('contradicts what is measured now' in item.text for item in forgotten)
    assert not estimate.forgotten


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
        assert fleet.holds(estimate.placements[0], estimate)


def test_a_reset_forgets_and_numbers_are_not_used_again():
    fleet = Circling(3)
    *_, before = fleet.drive(10.0)
    assert before.n_hypotheses == 1
    fleet.localizer.reset()
    after = next(fleet.drive(1.0))
    assert after.n_hypotheses == 2
    numbers = {placement.number for placement in after.placements}
    assert min(numbers) > before.placements[0].number


def test_a_jump_back_in_time_forgets():
    fleet = Circling(3)
    list(fleet.drive(5.0))
    window = fleet.localizer.snapshot(fleet.now_s).window
    assert len(window.observations['r0', 'r1']) == 20
    fleet.time_s -= 4.0
    fleet.localizer.add_range('r0', 'r1', 3.0, fleet.now_s, fleet.now_s)
    window = fleet.localizer.snapshot(fleet.now_s).window
    assert [len(seen) for seen in window.observations.values()] == [1]


def test_the_memory_is_bounded():
    localizer = Localizer(FleetConfig(robots=('a', 'b'), memory_s=2.0))
    for step in range(5000):
        now_s = 1.0 + 0.005 * step
        localizer.add_range('a', 'b', 3.0, now_s, now_s)
        localizer.add_bearing('a', 'b', [1.0, 0.0, 0.0], now_s, now_s)
    (seen,) = localizer.snapshot(now_s).window.observations.values()
    assert 280 <= len(seen) <= 301
    # A range and a ray of one time are one observation.
    assert all(item.upper_m < 4.0 and item.direction is not None for item in seen)
    assert all(now_s - 2.0 < item.stamp_s <= now_s for item in seen)


def test_what_arrives_late_is_remembered_in_order():
    localizer = Localizer(FleetConfig(robots=('r0', 'r1'), memory_s=10.0, max_age_s=5.0))
    stamps_s = [101.0, 103.0, 102.0, 100.5, 104.0]
    for stamp_s in stamps_s:
        assert localizer.add_range('r0', 'r1', 3.0, stamp_s, 104.0) is None
        assert localizer.add_bearing('r0', 'r1', [1.0, 0.0, 0.0], stamp_s, 104.0) is None
    (seen,) = localizer.snapshot(103.5).window.observations.values()
    assert [observation.stamp_s for observation in seen] == [100.5, 101.0, 102.0, 103.0]
    assert all(one.has_distance and one.direction is not None for one in seen)


def test_what_the_window_has_decided_needs_no_measurement():
    fleet = Circling(4)
    two_triangles = [(0, 1), (0, 2), (1, 2), (1, 3), (2, 3)]
    first, *_, last = fleet.drive(15.0, pairs=two_triangles)
    assert first.n_hypotheses == 4
    assert first.would_fix == ('range r0 - r3 or bearings would decide the reflection in r1, r2',)
    assert (last.n_hypotheses, last.would_fix) == (1, ())
