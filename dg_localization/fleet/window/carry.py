# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Observations of a window, carried to the time of a snapshot by the odometry of both ends.

The bodies are the robots, by their indices, and the world with all anchors. A robot without
odometry is left out: how far it may have moved soon says nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.graph import components_of
from dg_localization.fleet.motion import Motion
from dg_localization.fleet.mounts import places_on_body
from dg_localization.fleet.odometry import OdometryPath
from dg_localization.fleet.track_poses import TrackPoses
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.fleet.window.memory import Observation, Window
from dg_localization.fleet.window.paths import Tilt, path_of
from dg_localization.fleet.window.rows import Row, Table
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import sum_up
from dg_localization.poses import Cover, PairReadings, PastPoses

WORLD = -1
"""The body of the anchors."""

Pair = tuple[int, int]
"""Two bodies, the smaller index first: the world before any robot."""


class CarriedWindow:
    """
    What the pairs of bodies observed of each other, seen from where both are now.

    Parameters
    ----------
    config : FleetConfig
    now_s : float
    window : Window
    motion : Motion
    anchors : AnchorGeometry

    """

    def __init__(
        self,
        config: FleetConfig,
        now_s: float,
        window: Window,
        motion: Motion,
        anchors: AnchorGeometry,
    ) -> None:
        self._config = config
        self._now_s = now_s
        self._motion = motion
        self._anchors = anchors
        self._rows: dict[Pair, list[Row]] = {}
        index = {name: i for i, name in enumerate(config.points)}
        for (observer, target), observations in window.observations.items():
            self._add(index[observer], index[target], observations)
        for rows in self._rows.values():
            rows.sort(key=lambda row: -row.observation.stamp_s)
        self._tables = {
            pair: Table.of(rows, pair[0] == WORLD) for pair, rows in self._rows.items()
        }
        self._paths: dict[int, OdometryPath] = {}
        observing = sorted({body for pair in self._rows for body in pair} - {WORLD})
        self._stamps = {robot: self._stamps_with(robot) for robot in observing}

    @cached_property
    def _poses(self) -> dict[int, PastPoses]:
        """Past poses of the robots seen from where they are, for all their observations."""
        return {
            body: self.path(body).past_poses(stamps, self._now_s)
            for body, stamps in self._stamps.items()
        }

    @property
    def pairs(self) -> tuple[Pair, ...]:
        """The pairs that observed anything."""
        return tuple(sorted(self._rows))

    def path(self, robot: int) -> OdometryPath:
        """Return the path of a robot with odometry."""
        if robot not in self._paths:
            name = self._config.robots[robot]
            self._paths[robot] = path_of(self._config, name, self._motion.odometry[name])
        return self._paths[robot]

    def near_pairs(self, most: int, newest_s: float) -> tuple[Pair, ...]:
        """
        Return the pairs of each robot and the `most` others that were nearest at last.

        Only those that observed each other in the `newest_s` before now.
        """
        robots = [
            pair
            for pair in self.pairs
            if pair[0] != WORLD and self._now_s - self._stamps_of(pair)[0] <= newest_s
        ]
        robots.sort(key=lambda pair: self._rows[pair][0].observation.upper_m)
        ranks: Counter[int] = Counter()
        near = []
        for pair in robots:
            if min(ranks[body] for body in pair) < most:
                near.append(pair)
            ranks.update(pair)
        return tuple(near)

    def links_among(self, keys: Iterable[LinkKey]) -> frozenset[LinkKey]:
        """Return the links between bodies whose motions are known: all that can be remembered."""
        index = {name: i for i, name in enumerate(self._config.points)}
        return frozenset(
            key
            for key in keys
            if self._pair_of(index[key.observer], index[key.target]) is not None
        )

    def pairs_apart(self, keys: Iterable[LinkKey], newest_s: float) -> tuple[Pair, ...]:
        """
        Return the pairs of robots that links do not connect, not even by other robots or anchors.

        Only those that observed each other in the `newest_s` before now. A robot that observed
        anchors in the window counts as connected to them.
        """
        config = self._config
        robots = {name: robot for robot, name in enumerate(config.robots)}
        linked = [[robots.get(config.robot_of(end), WORLD) for end in key.ends] for key in keys]
        joined = np.zeros((len(robots) + 1, len(robots) + 1), bool)
        for first, second in [*linked, *(pair for pair in self.pairs if pair[0] == WORLD)]:
            joined[first, second] = joined[second, first] = True
        component_of = {
            robot: number
            for number, together in enumerate(components_of(joined))
            for robot in together
        }
        return tuple(
            pair
            for pair in self.pairs
            if pair[0] != WORLD
            and component_of[pair[0]] != component_of[pair[1]]
            and self._now_s - self._stamps_of(pair)[0] <= newest_s
        )

    def span_s(self, pair: Pair, newest_s: float = math.inf) -> float:
        """Return the age of the oldest observation of a pair in the `newest_s` before now."""
        stamps_s = self._stamps_of(pair)
        oldest_s = stamps_s[stamps_s >= self._now_s - newest_s].min(initial=self._now_s)
        return float(self._now_s - oldest_s)

    def stamps_s(self, pair: Pair) -> NDArray[np.float64]:
        """Return the times of the observations of a pair, newest first."""
        return self._stamps_of(pair)

    def fixes_place(self, pair: Pair, chosen: NDArray[np.intp] | slice = slice(None)) -> bool:
        """
        Return whether some observations of a pair, were they exact, leave finitely many places.

        A turn about one point of the first body changes no range to it and no ray towards it. So
        there have to be two such points, or a ray from the first body, and as many different
        measurements as a pose has coordinates.
        """
        if pair not in self._tables:
            return False
        seen, in_plane = self._tables[pair].some(chosen), self._config.dimension == 2
        by_second = seen.seen_by_second[:, None]
        ranges = np.unique(seen.points[np.isfinite(seen.upper_m)], axis=0)
        sights = np.unique(
            np.hstack([seen.points, by_second])[seen.errors_rad < 0.5 * math.pi], axis=0
        )
        points = np.concatenate([ranges[:, 0], sights[:, 0]])
        if pair[0] == WORLD:
            # Those above each other are as one: a turn about the upright axis.
            points = self._places.lower[points, :2]
        apart = len(np.unique(points, axis=0)) > 1 or bool(np.any(sights[:, 2] == 0))
        count = len(ranges) + len(sights) * (1 if in_plane else 2)
        return apart and count >= (3 if in_plane else 4)

    def sources(self, pair: Pair) -> tuple[tuple[str, str, Observation], ...]:
        """Return the observations of a pair with observer and target, newest first."""
        names = self._config.points
        found = []
        for row in self._rows[pair]:
            first, second = (names[point] for point in row.points)
            ends = (second, first) if row.seen_by_second else (first, second)
            found.append((*ends, row.observation))
        return tuple(found)

    def readings(
        self, pair: Pair, most: int | None = None, newest_s: float = math.inf
    ) -> PairReadings:
        """
        Return the observations of a pair, newest first.

        Those of the `newest_s` before now; at most `most`, spread in time.
        """
        return self._readings(pair, self._poses, most, newest_s)

    def readings_on_tracks(self, pair: Pair, newest_s: float = math.inf) -> PairReadings:
        """
        Return the observations of a pair, newest first, seen from the tracks of both.

        Those of the `newest_s` before now.
        """
        tracks = self._tracks
        past = {body: tracks[body].past for body in pair if body != WORLD}
        return self._readings(pair, past, None, newest_s)

    def off_tracks(self, pair: Pair, cover: Cover) -> Cover:
        """Return the poses of a pair now, by those of their tracks."""
        first, second = pair
        step, ball_m, back = self.path(second).off_track(self._now_s), 0.0, None
        if first != WORLD:
            # A turn about the origin of the first leaves a ball as it is.
            off = self.path(first).off_track(self._now_s)
            ball_m, back = off.ball_m, PastPoses(off.pose.position_m, -off.pose.yaw_rad)
        in_plane = self._config.dimension == 2
        moved = cover.carried(step.pose, sum_up(step.ball_m, ball_m), back, in_plane)
        return cover.unbounded() if moved is None else moved

    @cached_property
    def _tracks(self) -> dict[int, TrackPoses]:
        """Past poses of the robots on their tracks, for all their observations."""
        return {
            body: self.path(body).past_poses_on_track(stamps, self._now_s)
            for body, stamps in self._stamps.items()
        }

    def _readings(
        self, pair: Pair, past: Mapping[int, PastPoses], most: int | None, newest_s: float
    ) -> PairReadings:
        """Return observations of a pair with bodies in these past poses."""
        first, second = pair
        seen = self._tables[pair]
        count = int(np.count_nonzero(seen.stamps_s >= self._now_s - newest_s))
        if most is not None and count > most:
            seen = seen.some(np.linspace(0, count - 1, most).astype(int))
        else:
            seen = seen.some(slice(count))
        poses = self._of(second, seen.stamps_s, past)
        other = PastPoses.at_rest(len(seen.stamps_s))
        if first != WORLD:
            other = self._of(first, seen.stamps_s, past)
        return self._seen(pair, seen, other, poses)

    def _seen(self, pair: Pair, seen: Table, other: PastPoses, poses: PastPoses) -> PairReadings:
        """Return observations of a pair, the poses of whose bodies at their times are given."""
        first, second = pair
        rays, errors_rad = poses.rays_now(*self._leveled_rays(second, seen))
        if first != WORLD:
            others_rays, others_errors_rad = other.rays_now(*self._leveled_rays(first, seen))
            rays = np.where(seen.seen_by_second[:, None], rays, others_rays)
            errors_rad = np.where(seen.seen_by_second, errors_rad, others_errors_rad)
        first_points, second_points = seen.points.T
        return PairReadings.of(
            self._places[first_points]
            if first == WORLD
            else self._points(first_points, seen.stamps_s, other),
            self._points(second_points, seen.stamps_s, poses),
            Interval(seen.lower_m, seen.upper_m),
            rays,
            errors_rad,
            seen.seen_by_second,
        )

    def tilt(self, robot: int) -> Tilt:
        """Return roll and pitch of a robot now."""
        rotations, errors_rad = self.path(robot).tilts([self._now_s])
        return Tilt(rotations[0], float(errors_rad[0]))

    def _add(self, observer: int, target: int, observations: tuple[Observation, ...]) -> None:
        """Add what one point observed of another, if the motion of both is known."""
        pair = self._pair_of(observer, target)
        if pair is None:
            return
        by_second = self._body_of(observer) == pair[1]
        points = (target, observer) if by_second else (observer, target)
        rows = self._rows.setdefault(pair, [])
        rows += [Row(seen, by_second, points) for seen in observations]

    def _pair_of(self, observer: int, target: int) -> Pair | None:
        """Return the bodies of two points; None where both are one or a motion is not known."""
        first, second = self._body_of(observer), self._body_of(target)
        if first is None or second is None or first == second:
            return None
        return min(first, second), max(first, second)

    def _body_of(self, point: int) -> int | None:
        """Return the body of a point; None where the motion is not known."""
        config, name = self._config, self._config.points[point]
        robot = config.robot_of(name)
        if robot in config.anchors:
            # How a parked robot is turned is not known.
            return WORLD if robot == name else None
        if not (self._motion.odometry.get(robot) and config.is_upright(robot)):
            return None
        return config.robots.index(robot)

    def _stamps_of(self, pair: Pair) -> NDArray[np.float64]:
        return self._tables[pair].stamps_s if pair in self._tables else np.empty(0)

    def _stamps_with(self, robot: int) -> NDArray[np.float64]:
        """Return the times of all observations of a robot, ascending."""
        return np.unique(
            np.concatenate([self._stamps_of(pair) for pair in self._rows if robot in pair])
        )

    def _of(
        self, robot: int, stamps: NDArray[np.float64], past: Mapping[int, PastPoses]
    ) -> PastPoses:
        """Return where a robot was at some of the times of its observations."""
        poses = past[robot]
        index = np.searchsorted(self._stamps[robot], stamps)
        return PastPoses(poses.position_m[index], poses.yaw_rad[index])

    def _leveled_rays(
        self, robot: int, seen: Table
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rays of a robot in its level frames, in which rays in the plane are."""
        if self._config.dimension == 2:
            return seen.rays, seen.errors_rad
        return self.path(robot).leveled_rays(seen.stamps_s, seen.rays, seen.errors_rad)

    @cached_property
    def _places(self) -> Interval:
        """The places of the anchors, by their points, shape (n, 3)."""
        lower, upper = np.zeros((2, len(self._config.points), 3))
        for point, box in self._anchors.boxes.items():
            lower[point, : box.lower.size], upper[point, : box.upper.size] = box.lower, box.upper
        return Interval(lower, upper)

    def _points(
        self, points: NDArray[np.int64], stamps_s: NDArray[np.float64], poses: PastPoses
    ) -> Interval:
        """Return where points of a robot were in some past poses, shape (m, 3)."""
        config = self._config
        if not config.sensors:
            return poses.position_m
        names = [config.points[point] for point in points]
        if config.sensors.keys().isdisjoint(names):
            return poses.position_m
        arms_m = places_on_body(config, names)
        if config.dimension == 3:
            robot = config.robots.index(config.robot_of(names[0]))
            arms_m = self.path(robot).leveled_points(stamps_s, arms_m)
        return poses.points_now(arms_m)
