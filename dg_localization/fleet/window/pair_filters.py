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
from dg_localization.fleet.window.mutual_walk import MutualWalk, PairFilter
from dg_localization.fleet.window.proved import PoseBounds, heading_arcs, intersect_arcs
from dg_localization.fleet.window.shape_headings import within_bounds
from dg_localization.interval.angles import angle_down, angle_up, cosine_and_sine
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import sum_up
from dg_localization.interval.kernels import COMPILED
from dg_localization.pairs import MutualCover, Ways
from dg_localization.pairs.turns import HALF_TURN_UP

PAIR: Pair = (0, 1)

FILTERS = 3
"""The oldest knows at least all but one part of so many of what is remembered."""


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
        self, placement: Placement, frame: FixedFrame, robots: tuple[str, ...]
    ) -> Placement | None:
        """Return what is left of a placement of the two robots."""
        if self.lower_m > self.upper_m:
            return None
        if self.tell(frame, robots):
            bounds = self._on_x_axis(robots.index(frame.points[1]))
        elif frame.kind is FrameKind.HEADING:
            bounds = self._seen_from(robots.index(frame.points[0]))
        else:
            return placement
        return _within(placement, bounds)

    def _on_x_axis(self, other: int) -> PoseBounds:
        """Return bounds in a frame that has one robot at its origin, and the other ahead on x."""
        enclosure_m = np.tile([[-math.inf], [math.inf]], (2, 1, 2))
        enclosure_m[other, :, 0] = self.lower_m, self.upper_m
        # The line of sight points along x, and back.
        back_rad = np.zeros(2)
        back_rad[other] = math.pi
        return PoseBounds(enclosure_m, _less(np.stack([back_rad] * 2, axis=-1), self.arcs_rad))

    def _seen_from(self, reference: int) -> PoseBounds:
        """Return bounds in the body frame of one robot."""
        other, arc_rad = 1 - reference, self.arcs_rad[reference]
        axes = cosine_and_sine(Interval(arc_rad[0], arc_rad[1]))
        place_m = Interval(np.array(self.lower_m), np.array(self.upper_m)) * axes
        enclosure_m = np.tile([[-math.inf], [math.inf]], (2, 1, 2))
        enclosure_m[other] = place_m.lower, place_m.upper
        arcs_rad = np.tile([-HALF_TURN_UP, HALF_TURN_UP], (2, 1))
        # The line of sight points back to the reference.
        arcs_rad[other] = _less(arc_rad + math.pi, self.arcs_rad[other])
        return PoseBounds(enclosure_m, arcs_rad)


def _less(first_rad: NDArray[np.float64], second_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return arcs less others, shape (..., 2)."""
    low, high = first_rad[..., 0] - second_rad[..., 1], first_rad[..., 1] - second_rad[..., 0]
    return np.stack([angle_down(low), angle_up(high)], axis=-1)


def _within(placement: Placement, bounds: PoseBounds) -> Placement | None:
    """Return what bounds leave of a placement."""
    enclosure_m = np.stack(
        [
            np.maximum(placement.enclosure_m[:, 0], bounds.enclosure_m[:, 0]),
            np.minimum(placement.enclosure_m[:, 1], bounds.enclosure_m[:, 1]),
        ],
        axis=1,
    )
    arcs_rad, met = intersect_arcs(heading_arcs(placement), bounds.arcs_rad)
    if not np.all(met) or np.any(enclosure_m[:, 0] > enclosure_m[:, 1]):
        return None
    return within_bounds(placement, PoseBounds(enclosure_m, arcs_rad))


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
            if any({*map(config.robot_of, ends)} == {*config.robots} for ends in item.ends):
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
        self._oldest_s = self._now_s - config.memory_s
        self._until_next_s = config.memory_s / FILTERS
        self._walk = MutualWalk.of(self._carried, PAIR, config.memory_s)
        newest_s = min(float(path.stamps_s[-1]) for path in self._walk.paths)
        # No reading of before will be accepted any more, nor a nearer sample.
        self._settled_s = min(self._now_s - config.max_age_s, newest_s)

    def goes_on(self, known: PairFilter) -> bool:
        """Return whether a filter is in memory, and at samples that are known."""
        if not self._oldest_s <= known.since_s <= known.knot_s <= self._now_s:
            return False
        samples = zip(self._walk.paths, known.samples_s, strict=True)
        return all(bool(np.any(path.stamps_s == sample_s)) for path, sample_s in samples)

    def settled(self, known: PairFilter) -> PairFilter | None:
        """Return a filter at its last knot before which nothing can come any more."""
        found: PairFilter | None = known
        while found is not None and not found.cover.empty and not self._stopped():
            knot_s = self._walk.next_knot_s(found, self._settled_s)
            if knot_s > self._settled_s:
                break
            before_s, found = found.knot_s, self._walk.to(found, knot_s)
            if found is None:
                self.lost_s = max(self.lost_s, before_s)
        return found

    def started(self, lost_s: float, newest_since_s: float) -> Iterator[PairFilter]:
        """
        Yield a filter that starts with the first range that it may, where there is one.

        Not where another one was lost before: it would be lost there, too.
        """
        first_s = max(self._walk.known_s, self._oldest_s, newest_since_s + self._until_next_s)
        for observation in self._walk.seen:
            stamp_s = observation.stamp_s
            in_time = lost_s < stamp_s and first_s <= stamp_s <= self._settled_s
            if in_time and math.isfinite(observation.upper_m):
                start = self._walk.started(observation)
                found = None if start is None else self.settled(start)
                if found is not None:
                    yield found
                return

    def directions(self, filters: list[PairFilter]) -> Directions | None:
        """Return what the oldest of some filters tells now."""
        if any(known.cover.empty for known in filters):
            return NOWHERE
        found = self._walk.arrived(filters[0], self._now_s, self._stopped)
        if found is None or self._stopped():
            return None
        return self._seen_by_robots(found.cover)

    def _seen_by_robots(self, cover: MutualCover) -> Directions | None:
        """Return what a cover of the tracks now tells of the robots."""
        if cover.empty:
            return NOWHERE
        yaws_rad = [path.stated(self._now_s)[2] for path in self._walk.paths]
        first, second = (path.off_track(self._now_s) for path in self._walk.paths)
        ball_m = sum_up(first.ball_m, second.ball_m)
        now = cover.carried(Ways.of(first.pose, second.pose, yaws_rad[0], yaws_rad[1], ball_m))
        if now is None or now.empty:
            return None
        arcs = now.arcs_rad - np.array(yaws_rad)[:, None]
        return Directions(
            np.stack([angle_down(arcs[:, 0]), angle_up(arcs[:, 1])], axis=-1), *now.distance_m
        )
