# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Covers that are carried from knot to knot, and count the readings that their poses break."""

import math

import numpy as np
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.pairs import (
    CellOptions,
    CountedCover,
    Cover,
    PairOptions,
    PairReadings,
    PastPoses,
    Stated,
    cover_poses,
)

ANCHORS_M = np.array([[0.0, 0.0, 0.0], [6.0, 0.5, 0.0], [1.0, 5.0, 0.0], [5.0, 6.0, 0.0]])
FEW_CELLS = CellOptions(across=8, slices=12, max_cells=150)
ERROR, RAY_RAD = 0.05, 0.1


def wrapped(angle):
    return math.remainder(angle, 2.0 * math.pi)


class Walk:
    """A robot among anchors that goes from knot to knot; odometry errs by its bounds."""

    def __init__(self, seed, way_m=0.4, turn_rad=0.6, step_error=0.1, turn_error=0.1):
        self.rng = np.random.default_rng(seed)
        self.pose = np.array([*self.rng.uniform(0.0, 6.0, 2), self.rng.uniform(-9.0, 9.0)])
        self.stated = np.array([*self.rng.uniform(-90.0, 90.0, 2), self.rng.uniform(-3.0, 3.0)])
        self.way_m, self.turn_rad = way_m, turn_rad
        self.errors = step_error * way_m, turn_error * turn_rad

    def step(self):
        """Go on; return what odometry says of it."""
        rng = self.rng
        turn = self.turn_rad * rng.choice([-1.0, 0.0, 1.0, rng.uniform(-1.0, 1.0)])
        way = self.way_m * rng.choice([0.0, 1.0]) * np.array([1.0, 0.3])
        off = self.errors[0] * rng.choice([-1.0, 1.0], 2) * rng.choice([1.0, 1.0, 0.3])
        off_turn = self.errors[1] * rng.choice([-1.0, 1.0]) * rng.choice([1.0, 1.0, 0.3])
        for pose, step, turned in (
            (self.pose, way + off, turn + off_turn),
            (self.stated, way, turn),
        ):
            c, s = math.cos(pose[2]), math.sin(pose[2])
            pose += [c * step[0] - s * step[1], s * step[0] + c * step[1], turned]
        half = np.array([[self.errors[0], self.errors[0], 0.0]]) + 1e-9
        half_turn = np.array([self.errors[1] + 1e-9])
        return PastPoses(
            Interval.around(np.array([[*way, 0.0]]), half * [1.0, 1.0, 0.0]),
            Interval.around(np.array([turn]), half_turn),
        )

    def measure(self, count, wrong=0):
        """Return ranges and rays of some anchors, so many of them wrong."""
        rng, (x, y, yaw) = self.rng, self.pose
        seen = ANCHORS_M[rng.integers(len(ANCHORS_M), size=count)]
        gaps = seen - [x, y, 0.0]
        off = rng.choice([-1.0, 1.0], count) * rng.choice([0.999, 0.3], count)
        ranges = np.linalg.norm(gaps, axis=-1) + ERROR * off
        rays = np.arctan2(gaps[:, 1], gaps[:, 0]) - yaw + RAY_RAD * 0.999 * off[::-1]
        ranges[:wrong] += rng.uniform(0.5, 3.0, wrong)
        return PairReadings.of(
            Interval.point(seen),
            Interval.point(np.zeros((count, 3))),
            Interval(ranges - ERROR, ranges + ERROR),
            np.stack([np.cos(rays), np.sin(rays), 0.0 * rays], axis=-1),
            np.full(count, RAY_RAD),
            True,
        )

    def place(self):
        return Stated(*self.stated)

    def is_in(self, cover):
        return cover.contains(np.array([*self.pose[:2], 0.0]), float(self.pose[2]))


def levels_hold(walk, cover, broken):
    """Return whether every level from the number of broken readings on holds the truth."""
    return all(
        walk.is_in(Cover(cover.cells[:, level][cover.cells[:, level, 0, 0] < math.inf]))
        for level in range(broken, cover.cells.shape[1])
    )


