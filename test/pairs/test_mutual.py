# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Covers of the directions in which two bodies have each other, carried from knot to knot."""

import math

import numpy as np
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.pairs import MutualCover, PastPoses, Ranges, Ways, mutual
from dg_localization.pairs.mutual import COARSEST, MOST_CELLS
from dg_localization.pairs.mutual_kernels import (
    ABOVE,
    BELOW,
    CELL,
    FAR,
    HIGH_A,
    HIGH_B,
    LOW_A,
    LOW_B,
    NEAR,
    REF_A,
    REF_B,
)

TOLERANCE = 1e-9


def turned(angle, way):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * way[0] - s * way[1], s * way[0] + c * way[1]])


def off_from(angles, middles):
    return np.remainder(angles - middles + math.pi, 2.0 * math.pi) - math.pi


def holds(cover, direction_a, direction_b, distance_m):
    """Return whether a cell holds two directions and a distance."""
    cells = cover.cells
    x, y = off_from(direction_a, cells[:, REF_A]), off_from(direction_b, cells[:, REF_B])
    inside = (cells[:, LOW_A] - TOLERANCE <= x) & (x <= cells[:, HIGH_A] + TOLERANCE)
    inside &= (cells[:, LOW_B] - TOLERANCE <= y) & (y <= cells[:, HIGH_B] + TOLERANCE)
    inside &= (cells[:, NEAR] - TOLERANCE <= distance_m) & (
        distance_m <= cells[:, FAR] + TOLERANCE
    )
    low, high = (
        cells[:, plane] + cells[:, plane + 1] * x + cells[:, plane + 2] * y
        for plane in (BELOW, ABOVE)
    )
    inside &= (low - TOLERANCE <= distance_m) & (distance_m <= high + TOLERANCE)
    return bool(inside.any())


class Body:
    """A body that drives about; its odometry errs by its bounds, and always the same way."""

    def __init__(self, rng, place_m, error_m, error_rad):
        self.rng = rng
        self.place_m = self.before = np.array(place_m, float)
        self.yaw = rng.uniform(-9.0, 9.0)
        self.stated_yaw = rng.uniform(-3.0, 3.0)
        self.error_m, self.error_rad = error_m, error_rad
        self.drift = rng.uniform(-math.pi, math.pi)
        self.sign = rng.choice([-1.0, 1.0])

    def step(self, way_m, turn):
        """Go on; return what odometry says of the end, seen from the start, and of both yaws."""
        share = 0.9999 * self.rng.choice([1.0, 1.0, 0.3])
        angle = self.rng.choice([self.drift, self.rng.uniform(-9.0, 9.0)])
        off = share * self.error_m * np.array([math.cos(angle), math.sin(angle)])
        self.before = self.place_m
        self.place_m = self.place_m + turned(self.yaw, np.array(way_m) + off)
        off_rad = self.error_rad * self.rng.choice([self.sign, self.sign, -self.sign, 0.2])
        self.yaw += turn + 0.9999 * off_rad
        yaw_before, self.stated_yaw = self.stated_yaw, self.stated_yaw + turn
        pose = PastPoses(
            Interval.point(np.array([[*way_m, 0.0]])),
            Interval.around(np.array([turn]), np.array([self.error_rad + 1e-9])),
        )
        return pose, yaw_before

    def seen_from_end(self, share, error_m):
        """Return where the body was on the step, seen from its end: off by the error."""
        place_m = self.before + share * (self.place_m - self.before)
        off = 0.9999 * error_m * turned(self.rng.uniform(-9.0, 9.0), [1.0, 0.0])
        x, y = turned(-self.yaw, place_m - self.place_m) + off
        pose = PastPoses(Interval.point(np.array([[x, y, 0.0]])), Interval.point(np.zeros(1)))
        return pose, place_m


