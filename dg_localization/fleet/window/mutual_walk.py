# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Two robots followed from knot to knot of their tracks by their ranges."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import math
from typing import Self

import numpy as np

from dg_localization.fleet.odometry import OdometryPath
from dg_localization.fleet.window.carry import CarriedWindow, Pair
from dg_localization.fleet.window.rows import BodyDistance
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import sum_up
from dg_localization.pairs import MutualCover, PastPoses, Ranges, Ways

KNOTS = 75
"""In a memory: seen from farther away than from the next knot, readings tell less."""

LONGEST_WAY = 8
"""Knots that are left out at most where the robots are near to each other."""

KNOTS_IN_CELLS = 2
"""So many knots pass before there are new cells, which widen the cover; old ones only grow."""


@dataclass(frozen=True)
class PairFilter:
    """
    What the ranges of two robots since some time tell of their tracks at a knot.

    Parameters
    ----------
    since_s : float
        The stamp of the first range; older ones have no effect.
    knot_s : float
        Later ranges have none yet.
    samples_s : tuple of float
        The stamps of the samples of both odometries that are nearest to the knot.
    cover : MutualCover
        Of the tracks at these samples, in the odometry frames.
    knots_in_cells : int, optional
        For how many knots its cells have been carried on.

    """

    since_s: float
    knot_s: float
    samples_s: tuple[float, float]
    cover: MutualCover
    knots_in_cells: int = 0


class MutualWalk:
    """
    The way of two robots with some of the ranges between them.

    Parameters
    ----------
    paths : tuple of OdometryPath
        Of both.
    seen : iterable of BodyDistance
        What one observed of the other; those that are not known do not count.
    memory_s : float
        It has so many knots.

    """

    def __init__(
        self,
        paths: tuple[OdometryPath, OdometryPath],
        seen: Iterable[BodyDistance],
        memory_s: float,
    ) -> None:
        self.paths = paths
        self.seen = sorted((one for one in seen if one.is_known), key=lambda one: one.stamp_s)
        self._between_s = memory_s / KNOTS

    @classmethod
    def of(cls, carried: CarriedWindow, pair: Pair, memory_s: float) -> Self:
        """Return the way of two robots with all ranges of a window."""
        paths = carried.path(pair[0]), carried.path(pair[1])
        return cls(paths, carried.distances(pair), memory_s)

    @property
    def known_s(self) -> float:
        """Since when both odometries are known."""
        return max(float(path.stamps_s[0]) for path in self.paths)

    def started(self, observation: BodyDistance) -> PairFilter | None:
        """Return a filter that starts with a range; None where it is not bounded."""
        stamp_s = observation.stamp_s
        lower_m, upper_m = self._ranges([observation], stamp_s).at_end_m
        if not math.isfinite(upper_m):
            return None
        cover = MutualCover.started(lower_m, upper_m)
        return PairFilter(stamp_s, stamp_s, self._samples_s(stamp_s), cover)

    def arrived(
        self, known: PairFilter, until_s: float, stopped: Callable[[], bool]
    ) -> PairFilter | None:
        """
        Return a filter at a later time, or where its cover runs empty before.

        None where the way is not bounded. Once `stopped` is true it goes no farther.
        """
        found: PairFilter | None = known
        while found is not None and not found.cover.empty and not stopped():
            knot_s = self.next_knot_s(found, until_s)
            if knot_s >= until_s:
                return self.to(found, until_s)
            found = self.to(found, knot_s)
        return found

    def contradicts(self, stopped: Callable[[], bool]) -> bool:
        """
        Return whether no motion of the robots agrees with all of the ranges.

        True is a proof. Once `stopped` is true, what is not proved by then is not said. There is a
        knot at each range, where the robots are near to each other, too: a knot from which it
        does not go on is left out, and a narrow pass often shows who is wrong.
        """
        known_s, last_s = self.known_s, self.seen[-1].stamp_s if self.seen else 0.0
        found: PairFilter | None = None
        for observation in self.seen:
            stamp_s = observation.stamp_s
            if stopped():
                return False
            if found is None:
                if stamp_s >= known_s and math.isfinite(observation.upper_m):
                    found = self.started(observation)
            elif stamp_s >= min(found.knot_s + self._between_s, last_s):
                found = self.to(found, stamp_s) or found
            if found is not None and found.cover.empty:
                return True
        return False

    def next_knot_s(self, known: PairFilter, until_s: float) -> float:
        """
        Return the time of the next knot; infinite where it is later than a time.

        It is that of a range at which the robots are not near to each other for the way that they
        went: directions change too fast there.
        """
        first_s = known.knot_s + self._between_s
        last_s = known.knot_s + LONGEST_WAY * self._between_s
        for observation in self.seen:
            stamp_s = observation.stamp_s
            if first_s <= stamp_s <= min(last_s, until_s):
                way_m = sum(
                    math.dist(path.stated(known_s)[:2], path.stated(stamp_s)[:2])
                    for path, known_s in zip(self.paths, known.samples_s, strict=True)
                )
                if observation.lower_m - observation.reach_m >= way_m:
                    return stamp_s
        return last_s if last_s <= until_s else math.inf

    def to(self, known: PairFilter, until_s: float) -> PairFilter | None:
        """Return a filter at a later time; None where the way is not bounded."""
        samples_s = self._samples_s(until_s)
        ends = zip(self.paths, known.samples_s, samples_s, strict=True)
        first, second = (path.track_step(before_s, after_s) for path, before_s, after_s in ends)
        yaws_rad = [
            path.stated(sample_s)[2]
            for path, sample_s in zip(self.paths, known.samples_s, strict=True)
        ]
        ball_m = sum_up(first.ball_m, second.ball_m)
        way = Ways.of(first.pose, second.pose, yaws_rad[0], yaws_rad[1], ball_m)
        seen = [one for one in self.seen if known.knot_s < one.stamp_s <= until_s]
        cover = known.cover.carried(way, self._ranges(seen, until_s) if seen else None)
        if cover is None:
            return None
        knots = known.knots_in_cells + 1
        if knots == KNOTS_IN_CELLS:
            cover, knots = cover.gathered(), 0
        return PairFilter(known.since_s, until_s, samples_s, cover, knots)

    def _samples_s(self, time_s: float) -> tuple[float, float]:
        """Return the stamps of the samples nearest to a time."""
        first, second = (
            float(path.stamps_s[np.argmin(np.abs(path.stamps_s - time_s))]) for path in self.paths
        )
        return first, second

    def _ranges(self, seen: list[BodyDistance], until_s: float) -> Ranges:
        """Return observations up to a time, seen from the tracks at the samples nearest to it."""
        stamps_s = np.array([one.stamp_s for one in seen])
        first, second = (
            _points(
                path.past_poses_on_track(stamps_s, until_s).past,
                Interval.stack([one.arms_m[end] for one in seen], axis=0),
            )
            for end, path in enumerate(self.paths)
        )
        yaws_rad = [path.stated(until_s)[2] for path in self.paths]
        return Ranges(
            Ways.of(first, second, yaws_rad[0], yaws_rad[1]),
            np.array([one.lower_m for one in seen]),
            np.array([one.upper_m for one in seen]),
        )


def _points(poses: PastPoses, arms_m: Interval) -> PastPoses:
    """Return poses of points on a body that was in some poses; at its origin they are these."""
    if not (arms_m.lower.any() or arms_m.upper.any()):
        return poses
    return PastPoses(poses.points_now(arms_m), poses.yaw_rad)