@pytest.mark.parametrize('seed', range(40))
@pytest.mark.parametrize('outliers', [0, 1, 3])
def test_the_truth_is_in_the_level_of_what_it_broke(seed, outliers):
    walk = Walk([seed, outliers])
    rng = np.random.default_rng(seed)
    broken = int(rng.integers(0, outliers + 1))
    cover = CountedCover.started(
        walk.measure(6 + outliers, broken), PairOptions(outliers, max_boxes=100)
    )
    options = FEW_CELLS if seed % 2 else CellOptions()
    for _knot in range(12):
        cover = cover.moved(walk.step(), options, walk.place())
        assert levels_hold(walk, cover, broken)
        wrong = int(rng.integers(0, outliers - broken + 1))
        broken += wrong
        if rng.random() < 0.7:
            cover = cover.cut(walk.measure(int(rng.integers(wrong, 4 + wrong)), wrong))
        else:
            broken -= wrong
        assert levels_hold(walk, cover, broken)
        assert len(cover.cells) <= options.max_cells


@pytest.mark.parametrize(
    ('way_m', 'turn_rad', 'step_error', 'turn_error'),
    [
        (1.0, 0.0, 0.1, 0.0),
        (0.0, 0.0, 0.0, 0.0),
        (0.0, 3.0, 0.0, 0.5),
        (2.0, 2.0, 1.0, 1.0),
        (1e-9, 1e-9, 1.0, 1.0),
        (30.0, 9.0, 3.0, 3.0),
    ],
    ids=['straight', 'still', 'turning on the spot', 'bad odometry', 'tiny', 'huge bounds'],
)
def test_hostile_ways_lose_nothing(way_m, turn_rad, step_error, turn_error):
    for seed in range(5):
        walk = Walk(seed, way_m, turn_rad, step_error, turn_error)
        cover = CountedCover.started(walk.measure(6), PairOptions(1, max_boxes=100))
        for knot in range(12):
            cover = cover.moved(walk.step(), FEW_CELLS, walk.place())
            assert walk.is_in(cover.cover)
            assert len(cover.cells) <= FEW_CELLS.max_cells
            assert np.ptp(cover.cells[:, -1, :, 3]) < 6.0 * math.pi + 4.0 * walk.errors[1]
            if knot % 4 == 3:
                cover = cover.cut(walk.measure(2))
                assert walk.is_in(cover.cover)


@pytest.mark.parametrize('seed', range(20))
def test_on_the_way_to_new_cells_nothing_is_lost(seed):
    walk = Walk(seed, step_error=0.0)
    rng = np.random.default_rng(seed)
    cover = CountedCover.started(walk.measure(6), PairOptions(1, max_boxes=100))
    for stop in range(12):
        step, ball_m = walk.step(), 0.1
        angle = rng.uniform(-math.pi, math.pi)
        walk.pose[:2] += (
            rng.choice([0.3, 0.999]) * ball_m * np.array([np.cos(angle), np.sin(angle)])
        )
        cover = cover.carried(step, ball_m)
        assert walk.is_in(cover.cover)
        cover = cover.cut(walk.measure(2))
        assert walk.is_in(cover.cover)
        if stop % 4 == 3:
            cover = cover.gathered(FEW_CELLS, walk.place())
            assert walk.is_in(cover.cover)
            assert len(cover.cells) <= FEW_CELLS.max_cells


def test_what_errs_in_any_direction_widens_a_turned_box_by_no_more():
    pose = np.array([[[[1.0, 2.0, 0.0, 0.8], [1.0, 2.0, 0.0, 0.8]]]])
    step = PastPoses.at_rest(1)
    box = Interval(np.array([[-0.1, -0.1, 0.0]]), np.array([[0.1, 0.1, 0.0]]))
    by_ball = CountedCover(pose).carried(step, 0.1).cover.hull
    by_box = CountedCover(pose).carried(PastPoses(box, step.yaw_rad)).cover.hull
    assert by_ball.widths_m[:2] == pytest.approx([0.2, 0.2])
    assert by_box.widths_m[:2] == pytest.approx(np.full(2, 0.2 * (math.cos(0.8) + math.sin(0.8))))