class Flight:
    """Two bodies and their ranges, each at an end of its bounds."""

    def __init__(self, seed, apart_m=4.0, error=0.03):
        rng = self.rng = np.random.default_rng(seed)
        errors = rng.choice([0.0, 0.02, 0.05], (2, 2))
        angle = rng.uniform(-9.0, 9.0)
        self.a = Body(rng, [0.0, 0.0], *errors[0])
        self.b = Body(rng, turned(angle, [apart_m, 0.0]), *errors[1])
        self.error = error
        self.read_error_m = float(rng.choice([0.0, 0.01]))
        self.turns = rng.uniform(-0.4, 0.4, 2)

    @property
    def truth(self):
        gap = self.b.place_m - self.a.place_m
        angle = math.atan2(gap[1], gap[0])
        return (
            angle - self.a.yaw + self.a.stated_yaw,
            angle + math.pi - self.b.yaw + self.b.stated_yaw,
            float(np.linalg.norm(gap)),
        )

    def bounds_m(self, distance_m):
        """Return bounds that hold a distance, at one of their ends or anywhere."""
        share = self.rng.choice([0.0001, 0.9999, self.rng.uniform()])
        lower_m = distance_m * (1.0 - 2.0 * self.error * share)
        return lower_m, lower_m + 2.0 * self.error * distance_m

    def started(self, across=COARSEST):
        return MutualCover.started(*self.bounds_m(self.truth[2]), across)

    def step(self):
        """Go on; return the way and the ranges on it."""
        if self.rng.random() < 0.2:
            self.turns = self.rng.uniform(-0.4, 0.4, 2)
        speeds = self.rng.choice([0.0, 0.2, 0.5], 2)
        (pose_a, yaw_a), (pose_b, yaw_b) = (
            body.step([speed, 0.1 * speed], turn)
            for body, speed, turn in zip((self.a, self.b), speeds, self.turns, strict=True)
        )
        ball_m = self.a.error_m + self.b.error_m
        way = Ways.of(pose_a, pose_b, yaw_a, yaw_b, ball_m)
        return way, self.ranges(self.rng.choice([1.0, 0.5]))

    def ranges(self, share):
        (pose_a, place_a), (pose_b, place_b) = (
            body.seen_from_end(share, self.read_error_m) for body in (self.a, self.b)
        )
        lower_m, upper_m = self.bounds_m(float(np.linalg.norm(place_b - place_a)))
        yaws = self.a.stated_yaw, self.b.stated_yaw
        ways = Ways.of(pose_a, pose_b, *yaws, 2.0 * self.read_error_m)
        return Ranges(ways, np.array([lower_m]), np.array([upper_m]))


@pytest.mark.parametrize('seed', range(36))
def test_no_truth_is_lost_on_the_way(seed):
    flight = Flight(seed, apart_m=[1.0, 2.0, 5.0][seed % 3])
    cover, steps = flight.started(), 0
    for number in range(30):
        found = cover.carried(*flight.step())
        if found is None:
            found = flight.started()
        elif number % 2:
            found = found.gathered()
        cover = found
        assert holds(cover, *flight.truth), (seed, number)
        steps += len(cover) < 2000
        arcs = cover.arcs_rad
        for arc, direction in zip(arcs, flight.truth[:2], strict=True):
            middle = 0.5 * arc.sum()
            assert abs(off_from(direction, middle)) <= 0.5 * np.ptp(arc) + TOLERANCE
        low_m, high_m = cover.distance_m
        assert low_m - TOLERANCE <= flight.truth[2] <= high_m + TOLERANCE
    assert steps or seed % 3 == 2


@pytest.mark.parametrize('seed', range(16))
def test_no_truth_is_lost_in_few_large_cells(seed, monkeypatch):
    monkeypatch.setattr(mutual, 'MANY_CELLS', 32)
    flight = Flight(100 + seed, apart_m=2.0)
    cover = flight.started(10)
    for number in range(10):
        found = cover.carried(*flight.step())
        cover = flight.started(10) if found is None else found.gathered()
        assert holds(cover, *flight.truth), (seed, number)


