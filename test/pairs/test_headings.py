# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Headings of bodies at known places: no truth is lost, and mirror images are ruled out."""

from itertools import combinations
import math
import os

import numpy as np
from pair_cases import around, turn
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.pairs import HeadingOptions, PairReadings, PastPoses, narrow_headings

FLEETS = int(os.environ.get('DG_PROPERTY_FLEETS', '60'))
FINE = HeadingOptions(cells=64)


class MovedFleet:
    """Bodies with known places and headings now, and readings of a drive that led there."""

    def __init__(self, seed, *, liars=0, scale_m=1.0, space=False, rays=False, error=0.02):
        rng = np.random.default_rng(seed)
        self.count = int(rng.integers(2, 5))
        flat = np.array([1.0, 1.0, float(space)])
        self.places = rng.normal(size=(self.count, 3)) * 4.0 * scale_m * flat
        self.headings = rng.uniform(-math.pi, math.pi, self.count)
        if rng.random() < 0.2:
            self.headings[:] = rng.choice([0.0, math.pi, -math.pi / 2])
        self.rng, self.scale_m, self.flat = rng, scale_m, flat
        self.lower, self.upper = self._bounds(0.05 * scale_m)
        self.readings = {}
        tracks = [self._track(12, error) for _body in range(self.count)]
        for a, b in combinations(range(self.count), 2):
            self.readings[a, b] = self._pair(a, b, tracks[a], tracks[b], liars, rays)

    def _bounds(self, half):
        bounds = around(self.rng, self.places, half * self.flat)
        return bounds.lower, bounds.upper

    def _track(self, count, error):
        """Return past poses in the frame now, true and stated."""
        rng = self.rng
        yaws = np.cumsum(rng.normal(scale=0.3, size=count))
        steps = turn(yaws, np.tile([0.5 * self.scale_m, 0.0, 0.0], (count, 1)))
        positions = np.cumsum(steps, axis=0)
        growth = np.arange(1, count + 1)[:, None] * error
        stated = PastPoses(
            around(rng, positions, growth * self.scale_m * self.flat),
            around(rng, yaws, growth[:, 0]),
        )
        return positions, yaws, stated

    def _pair(self, a, b, track_a, track_b, liars, rays):
        """Return ranges at each past time, and rays of A if wanted."""
        rng = self.rng
        lever = np.tile(np.array([0.2, 0.1, 0.0]) * self.scale_m, (len(track_a[1]), 1))
        points = [track[0] + turn(track[1], lever) for track in (track_a, track_b)]
        w = self.places[b] + turn(self.headings[b], points[1])
        w = w - self.places[a] - turn(self.headings[a], points[0])
        distance = self.scale_m * np.linalg.norm(w / self.scale_m, axis=-1)
        bounds = around(rng, distance, 0.02 * distance)
        lower, upper = np.maximum(bounds.lower, 0.0), bounds.upper
        lies = rng.choice(len(w), liars, replace=False)
        lower[lies], upper[lies] = 30.0 * self.scale_m, 31.0 * self.scale_m
        mounts = Interval.point(lever)
        seen = ()
        if rays:
            off = rng.uniform(-0.05, 0.05, len(w))
            then = turn(off - track_a[1] - self.headings[a], w)
            seen = track_a[2].rays_now(then, np.full(len(w), 0.06))
        return PairReadings.of(
            track_a[2].points_now(mounts),
            track_b[2].points_now(mounts),
            Interval(lower, upper),
            *seen,
        )

    def holds(self, found):
        """Return whether the true headings and places are left."""
        cells = found.allowed.shape[1]
        place = np.remainder(self.headings, 2.0 * math.pi) / (2.0 * math.pi) * cells
        nearest = [np.floor(place - 1e-9).astype(int) % cells, np.floor(place + 1e-9) % cells]
        rows = np.arange(self.count)
        kept = [found.allowed[rows, np.asarray(cell, dtype=int)] for cell in nearest]
        inside = (found.lower_m <= self.places) & (self.places <= found.upper_m)
        return found.possible and np.all(kept[0] | kept[1]) and np.all(inside)

    def mirrored(self):
        """Return the bounds of the mirror image of the places."""
        signs = np.array([1.0, -1.0, 1.0])
        return np.sort(np.stack([self.lower * signs, self.upper * signs]), axis=0)


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('kind', [{}, {'rays': True}, {'space': True}, {'error': 0.0}], ids=str)
def test_no_truth_is_lost(kind):
    lost = []
    for seed in range(FLEETS):
        fleet = MovedFleet(seed, **kind)
        if not fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, FINE)):
            lost.append(seed)
    assert not lost