def test_a_step_without_bounds_leaves_nothing_to_say():
    walk = Walk(0)
    cover = CountedCover.started(walk.measure(6), PairOptions())
    unknown = Interval(np.full((1, 3), -np.inf), np.full((1, 3), np.inf))
    at_rest = PastPoses.at_rest(1)
    assert cover.moved(PastPoses(unknown, at_rest.yaw_rad), FEW_CELLS) is None
    assert cover.moved(PastPoses(at_rest.position_m, unknown[:, 0]), FEW_CELLS) is None
    assert cover.moved(at_rest, FEW_CELLS, ball_m=math.inf) is None


def test_readings_that_do_not_bound_a_position_start_nothing():
    walk = Walk(0)
    readings = walk.measure(3)
    assert CountedCover.started(readings, PairOptions(3)) is None


def test_more_wrong_readings_than_are_tolerated_leave_nothing():
    walk = Walk(3)
    cover = CountedCover.started(walk.measure(8), PairOptions(1))
    for _reading in range(2):
        assert not cover.empty
        far = PairReadings.of(
            Interval.point(ANCHORS_M[:1]),
            Interval.point(np.zeros((1, 3))),
            Interval(np.array([90.0]), np.array([91.0])),
        )
        cover = cover.cut(far)
    assert cover.empty
    assert cover.moved(walk.step(), FEW_CELLS).empty


def test_steps_without_errors_neither_widen_a_cover_nor_break_it_up():
    walk = Walk(5, step_error=0.0, turn_error=0.0)
    options = CellOptions(across=20, slices=40, max_cells=20_000)
    cover = CountedCover.started(walk.measure(8), PairOptions(resolution_m=0.05))
    cover = cover.moved(PastPoses.at_rest(1), options, walk.place())
    before = cover.cover.hull
    for _knot in range(6):
        cover = cover.moved(walk.step(), options, walk.place())
    after = cover.cover.hull
    assert walk.is_in(cover.cover)
    assert after.yaw_width_rad < before.yaw_width_rad + 0.01
    assert np.all(after.widths_m < 1.6 * before.widths_m.max())


def test_carried_and_started_anew_agree_and_carried_is_sharper():
    walk = Walk(8, step_error=0.1, turn_error=0.2)
    parts, since = [walk.measure(4)], []
    cover = CountedCover.started(parts[0], PairOptions())
    for _knot in range(10):
        step = walk.step()
        cover = cover.moved(step, CellOptions(), walk.place())
        since = [PastPoses(_then(past, step), past.yaw_rad - step.yaw_rad) for past in since]
        since.append(PastPoses(_back(step), -step.yaw_rad))
        parts.append(walk.measure(2))
        cover = cover.cut(parts[-1])
    origin = Interval.point(np.zeros((1, 3)))
    seen = []
    for past, part in zip(since, parts, strict=False):
        many = PastPoses(past.position_m[[0] * len(part)], past.yaw_rad[[0] * len(part)])
        rays = many.rays_now(part.rays, part.ray_errors_rad)
        points = many.points_now(origin)
        seen.append(PairReadings.of(part.points_a_m, points, part.distance_m, *rays, True))
    anew = cover_poses(PairReadings.joined([*seen, parts[-1]]), PairOptions(resolution_m=0.05))
    assert walk.is_in(anew) and walk.is_in(cover.cover)
    assert cover.cover.hull.widths_m.max() < anew.hull.widths_m.max()


def _back(step):
    """Return where the body was, seen from where a step has led it."""
    from dg_localization.pairs.turns import turned

    return turned(-step.yaw_rad, -step.position_m)


def _then(past, step):
    """Return a past position, seen from where a step has led the body."""
    from dg_localization.pairs.turns import turned

    return turned(-step.yaw_rad, past.position_m - step.position_m)