def draw_cell(rng, half_rad):
    """Return a cover of one cell, whose planes are steep."""
    low_m = rng.uniform(0.3, 2.0)
    cell = np.zeros(CELL)
    cell[[REF_A, REF_B]] = rng.uniform(-3.0, 3.0, 2)
    cell[[LOW_A, LOW_B]] = -half_rad
    cell[[HIGH_A, HIGH_B]] = half_rad
    cell[[NEAR, FAR]] = low_m, 1.1 * low_m
    cell[BELOW : BELOW + 3] = 1.03 * low_m, *rng.uniform(-low_m, low_m, 2)
    cell[ABOVE : ABOVE + 3] = 1.07 * low_m, *rng.uniform(-low_m, low_m, 2)
    return MutualCover(cell[None], 64)


def draw_points(rng, cover, count=40):
    """Return points of a cell (x, y, d), most of them at its ends."""
    (cell,) = cover.cells
    x, y = cell[HIGH_A] * rng.choice([-1.0, 1.0, 0.3, -0.8], (2, count))
    low, high = (
        cell[plane] + cell[plane + 1] * x + cell[plane + 2] * y for plane in (BELOW, ABOVE)
    )
    low, high = np.maximum(low, cell[NEAR]), np.minimum(high, cell[FAR])
    d = np.where(rng.random(count) < 0.5, low, high)
    return [(cell[REF_A] + x[k], cell[REF_B] + y[k], d[k]) for k in np.flatnonzero(low <= high)]


@pytest.mark.parametrize('half_rad', [0.06, 0.5])
@pytest.mark.parametrize('seed', range(40))
def test_every_point_of_a_cell_is_carried_on_by_every_way(seed, half_rad):
    rng = np.random.default_rng(seed)
    cover = draw_cell(rng, half_rad)
    way_a, way_b = rng.uniform(-0.5, 0.5, (2, 2))
    ball_m, turns = rng.choice([0.0, 0.05]), rng.choice([0.0, 0.05], 2)
    way = Ways(way_a[None], way_b[None], np.array([ball_m]), turns[:1], turns[1:])
    carried = cover.carried(way)
    if carried is None:
        return
    for a, b, distance_m in draw_points(rng, cover):
        # In the frame of A, in which that of B is turned so that both look at each other.
        turn = a + math.pi - b
        gap = turned(a, [distance_m, 0.0]) - way_a + turned(turn, way_b)
        gap += turned(rng.uniform(-9.0, 9.0), [0.9999 * ball_m, 0.0])
        off_a, off_b = 0.9999 * turns * rng.choice([-1.0, 1.0], 2)
        angle = math.atan2(gap[1], gap[0])
        after = angle + off_a, angle + math.pi - turn + off_b
        assert holds(carried, *after, float(np.linalg.norm(gap)))


def still(seed=0, apart_m=4.0):
    """Return two bodies without errors."""
    flight = Flight(seed, apart_m, error=0.01)
    for body in (flight.a, flight.b):
        body.error_m = body.error_rad = 0.0
    flight.read_error_m = 0.0
    return flight


def drive(flight, cover, ways_a):
    """Have A go some ways while B stands still; return the cover then."""
    for way_m, turn in ways_a:
        pose_a, yaw_a = flight.a.step(way_m, turn)
        pose_b, yaw_b = flight.b.step([0.0, 0.0], 0.0)
        cover = cover.carried(Ways.of(pose_a, pose_b, yaw_a, yaw_b), flight.ranges(1.0)).gathered()
    return cover


LEG = [([0.25, 0.0], 0.0)] * 10


def test_a_corner_tells_the_direction_of_one_that_stands_still_and_nothing_of_its_own():
    flight = still()
    cover = drive(flight, flight.started(), LEG)
    straight = np.ptp(cover.arcs_rad, axis=1)
    cover = drive(flight, cover, [([0.0, 0.0], 1.5), *LEG])
    corner = np.ptp(cover.arcs_rad, axis=1)
    assert holds(cover, *flight.truth)
    # One leg leaves the direction and its mirror image; the one that stands still can be anyhow.
    assert corner[0] < 0.25 < straight[0]
    assert straight[1] >= 2.0 * math.pi and corner[1] >= 2.0 * math.pi
    assert cover.across > flight.started().across


