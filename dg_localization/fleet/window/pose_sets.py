# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Pose sets of robots among the anchors and relative to each other, by the window."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
import math

import numpy as np

from dg_localization.fleet.constraints.distances import PairBounds
from dg_localization.fleet.constraints.rays import RayBundle
from dg_localization.fleet.mounts import AHEAD, Sight, readings_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import Forgotten, ends_between, ends_of
from dg_localization.fleet.window.memory import WORLD, Pair
from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.interval.bounds import squared_distance
from dg_localization.poses import (
    NO_RAY_RAD,
    Cover,
    PairOptions,
    PairReadings,
    count_agreeing,
    cover_poses,
)

RESOLUTION_M = 0.15
MOST_BOXES = 1000


@dataclass(frozen=True)
class PoseSets:
    """
    Pose sets of robots by a window.

    Parameters
    ----------
    sets : mapping of (int, int) to Cover
        The sets that bound the position of the second body of a pair, in the frame of the first.
    of_whole_memory : bool
        Whether a set uses the whole memory, not only its newer part.
    of_moment : mapping of int to Cover
        Sets of robots without a set of the window, by ranges and rays of the moment alone.
    loose : frozenset of (int, int)
        The pairs whose places would be a continuum even with exact readings.

    """

    sets: Mapping[Pair, Cover] = field(default_factory=dict)
    of_whole_memory: bool = False
    of_moment: Mapping[int, Cover] = field(default_factory=dict)
    loose: frozenset[Pair] = frozenset()

    @property
    def covers(self) -> dict[int, Cover]:
        """The sets of robots among the anchors, by robot."""
        return {pair[1]: cover for pair, cover in self.sets.items() if pair[0] == WORLD}

    def distances(self, snapshot: Snapshot) -> Iterator[tuple[PairBounds, bool]]:
        """
        Yield pairs of points, bounds of their squared distances in m^2, and whether each is loose.

        Distances to a few anchors suffice: the cover itself narrows the answer afterwards.
        """
        boxes, used = snapshot.anchors.boxes, snapshot.anchors.spanning
        origin = Interval.point(np.zeros(snapshot.config.dimension))
        for pair, cover in self.sets.items():
            first, second = pair
            places = {i: boxes[i] for i in used} if first == WORLD else {first: origin}
            bounds_m2 = _squared_distances_m2(cover, [*places.values()])
            for point, near_m2, far_m2 in zip(places, *bounds_m2, strict=True):
                yield (second, point, near_m2, far_m2), pair in self.loose


NO_POSE_SETS = PoseSets()


def place_robots(
    snapshot: Snapshot,
    share_of_time: Callable[[float], Callable[[], bool]],
    newest_s: float,
    earlier: EarlierSets,
) -> tuple[PoseSets, tuple[Forgotten, ...]]:
    """
    Return the pose sets of robots that observed anchors in a window, and what to forget.

    Two robots that observed each other get a pose set in three cases: no measurement of now
    connects them; they are the whole fleet and there are no anchors; or outliers are tolerated, so
    that no single reading can be trusted, and not both robots are placed. `share_of_time` gives
    each set a share of the remaining time. Observations of robots that are apart count for
    `newest_s`; `earlier` sets are carried to now.
    """
    carried = snapshot.carried
    anchored = bool(snapshot.anchors.cores)
    robots_too = snapshot.config.window_outliers > 0
    alone = not anchored and len(snapshot.config.robots) == 2
    # That a target is far does not connect it.
    near = (distance.key for distance in snapshot.distances if distance.upper_m < math.inf)
    apart = carried.pairs_apart(near, newest_s)
    known = sorted(earlier.pairs.union(carried.tables))
    pairs = [
        pair
        for pair in known
        if (anchored if pair[0] == WORLD else alone or robots_too or pair in apart)
    ]
    earlier.doubts.keep(known, snapshot.stamp_s)
    covers: dict[Pair, Cover] = {}
    forgotten: list[Forgotten] = []
    in_doubt: set[int] = set()
    loose: set[Pair] = set()
    for number, pair in enumerate(pairs):
        stopped = share_of_time(1.0 / (len(pairs) - number))
        placed = pair[0] != WORLD and all((WORLD, robot) in covers for robot in pair)
        if not in_doubt.isdisjoint(pair) or (placed and pair not in apart):
            continue
        found = _place(snapshot, pair, earlier, newest_s if pair in apart else math.inf, stopped)
        if found is None:
            continue
        if not isinstance(found, _Contradiction):
            cover, fixed = found
            stamps_s, complete = carried.stamps_s(pair), not stopped()
            if earlier.doubts.settled(pair, stamps_s, snapshot.stamp_s, complete):
                if cover.bounded:
                    covers[pair] = cover
                    loose |= set() if fixed else {pair}
                continue
        else:
            is_new = not earlier.doubts.about(pair)
            agreed_s = earlier.doubts.contradicted(pair, snapshot.stamp_s)
            # Late readings may be as old as this.
            after_s = agreed_s - snapshot.config.max_age_s
            forgotten.append(_what_contradicts(snapshot, pair, found.since_s, after_s))
            if pair[0] == WORLD and (is_new or agreed_s == -math.inf):
                forgotten.append(_what_odometry_carries(snapshot, pair[1], agreed_s, is_new))
        earlier.set_back(pair)
        in_doubt |= {pair[1]} if pair[0] == WORLD else set()
    is_whole = not covers.keys() <= {*apart}
    return PoseSets(covers, is_whole, loose=frozenset(loose)), tuple(forgotten)


