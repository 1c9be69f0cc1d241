# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Joint poses of a few bodies: no truth is lost."""

from itertools import combinations
import math
import os

import numpy as np
from pair_cases import around, turn
import pytest

from dg_localization.interval.arrays import Interval
from dg_localization.poses import JointPoses, PairOptions, PairReadings, PastPoses, narrow_jointly

FLEETS = int(os.environ.get('DG_PROPERTY_FLEETS', '60'))


FLAT = np.array([1.0, 1.0, 0.0])


class MovedFleet:
    """Bodies with known places and headings now, and readings of a drive that led there."""

    def __init__(self, seed, *, liars=0, rays=False, error=0.02):
        rng = np.random.default_rng(seed)
        self.count = int(rng.integers(2, 5))
        self.places = rng.normal(size=(self.count, 3)) * 4.0 * FLAT
        self.headings = rng.uniform(-math.pi, math.pi, self.count)
        if rng.random() < 0.2:
            self.headings[:] = rng.choice([0.0, math.pi, -math.pi / 2])
        self.rng, bounds = rng, around(rng, self.places, 0.05 * FLAT)
        self.lower, self.upper = bounds.lower, bounds.upper
        self.lower[:, 2] = self.upper[:, 2] = 0.0
        self.readings = {}
        tracks = [self._track(12, error) for _body in range(self.count)]
        for a, b in combinations(range(self.count), 2):
            self.readings[a, b] = self._pair(a, b, tracks[a], tracks[b], liars, rays)

    def _track(self, count, error):
        """Return past poses in the frame now, true and stated."""
        rng = self.rng
        yaws = np.cumsum(rng.normal(scale=0.3, size=count))
        steps = turn(yaws, np.tile([0.5, 0.0, 0.0], (count, 1)))
        positions = np.cumsum(steps, axis=0)
        growth = np.arange(1, count + 1)[:, None] * error
        stated = PastPoses(around(rng, positions, growth * FLAT), around(rng, yaws, growth[:, 0]))
        return positions, yaws, stated

    def _pair(self, a, b, track_a, track_b, liars, rays):
        """Return ranges at each past time, and rays of A if wanted."""
        rng = self.rng
        lever = np.tile([0.2, 0.1, 0.0], (len(track_a[1]), 1))
        points = [track[0] + turn(track[1], lever) for track in (track_a, track_b)]
        w = self.places[b] + turn(self.headings[b], points[1])
        w = w - self.places[a] - turn(self.headings[a], points[0])
        distance = np.linalg.norm(w, axis=-1)
        bounds = around(rng, distance, 0.02 * distance)
        lower, upper = np.maximum(bounds.lower, 0.0), bounds.upper
        lies = rng.choice(len(w), liars, replace=False)
        lower[lies], upper[lies] = 30.0, 31.0
        mounts = Interval.point(lever)
        seen = ()
        if rays:
            off = rng.uniform(-0.05, 0.05, len(w))
            then = turn(off - track_a[1] - self.headings[a], w)
            seen = track_a[2].rays_now(then, np.full(len(w), 0.06))
        stated = [track[2].points_now(mounts) for track in (track_a, track_b)]
        return PairReadings.of(*stated, Interval(lower, upper), *seen)


def start_of(fleet):
    """Return the places of a fleet, and any headings."""
    turn = np.full(fleet.count, math.pi)
    return JointPoses(fleet.lower, fleet.upper, np.stack([-turn, turn], axis=1))


def holds(fleet, poses):
    """Return whether the true poses are left."""
    inside = (poses.lower_m <= fleet.places) & (fleet.places <= poses.upper_m)
    off = fleet.headings - poses.arcs_rad.mean(axis=1)
    off = np.abs(np.remainder(off + math.pi, 2.0 * math.pi) - math.pi)
    near = off <= 0.5 * np.ptp(poses.arcs_rad, axis=1) + 1e-9
    return poses.ruled_out_by is None and bool(inside.all() and near.all())


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('programs', [0, 24])
@pytest.mark.parametrize('kind', [{}, {'rays': True}, {'error': 0.0}, {'error': 0.1}], ids=str)
def test_no_truth_is_lost(kind, programs):
    gains = []
    for seed in range(FLEETS):
        fleet = MovedFleet(seed, **kind)
        start = start_of(fleet)
        poses = narrow_jointly(start, fleet.readings, PairOptions(0, 0.05, 64, programs))
        assert holds(fleet, poses), seed
        gains.append(np.ptp(poses.arcs_rad, axis=1).sum() / np.ptp(start.arcs_rad, axis=1).sum())
        assert np.all(poses.lower_m >= start.lower_m)
        assert np.all(poses.upper_m <= start.upper_m)
    if kind.get('error') != 0.1:
        assert np.median(gains) < 0.9


@pytest.mark.parametrize('kind', [{'liars': 1}, {'liars': 2, 'rays': True}], ids=str)
def test_no_truth_is_lost_among_liars_of_each_pair(kind):
    for seed in range(FLEETS // 3):
        fleet = MovedFleet(seed, **kind)
        options = PairOptions(kind['liars'], 0.05, 64, 0)
        assert holds(fleet, narrow_jointly(start_of(fleet), fleet.readings, options)), seed
