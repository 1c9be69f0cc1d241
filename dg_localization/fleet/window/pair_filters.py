# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Two robots without anchors, followed from knot to knot of their tracks: set-membership filters.

A mutual cover of the directions in which they have each other is carried on by both odometries and
cut by their ranges. All readings seen from now count the errors of the odometries anew for each of
them, which leaves headings twice as wide. As those of robots among anchors (`pose_filters`) such a
filter lives for `FleetConfig.memory_s`, and others start in the meantime: nothing older than the
memory has any effect.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.carry import Pair
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.proved import PoseBounds, heading_arcs, intersect_arcs
from dg_localization.fleet.window.shape_headings import within_bounds
from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.bounds import sum_up
from dg_localization.interval.kernels import COMPILED
from dg_localization.pairs import MutualCover, Ranges, Ways
from dg_localization.pairs.turns import HALF_TURN_UP

PAIR: Pair = (0, 1)

KNOTS = 75
"""In a memory: seen from farther away than from the next knot, readings tell less."""

LONGEST_WAY = 8
"""Knots that are left out at most where the robots are near to each other."""

KNOTS_IN_CELLS = 2
"""So many knots pass before there are new cells, which widen the cover; old ones only grow."""

FILTERS = 3
"""The oldest knows at least all but one part of so many of what is remembered."""


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


@dataclass(frozen=True)
class Directions:
    """
    Where two robots have each other now.

    Parameters
    ----------
    arcs_rad : numpy.ndarray, shape (2, 2)
        The direction of the other in the body frame of each, counterclockwise from the first to
        the second.
    lower_m, upper_m : float
        Bounds of the distance. The lower one is above the upper one where the ranges contradict
        each other.

    """

    arcs_rad: NDArray[np.float64]
    lower_m: float
    upper_m: float

    def tell(self, frame: FixedFrame, robots: tuple[str, ...]) -> bool:
        """Return whether they tell headings in a frame: that of the two robots."""
        return frame.kind is FrameKind.ROBOTS and {*frame.points} == {*robots}

    def leave(
        self, placements: Iterable[Placement], frame: FixedFrame, robots: tuple[str, ...]
    ) -> tuple[Placement, ...]:
        """Return what is left of placements of the two robots."""
        if self.lower_m > self.upper_m:
            return ()
        if not self.tell(frame, robots):
            return tuple(placements)
        other = robots.index(frame.points[1])
        left = (self._around(placement, other) for placement in placements)
        return tuple(placement for placement in left if placement is not None)

    def _around(self, placement: Placement, other: int) -> Placement | None:
        """Return what is left of a placement, of which one robot is on the x axis."""
        enclosure = placement.enclosure_m.copy()
        enclosure[other, 0, 0] = max(enclosure[other, 0, 0], self.lower_m)
        enclosure[other, 1, 0] = min(enclosure[other, 1, 0], self.upper_m)
        # The line of sight points along x, and back.
        back = np.zeros(2)
        back[other] = math.pi
        headings = np.stack([back - self.arcs_rad[:, 1], back - self.arcs_rad[:, 0]], axis=-1)
        headings = np.stack([angle_down(headings[:, 0]), angle_up(headings[:, 1])], axis=-1)
        arcs, met = intersect_arcs(heading_arcs(placement), headings)
        if not np.all(met) or enclosure[other, 0, 0] > enclosure[other, 1, 0]:
            return None
        return within_bounds(placement, PoseBounds(enclosure, arcs))


NOWHERE = Directions(np.tile([-HALF_TURN_UP, HALF_TURN_UP], (2, 1)), math.inf, -math.inf)