@pytest.mark.parametrize('scale_m', [1e-200, 1e-6, 1e6, 1e100])
def test_no_truth_is_lost_at_any_scale(scale_m):
    for seed in range(10):
        fleet = MovedFleet(seed, scale_m=scale_m)
        assert fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, FINE)), seed


@pytest.mark.parametrize('liars', [1, 3])
def test_no_truth_is_lost_among_liars(liars):
    options = HeadingOptions(cells=32, max_outliers=liars)
    contradictions = 0
    for seed in range(FLEETS // 2):
        fleet = MovedFleet(seed, liars=liars)
        assert fleet.holds(narrow_headings(fleet.lower, fleet.upper, fleet.readings, options)), (
            seed
        )
        contradictions += not narrow_headings(fleet.lower, fleet.upper, fleet.readings).possible
    assert contradictions == FLEETS // 2


def test_mirror_images_are_ruled_out_by_a_pair():
    ruled_out, fleets = 0, 0
    for seed in range(FLEETS):
        fleet = MovedFleet(seed, error=0.002)
        if fleet.count < 3:
            continue
        fleets += 1
        found = narrow_headings(*fleet.mirrored(), fleet.readings, FINE)
        assert found.possible == (found.ruled_out_by is None)
        if not found.possible:
            ruled_out += 1
            assert found.ruled_out_by in fleet.readings
            assert not found.allowed.any()
    assert ruled_out > 0.8 * fleets


def test_finer_cells_and_more_readings_leave_less():
    for seed in range(10):
        fleet = MovedFleet(seed)
        coarse = narrow_headings(fleet.lower, fleet.upper, fleet.readings, HeadingOptions(32))
        fine = narrow_headings(fleet.lower, fleet.upper, fleet.readings, HeadingOptions(128))
        assert not np.any(fine.allowed & ~np.repeat(coarse.allowed, 4, axis=1))
        few = {pair: rows[:3] for pair, rows in fleet.readings.items()}
        loose = narrow_headings(fleet.lower, fleet.upper, few, HeadingOptions(32))
        assert not np.any(coarse.allowed & ~loose.allowed)
        assert coarse.allowed.sum() < loose.allowed.sum()


def test_headings_cut_places():
    cut = 0
    for seed in range(20):
        fleet = MovedFleet(seed, rays=True, error=0.001)
        lower, upper = fleet._bounds(1.0)
        found = narrow_headings(lower, upper, fleet.readings, FINE)
        assert fleet.holds(found)
        cut += np.sum(found.upper_m - found.lower_m) < 0.9 * np.sum(upper - lower)
    assert cut > 5


def test_stopped_at_any_time_it_is_complete():
    fleet = MovedFleet(5)
    for looks in (0, 1, 7, 40, 100):
        left = iter([False] * looks)
        found = narrow_headings(
            fleet.lower,
            fleet.upper,
            fleet.readings,
            stopped=lambda left=left: next(left, True),
        )
        assert not found.finished
        assert fleet.holds(found)


def test_what_is_not_known_stays_open():
    fleet = MovedFleet(3)
    lower, upper = fleet.lower.copy(), fleet.upper.copy()
    lower[0], upper[0] = -math.inf, math.inf
    found = narrow_headings(lower, upper, fleet.readings, FINE)
    assert found.possible and found.allowed[0].all()
    assert found.arc_rad(0)[1] - found.arc_rad(0)[0] >= 2.0 * math.pi
    nothing = narrow_headings(fleet.lower, fleet.upper, {})
    assert nothing.possible and nothing.allowed.all()


@pytest.mark.parametrize(
    'wrong', [{'cells': 48}, {'cells': 8}, {'max_outliers': -1}, {'max_rounds': 0}], ids=str
)
def test_what_is_no_option_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        HeadingOptions(**wrong)


def test_an_impossible_hypothesis_has_no_arcs():
    fleet = MovedFleet(1, liars=1)
    found = narrow_headings(fleet.lower, fleet.upper, fleet.readings)
    with pytest.raises(ValueError, match='body 0 has no heading'):
        found.arc_rad(0)
