# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Bodies at known places, and what they measured of each other while they moved there."""

from itertools import combinations
import math

import numpy as np
from pair_cases import around, turn

from dg_localization.interval.arrays import Interval
from dg_localization.poses import PairReadings, PastPoses


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