class PairFilters:
    """The filters of two robots, the oldest first, in the thread of the estimates."""

    def __init__(self) -> None:
        self._filters: tuple[PairFilter, ...] = ()
        self._lost_s = -math.inf

    def follow(self, snapshot: Snapshot, stopped: Callable[[], bool]) -> Directions | None:
        """
        Follow two robots to now.

        Parameters
        ----------
        snapshot : Snapshot
        stopped : callable
            Asked between knots; once it is true, nothing is said.

        Returns
        -------
        Directions or None
            `NOWHERE` where ranges contradict each other. None for other fleets, while nothing is
            known yet, without compiled kernels, which would take too long, and where outliers are
            tolerated.

        """
        config = snapshot.config
        follows = COMPILED and config.dimension == 2 and len(config.robots) == 2
        if not follows or config.anchors or config.window_outliers:
            return None
        if PAIR not in snapshot.carried.pairs:
            self._filters = ()
            return None
        if self._lost_s > snapshot.stamp_s:
            # The clock was set back.
            self._lost_s = -math.inf
        walk = _Walk(snapshot, stopped)
        filters = [walk.settled(known) for known in self._filters if walk.goes_on(known)]
        kept = [known for known in filters if known is not None]
        kept += walk.started(self._lost_s, kept[-1].since_s if kept else -math.inf)
        self._filters, self._lost_s = tuple(kept), max(self._lost_s, walk.lost_s)
        return walk.directions(kept) if kept else None

    def forget(self, config: FleetConfig, forgotten: Iterable[Forgotten]) -> None:
        """Drop the filters that know of observations that are forgotten."""
        for item in forgotten:
            if any({*ends} == {*config.robots} for ends in item.ends):
                self._filters = tuple(
                    known
                    for known in self._filters
                    if known.since_s > item.before_s or known.knot_s <= item.after_s
                )