def test_what_is_known_of_the_distance_is_kept_while_the_bodies_stand_still():
    flight = still()
    cover = flight.started()
    lowest, highest = cover.distance_m
    for _step in range(10):
        ranges = flight.ranges(1.0)
        lowest = max(lowest, float(ranges.lower_m[0]))
        highest = min(highest, float(ranges.upper_m[0]))
        pose_a, yaw_a = flight.a.step([0.0, 0.0], 0.0)
        pose_b, yaw_b = flight.b.step([0.0, 0.0], 0.0)
        cover = cover.carried(Ways.of(pose_a, pose_b, yaw_a, yaw_b), ranges).gathered()
    assert cover.distance_m == pytest.approx((lowest, highest), abs=1e-6)
    assert np.all(np.ptp(cover.arcs_rad, axis=1) >= 2.0 * math.pi)


def test_ranges_that_contradict_odometry_leave_nothing():
    flight = still()
    cover = drive(flight, flight.started(), LEG[:2])
    pose_a, yaw_a = flight.a.step([0.1, 0.0], 0.0)
    pose_b, yaw_b = flight.b.step([0.0, 0.0], 0.0)
    way, ranges = Ways.of(pose_a, pose_b, yaw_a, yaw_b), flight.ranges(1.0)
    wrong = Ranges(ranges.ways, ranges.lower_m + 1.0, ranges.upper_m + 1.0)
    assert not cover.carried(way, ranges).empty
    assert cover.carried(way, wrong).empty
    assert cover.carried(way, wrong).gathered().empty


def test_where_bodies_meet_the_truth_stays_or_all_is_given_up():
    for seed in range(12):
        flight = still(seed, apart_m=1.5)
        gap = flight.b.place_m - flight.a.place_m
        flight.a.yaw = math.atan2(gap[1], gap[0]) + 0.1 * (seed / 12.0)
        cover = flight.started()
        for _step in range(12):
            pose_a, yaw_a = flight.a.step([0.25, 0.0], 0.0)
            pose_b, yaw_b = flight.b.step([0.0, 0.0], 0.0)
            cover = cover.carried(Ways.of(pose_a, pose_b, yaw_a, yaw_b), flight.ranges(1.0))
            if cover is None:
                break
            cover = cover.gathered()
            assert holds(cover, *flight.truth), seed


@pytest.mark.parametrize('bad', [math.inf, math.nan, 1e10])
def test_a_way_that_is_not_bounded_says_nothing(bad):
    cover = MutualCover.started(1.0, 2.0)
    at_rest = PastPoses.at_rest(1)
    with np.errstate(invalid='ignore'):
        far = PastPoses(Interval.point(np.array([[bad, 0.0, 0.0]])), at_rest.yaw_rad)
        assert cover.carried(Ways.of(far, at_rest, 0.0, 0.0)) is None
        ranges = Ranges(Ways.of(far, at_rest, 0.0, 0.0), np.array([5.0]), np.array([6.0]))
    way = Ways.of(at_rest, at_rest, 0.0, 0.0)
    assert len(cover.carried(way, ranges)) == len(cover)
    turning = PastPoses(at_rest.position_m, Interval.around(np.zeros(1), np.array([2.0])))
    assert cover.carried(Ways.of(turning, at_rest, 0.0, 0.0)) is None