def place_by_moment(snapshot: Snapshot, placed: Collection[int]) -> dict[int, Cover]:
    """
    Return the poses of robots in the plane that see anchors, without odometry.

    All sensors of a robot are combined, with rays to anchors that it does not range. Robots in
    `placed`, and robots whose measurements contradict each other or bound nothing, are left out.
    """
    config = snapshot.config
    if config.dimension != 2 or not snapshot.anchors.boxes:
        return {}
    options = PairOptions(config.window_outliers, config.solver.resolution)
    found = {}
    for robot, name in enumerate(config.robots):
        if robot not in placed and name not in config.anchors:
            readings = _readings_of_moment(snapshot, name)
            cover = None if readings is None else cover_poses(readings, options)
            if cover is not None and cover.bounded and not cover.empty:
                found[robot] = cover
    return found


def _readings_of_moment(snapshot: Snapshot, robot: str) -> PairReadings | None:
    """Return the readings between a robot and anchors now; None if it sees no anchor."""
    config, now_s = snapshot.config, snapshot.stamp_s
    anchors = {name: snapshot.anchors.boxes.get(config.rows[name]) for name in config.anchors}
    own = config.points_on(robot)
    sights: list[Sight] = []
    for ray in snapshot.rays:
        place = anchors.get(ray.key.target)
        if ray.key.observer in own and place is not None:
            (turned,) = RayBundle([ray], 1, snapshot.motion).now(now_s)
            off_m = np.full(2, ray.displacement_m)
            around, anywhere = place + Interval(-off_m, off_m), (0.0, math.inf)
            sight = ray.key.observer, around, anywhere, turned.direction, turned.half_width_rad
            sights.append(sight)
    if not sights:
        return None
    for end, place, distance in snapshot.ranges_of_anchors(own):
        bounds_m = distance.lower_m, distance.upper_m
        if bounds_m[0] <= bounds_m[1]:
            sights.append((end, place, bounds_m, AHEAD, NO_RAY_RAD))
    return readings_of(config, sights)


@dataclass(frozen=True)
class _Contradiction:
    """
    The observations of a pair leave no pose.

    Parameters
    ----------
    since_s : float or None
        Newer observations contradict those up to this time; None if the time is unknown.

    """

    since_s: float | None


def _place(
    snapshot: Snapshot,
    pair: Pair,
    earlier: EarlierSets,
    newest_s: float,
    stopped: Callable[[], bool],
) -> tuple[Cover, bool] | _Contradiction | None:
    """
    Return the poses of a pair now, and whether its readings fix the places if they are exact.

    Return None if the window has no reading and odometry does not carry an earlier set to now.
    """
    carried, in_plane = snapshot.carried, snapshot.config.dimension == 2
    options = PairOptions(snapshot.config.window_outliers, RESOLUTION_M, MOST_BOXES)
    height_m = (0.0, 0.0) if in_plane else (-math.inf, math.inf)
    followed = None
    if newest_s == math.inf:
        followed = earlier.place(snapshot, pair, options, stopped)
    if followed is not None and not followed[0].empty:
        cover, fixed = followed
        return _unless_contradicted(snapshot, pair, carried.off_tracks(pair, cover), fixed)
    if not len(carried.stamps_s(pair)):
        return None
    readings = carried.readings(pair, newest_s, on_tracks=True)
    cover = cover_poses(readings, options, height_m=height_m, stopped=stopped)
    if cover.empty:
        agreeing = count_agreeing(readings, options, height_m=height_m, stopped=stopped)
        # The count may be cut short, and then show no contradiction.
        shown = agreeing < len(readings)
        return _Contradiction(float(carried.stamps_s(pair)[agreeing]) if shown else None)
    if followed is not None:
        return _Contradiction(None)
    fixed = carried.fixes_place(pair, slice(len(readings)))
    if not cover.bounded:
        return cover, fixed
    return _unless_contradicted(snapshot, pair, carried.off_tracks(pair, cover), fixed)