class _Walk:
    """
    The way of two robots to the time of a snapshot.

    Parameters
    ----------
    snapshot : Snapshot
    stopped : callable

    Attributes
    ----------
    lost_s : float
        The last knot from which a filter could not be carried on.

    """

    def __init__(self, snapshot: Snapshot, stopped: Callable[[], bool]) -> None:
        self.lost_s = -math.inf
        config, self._carried = snapshot.config, snapshot.carried
        self._now_s, self._stopped = snapshot.stamp_s, stopped
        self._paths = self._carried.path(0), self._carried.path(1)
        self._oldest_s = self._now_s - config.memory_s
        self._between_s = config.memory_s / KNOTS
        self._until_next_s = config.memory_s / FILTERS
        newest_s = min(float(path.stamps_s[-1]) for path in self._paths)
        # No reading of before will be accepted any more, nor a nearer sample.
        self._settled_s = min(self._now_s - config.max_age_s, newest_s)
        seen = [observation for _, _, observation in self._carried.sources(PAIR)]
        self._seen = sorted((one for one in seen if one.has_distance), key=lambda one: one.stamp_s)

    def goes_on(self, known: PairFilter) -> bool:
        """Return whether a filter is in memory, and at samples that are known."""
        if not self._oldest_s <= known.since_s <= known.knot_s <= self._now_s:
            return False
        samples = zip(self._paths, known.samples_s, strict=True)
        return all(bool(np.any(path.stamps_s == sample_s)) for path, sample_s in samples)

    def settled(self, known: PairFilter) -> PairFilter | None:
        """Return a filter at its last knot before which nothing can come any more."""
        found: PairFilter | None = known
        while found is not None and not found.cover.empty and not self._stopped():
            knot_s = self._next_knot_s(found, self._settled_s)
            if knot_s > self._settled_s:
                break
            before_s, found = found.knot_s, self._to(found, knot_s)
            if found is None:
                self.lost_s = max(self.lost_s, before_s)
        return found

    def started(self, lost_s: float, newest_since_s: float) -> Iterator[PairFilter]:
        """
        Yield a filter that starts with the first range that it may, where there is one.

        Not where another one was lost before: it would be lost there, too.
        """
        known_s = max(float(path.stamps_s[0]) for path in self._paths)
        first_s = max(known_s, self._oldest_s, newest_since_s + self._until_next_s)
        for observation in self._seen:
            stamp_s = observation.stamp_s
            in_time = lost_s < stamp_s and first_s <= stamp_s <= self._settled_s
            if in_time and math.isfinite(observation.upper_m):
                lower_m, upper_m = self._ranges([observation], stamp_s).at_end_m
                if not math.isfinite(upper_m):
                    return
                cover = MutualCover.started(lower_m, upper_m)
                found = self.settled(PairFilter(stamp_s, stamp_s, self._samples_s(stamp_s), cover))
                if found is not None:
                    yield found
                return

    def directions(self, filters: list[PairFilter]) -> Directions | None:
        """Return what the oldest of some filters tells now."""
        if any(known.cover.empty for known in filters):
            return NOWHERE
        found: PairFilter | None = filters[0]
        while found is not None and not found.cover.empty and not self._stopped():
            knot_s = self._next_knot_s(found, self._now_s)
            if knot_s >= self._now_s:
                break
            found = self._to(found, knot_s)
        if found is not None and not self._stopped():
            found = self._to(found, self._now_s)
        if found is None or self._stopped():
            return None
        return self._seen_by_robots(found.cover)

    def _seen_by_robots(self, cover: MutualCover) -> Directions | None:
        """Return what a cover of the tracks now tells of the robots."""
        if cover.empty:
            return NOWHERE
        yaws_rad = [path.stated(self._now_s)[2] for path in self._paths]
        first, second = (path.off_track(self._now_s) for path in self._paths)
        ball_m = sum_up(first.ball_m, second.ball_m)
        now = cover.carried(Ways.of(first.pose, second.pose, yaws_rad[0], yaws_rad[1], ball_m))
        if now is None or now.empty:
            return None
        arcs = now.arcs_rad - np.array(yaws_rad)[:, None]
        return Directions(
            np.stack([angle_down(arcs[:, 0]), angle_up(arcs[:, 1])], axis=-1), *now.distance_m
        )

    def _next_knot_s(self, known: PairFilter, until_s: float) -> float:
        """
        Return the time of the next knot; infinite where it is later than a time.

        It is that of a range at which the robots are not near to each other for the way that they
        went: directions change too fast there.
        """
        first_s = known.knot_s + self._between_s
        last_s = known.knot_s + LONGEST_WAY * self._between_s
        for observation in self._seen:
            stamp_s = observation.stamp_s
            if first_s <= stamp_s <= min(last_s, until_s):
                way_m = sum(
                    math.dist(path.stated(known_s)[:2], path.stated(stamp_s)[:2])
                    for path, known_s in zip(self._paths, known.samples_s, strict=True)
                )
                if observation.lower_m >= way_m:
                    return stamp_s
        return last_s if last_s <= until_s else math.inf

    def _samples_s(self, time_s: float) -> tuple[float, float]:
        """Return the stamps of the samples nearest to a time."""
        first, second = (
            float(path.stamps_s[np.argmin(np.abs(path.stamps_s - time_s))]) for path in self._paths
        )
        return first, second

    def _to(self, known: PairFilter, until_s: float) -> PairFilter | None:
        """Return a filter at a later time; None where the way is not bounded."""
        samples_s = self._samples_s(until_s)
        ends = zip(self._paths, known.samples_s, samples_s, strict=True)
        first, second = (path.track_step(before_s, after_s) for path, before_s, after_s in ends)
        yaws_rad = [
            path.stated(sample_s)[2]
            for path, sample_s in zip(self._paths, known.samples_s, strict=True)
        ]
        ball_m = sum_up(first.ball_m, second.ball_m)
        way = Ways.of(first.pose, second.pose, yaws_rad[0], yaws_rad[1], ball_m)
        seen = [one for one in self._seen if known.knot_s < one.stamp_s <= until_s]
        cover = known.cover.carried(way, self._ranges(seen, until_s) if seen else None)
        if cover is None:
            return None
        knots = known.knots_in_cells + 1
        if knots == KNOTS_IN_CELLS:
            cover, knots = cover.gathered(), 0
        return PairFilter(known.since_s, until_s, samples_s, cover, knots)

    def _ranges(self, seen: list[Observation], until_s: float) -> Ranges:
        """Return observations up to a time, seen from the tracks at the samples nearest to it."""
        stamps_s = np.array([one.stamp_s for one in seen])
        first, second = (path.past_poses_on_track(stamps_s, until_s).past for path in self._paths)
        yaws_rad = [path.stated(until_s)[2] for path in self._paths]
        return Ranges(
            Ways.of(first, second, yaws_rad[0], yaws_rad[1]),
            np.array([one.lower_m for one in seen]),
            np.array([one.upper_m for one in seen]),
        )