@pytest.mark.parametrize('seed', range(3))
def test_cells_of_a_grid_hold_what_was_gathered(seed, monkeypatch):
    monkeypatch.setattr(mutual, 'MANY_CELLS', 32)
    flight = Flight(seed, apart_m=3.0)
    cover = flight.started(8)
    for number in range(4):
        carried = cover.carried(*flight.step())
        if carried is None:
            break
        cover = carried.gathered()
        picked = carried.cells[flight.rng.integers(len(carried), size=50)]
        x = flight.rng.uniform(picked[:, LOW_A], picked[:, HIGH_A])
        y = flight.rng.uniform(picked[:, LOW_B], picked[:, HIGH_B])
        low, high = (
            picked[:, plane] + picked[:, plane + 1] * x + picked[:, plane + 2] * y
            for plane in (BELOW, ABOVE)
        )
        low, high = np.maximum(low, picked[:, NEAR]), np.minimum(high, picked[:, FAR])
        for k in np.flatnonzero(low <= high):
            a, b = picked[k, REF_A] + x[k], picked[k, REF_B] + y[k]
            for distance_m in (low[k], high[k]):
                assert holds(cover, a, b, distance_m), (seed, number)


def test_cells_are_larger_where_there_would_be_too_many():
    cover = MutualCover.started(2.0, 2.5, across=100)
    assert len(cover) > MOST_CELLS
    gathered = cover.gathered()
    assert gathered.across == 50 and len(gathered) == 2500
    assert holds(gathered, 1.0, 2.0, 2.2)


def test_bounds_at_the_end_of_a_way_are_those_on_it_and_what_was_gone():
    at_rest = PastPoses.at_rest(1)
    moved = PastPoses(Interval.point(np.array([[3.0, 4.0, 0.0]])), at_rest.yaw_rad)
    ways = Ways.of(moved, at_rest, 1.0, 2.0, 0.5)
    ranges = Ranges(ways, np.array([7.0]), np.array([8.0]))
    assert ranges.at_end_m == pytest.approx((1.5, 13.5), abs=1e-9)
    assert ranges.at_end_m[0] <= 1.5 and ranges.at_end_m[1] >= 13.5


def way_to(a_m, b_m, half_m=(0.0, 0.0), half_rad=(0.0, 0.0)):
    """Return the way of two bodies that look along x, with errors of both places and turns."""
    offs_m = [np.array([half, half, 0.0]) for half in half_m]
    poses = [
        PastPoses(
            Interval(np.array([[*way, 0.0]]) - off, np.array([[*way, 0.0]]) + off),
            Interval(np.array([-turn]), np.array([turn])),
        )
        for way, off, turn in zip((a_m, b_m), offs_m, half_rad, strict=True)
    ]
    return Ways.of(*poses, 0.0, 0.0)


@pytest.mark.parametrize('unbounded', [(math.inf, 0.0), (0.0, math.inf)], ids=['A', 'B'])
def test_ways_that_nothing_is_known_of_lose_nothing(unbounded):
    cover = MutualCover.started(2.0, 2.1)
    known, known_m = way_to((0.1, 0.0), (0.0, 0.1)), (np.array([1.0]), np.array([3.0]))
    nowhere = way_to((0.0, 0.0), (0.0, 0.0), half_m=unbounded)
    whirling = way_to((0.0, 0.0), (0.0, 0.0), half_rad=unbounded)
    assert not nowhere.placed and whirling.placed and not whirling.bounded
    assert cover.carried(nowhere) is None and cover.carried(whirling) is None
    without = cover.carried(known)
    with_it = cover.carried(known, Ranges(nowhere, *known_m))
    assert np.array_equal(with_it.cells, without.cells)
    # A range holds however the bodies turn.
    near = Ranges(whirling, np.array([2.0]), np.array([2.05]))
    assert cover.carried(known, near).distance_m[1] < without.distance_m[1]


@pytest.mark.parametrize('way_m', [1.9, 2.5, 2.852, 2.878])
def test_cells_of_bodies_that_come_near_stay_small(way_m):
    cover = MutualCover.started(2.87, 2.885).carried(way_to((way_m, 0.0), (0.0, 0.0)))
    if cover is not None:
        widths_rad = cover.cells[:, [HIGH_A, HIGH_B]] - cover.cells[:, [LOW_A, LOW_B]]
        assert widths_rad.max() < 4.0 * math.pi