def _unless_contradicted(
    snapshot: Snapshot, pair: Pair, cover: Cover, fixed: bool
) -> tuple[Cover, bool] | _Contradiction:
    """
    Return the poses of a pair, unless a range of the moment agrees with none of them.

    The window does not hold all ranges of a sensor that is faster than the time slots.
    """
    config = snapshot.config
    if pair[0] != WORLD or config.window_outliers > 0:
        return cover, fixed
    for _, place, distance in snapshot.ranges_of_anchors([config.robots[pair[1]]]):
        near_m2, far_m2 = squared_distance(distance.lower_m, distance.upper_m)
        if near_m2 <= far_m2:
            (lower_m2,), (upper_m2,) = _squared_distances_m2(cover, [place])
            if upper_m2 < near_m2 or far_m2 < lower_m2:
                return _Contradiction(snapshot.stamp_s)
    return cover, fixed


def _squared_distances_m2(cover: Cover, places: list[Interval]) -> tuple[list[float], list[float]]:
    """Return bounds of the squared distances from all poses of a cover to places of shape (q,)."""
    there = Interval.stack(places, axis=0)
    q = there.lower.shape[1]
    boxes = Interval(cover.boxes[:, 0, :q], cover.boxes[:, 1, :q])
    squared = squared_norm(boxes[:, None] - there[None])
    near_m2, far_m2 = squared.lower.min(axis=0), squared.upper.max(axis=0)
    return np.maximum(near_m2, 0.0).tolist(), far_m2.tolist()


def _what_contradicts(
    snapshot: Snapshot, pair: Pair, since_s: float | None, after_s: float
) -> Forgotten:
    """Return what to forget when observations of a pair up to a time contradict newer ones."""
    robots, now_s = snapshot.config.robots, snapshot.stamp_s
    first, second = pair
    name = 'the anchors' if first == WORLD else robots[first]
    text = f'what {robots[second]} and {name} measured of each other '
    if since_s is None:
        text += 'contradicts itself'
    else:
        text += f'more than {now_s - since_s:.1f} s ago contradicts what they measured since'
    return Forgotten(
        ends=ends_of(snapshot.config, [pair]),
        before_s=now_s,
        text=text,
        after_s=after_s,
        now_too=True,
    )


def _what_odometry_carries(
    snapshot: Snapshot, robot: int, agreed_s: float, now_too: bool
) -> Forgotten:
    """Return the observations between robots to forget, or to leave out, if odometry is wrong."""
    robots, now_s = snapshot.config.robots, snapshot.stamp_s
    others = [other for other in robots if other != robots[robot]]
    return Forgotten(
        ends=ends_between(snapshot.config, robots[robot], others),
        before_s=now_s,
        text=f'the odometry of {robots[robot]} may be wrong',
        after_s=-math.inf if agreed_s == -math.inf else now_s,
        now_too=now_too,
    )


def poses_within(cover: Cover, lower_m: np.ndarray, upper_m: np.ndarray) -> Cover:
    """Return the part of a cover with positions in a box, shape (q,)."""
    q = len(lower_m)
    lower, upper = cover.boxes[:, 0, :q], cover.boxes[:, 1, :q]
    boxes = cover.boxes[np.all((lower <= upper_m) & (lower_m <= upper), axis=1)]
    boxes[:, 0, :q] = np.maximum(boxes[:, 0, :q], lower_m)
    boxes[:, 1, :q] = np.minimum(boxes[:, 1, :q], upper_m)
    return Cover(boxes, cover.refined)
