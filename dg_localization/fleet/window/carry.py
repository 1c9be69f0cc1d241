# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Observations of a window, carried to the time of a snapshot by the odometry of both bodies.

The bodies are the robots, by index, and the world, which holds all anchors. Robots without
odometry are left out: bounds of their motion by speed alone soon become useless.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from itertools import pairwise
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.motion import Motion, way_between
from dg_localization.fleet.mounts import places_on_body
from dg_localization.fleet.odometry import MotionLimits, OdometryPath
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.fleet.window.memory import WORLD, Pair, Table, Window
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import sum_up
from dg_localization.poses import NO_RAY_RAD, Cover, PairReadings, PastPoses


class Tilt(NamedTuple):
    """The rotation from the body frame of a robot to its level frame, and a bound of its error."""

    rotation: NDArray[np.float64]
    error_rad: float


class CarriedWindow:
    """
    The observations between pairs of bodies, carried to the poses of both now.

    `tables` holds the observations of each pair, newest first.
    """

    def __init__(
        self, now_s: float, window: Window, motion: Motion, anchors: AnchorGeometry
    ) -> None:
        self._config, self._motion = motion.config, motion
        self._now_s, self._anchors = now_s, anchors
        parts: dict[Pair, list[Table]] = {}
        for (observer, target, *reference), seen in window.observations.items():
            pair = self._pair_of(observer, target)
            if pair is not None:
                by_second = self._body_of(observer) == pair[1]
                own, *others = (self._config.rows[p] for p in (observer, target, *reference))
                points, references = (
                    (other, own) if by_second else (own, other)
                    for other in (others[0], others[-1])
                )
                table = Table.of(seen, by_second, points, references)
                if pair[0] == WORLD and not by_second:
                    # The orientation of an anchor is unknown.
                    table.errors_rad[:] = NO_RAY_RAD
                parts.setdefault(pair, []).append(table)
        self.tables = {
            pair: Table.joined(some).newest_first() for pair, some in sorted(parts.items())
        }
        self._paths: dict[int, OdometryPath] = {}
        # Past poses at all observations of a robot, seen from its pose now or from its track.
        self._past: dict[tuple[int, bool], PastPoses] = {}
        observing = {body for pair in self.tables for body in pair} - {WORLD}
        # The times of all observations of a robot, ascending.
        self._stamps = {
            robot: np.unique(
                np.concatenate([t.stamps_s for pair, t in self.tables.items() if robot in pair])
            )
            for robot in sorted(observing)
        }

    def path(self, robot: int) -> OdometryPath:
        """Return the path of a robot with odometry."""
        if robot not in self._paths:
            config, name = self._config, self._config.robots[robot]
            readings = self._motion.odometry[name]
            self._paths[robot] = OdometryPath(
                [reading.stamp_s for reading in readings],
                [reading.position_m for reading in readings],
                [reading.rotation for reading in readings],
                config.odometry_error_of(name),
                MotionLimits(config.speed_m_s(name), config.max_turn_rate_rad_s),
                config.dimension,
                {
                    number: way_between(before, reading)
                    for number, (before, reading) in enumerate(pairwise(readings), 1)
                    if before.restarted_s != reading.restarted_s
                },
            )
        return self._paths[robot]

    def near_pairs(self, most: int, newest_s: float) -> tuple[Pair, ...]:
        """
        Return the pairs of each robot with the `most` robots that were nearest last.

        Only pairs that observed each other in the last `newest_s` seconds count.
        """

        def last_m(pair: Pair) -> float:
            upper_m = self.tables[pair].upper_m
            return float(upper_m[np.isfinite(upper_m).argmax()])

        robots = sorted(self._pairs_of_robots(newest_s), key=last_m)
        ranks: Counter[int] = Counter()
        near = []
        for pair in robots:
            if min(ranks[body] for body in pair) < most:
                near.append(pair)
            ranks.update(pair)
        return tuple(near)

    def links_among(self, keys: Iterable[LinkKey]) -> frozenset[LinkKey]:
        """Return the links between bodies with known motion: only these can be remembered."""
        return frozenset(key for key in keys if self._pair_of(*key.ends) is not None)

    def pairs_apart(self, keys: Iterable[LinkKey], newest_s: float) -> tuple[Pair, ...]:
        """
        Return the pairs of robots that no chain of links connects, over robots or anchors.

        Only pairs that observed each other in the last `newest_s` seconds count. A robot that
        observed anchors in the window counts as connected to them.
        """
        config = self._config
        robots = {name: robot for robot, name in enumerate(config.robots)}
        linked = [[robots.get(config.robot_of(end), WORLD) for end in key.ends] for key in keys]
        together = {body: body for body in (WORLD, *robots.values())}
        for first, second in [*linked, *(pair for pair in self.tables if pair[0] == WORLD)]:
            old, new = together[first], together[second]
            if old != new:
                together = {body: new if one == old else one for body, one in together.items()}
        return tuple(
            (first, second)
            for first, second in self._pairs_of_robots(newest_s)
            if together[first] != together[second]
        )

    def span_s(self, pair: Pair, newest_s: float = math.inf) -> float:
        """Return the age of the oldest observation of a pair in the last `newest_s` seconds."""
        stamps_s = self.stamps_s(pair)
        oldest_s = stamps_s[stamps_s >= self._now_s - newest_s].min(initial=self._now_s)
        return float(self._now_s - oldest_s)

    def stamps_s(self, pair: Pair) -> NDArray[np.float64]:
        """Return the times of the observations of a pair, newest first."""
        return self.tables[pair].stamps_s if pair in self.tables else np.empty(0)

    def fixes_place(self, pair: Pair, chosen: NDArray[np.intp] | slice = slice(None)) -> bool:
        """
        Return whether observations of a pair would leave finitely many places if they were exact.

        A rotation about one point of the first body changes no range to it and no ray towards it.
        So the observations must use two such points, or a ray from the first body, and as many
        different measurements as a pose has coordinates.
        """
        if pair not in self.tables:
            return False
        seen, in_plane = self.tables[pair].some(chosen), self._config.dimension == 2
        by_second = seen.seen_by_second[:, None]
        heard = seen.some(seen.differences)
        ranges = np.unique(seen.points[np.isfinite(seen.upper_m)], axis=0)
        sights = np.unique(
            np.hstack([seen.points, by_second])[seen.errors_rad < 0.5 * math.pi], axis=0
        )
        # Of k points that a sensor hears, k - 1 differences are independent.
        beacons = np.unique(np.concatenate([heard.points, heard.references]), axis=0)
        sensors = np.unique(heard.points[heard.points == heard.references])
        points = np.concatenate([ranges[:, 0], sights[:, 0], beacons[:, 0]])
        if pair[0] == WORLD:
            # Points above each other count once: both may lie on the vertical axis of a rotation.
            points = self._places.lower[points, :2]
        apart = len(np.unique(points, axis=0)) > 1 or bool(np.any(sights[:, 2] == 0))
        count = len(ranges) + len(sights) * (1 if in_plane else 2)
        count += len(beacons) - len(sensors)
        return apart and count >= (3 if in_plane else 4)

    def readings(
        self,
        pair: Pair,
        newest_s: float = math.inf,
        *,
        most: int | None = None,
        on_tracks: bool = False,
    ) -> PairReadings:
        """
        Return the observations of a pair within the last `newest_s` seconds, newest first.

        At most `most` are returned, spread in time. They are relative to the poses of both bodies
        now, or to those of their tracks.
        """
        first, second = pair
        seen = self.tables[pair]
        count = int(np.count_nonzero(seen.stamps_s >= self._now_s - newest_s))
        if most is not None and count > most:
            seen = seen.some(np.linspace(0, count - 1, most).astype(int))
        else:
            seen = seen.some(slice(count))
        poses, other = self._past_of(second, seen, on_tracks), None
        rays, errors_rad = poses.rays_now(*self._leveled_rays(second, seen))
        by_second = seen.seen_by_second
        if first != WORLD:
            other = self._past_of(first, seen, on_tracks)
            others_rays, others_errors_rad = other.rays_now(*self._leveled_rays(first, seen))
            rays = np.where(by_second[:, None], rays, others_rays)
            errors_rad = np.where(by_second, errors_rad, others_errors_rad)
        bodies = ((0, other), (1, poses))
        here, there = (self._placed(seen, seen.points, *body) for body in bodies)
        differences = None
        if len(seen.differences):
            of_first, of_second = (self._placed(seen, seen.references, *body) for body in bodies)
            references = Interval(
                np.where(by_second[:, None], of_first.lower, of_second.lower),
                np.where(by_second[:, None], of_first.upper, of_second.upper),
            )
            differences = references, Interval(seen.least_m, seen.most_m)
        return PairReadings.of(
            here,
            there,
            Interval(seen.lower_m, seen.upper_m),
            rays,
            errors_rad,
            by_second,
            differences,
        )

    def off_tracks(self, pair: Pair, cover: Cover) -> Cover:
        """Return the poses of a pair now from the poses of its tracks."""
        first, second = pair
        step, ball_m, back = self.path(second).off_track(self._now_s), 0.0, None
        if first != WORLD:
            # A rotation about the origin of the first body maps the ball to itself.
            off = self.path(first).off_track(self._now_s)
            ball_m, back = off.ball_m, PastPoses(off.pose.position_m, -off.pose.yaw_rad)
        in_plane = self._config.dimension == 2
        moved = cover.carried(step.pose, sum_up(step.ball_m, ball_m), back, in_plane)
        return cover.unbounded() if moved is None else moved

    def tilt(self, robot: int) -> Tilt:
        """Return the tilt (roll and pitch) of a robot now."""
        rotations, errors_rad = self.path(robot).tilts([self._now_s])
        return Tilt(rotations[0], float(errors_rad[0]))

    def _pairs_of_robots(self, newest_s: float) -> list[Pair]:
        """Return the pairs of robots that observed each other in the last `newest_s` seconds."""
        oldest_s = self._now_s - newest_s
        return [
            pair
            for pair, seen in self.tables.items()
            if pair[0] != WORLD and seen.stamps_s[0] >= oldest_s
        ]

    def _pair_of(self, observer: str, target: str) -> Pair | None:
        """Return the bodies of two points; None if they are equal or a motion is unknown."""
        first, second = self._body_of(observer), self._body_of(target)
        if first is None or second is None or first == second:
            return None
        return min(first, second), max(first, second)

    def _body_of(self, point: str) -> int | None:
        """Return the body of a point; None if its motion is unknown."""
        config = self._config
        robot = config.robot_of(point)
        if robot in config.anchors:
            # The orientation of a parked robot is unknown.
            return WORLD if robot == point else None
        if not (self._motion.odometry.get(robot) and config.is_upright(robot)):
            return None
        return self._config.rows[robot]

    def _past_of(self, robot: int, seen: Table, on_tracks: bool) -> PastPoses:
        """Return the poses of a robot at the times of some of its observations."""
        stamps_s, key = self._stamps[robot], (robot, on_tracks)
        if key not in self._past:
            path = self.path(robot)
            self._past[key] = path.past_poses(stamps_s, self._now_s, on_track=on_tracks)
        poses, index = self._past[key], np.searchsorted(stamps_s, seen.stamps_s)
        return PastPoses(poses.position_m[index], poses.yaw_rad[index])

    def _leveled_rays(
        self, robot: int, seen: Table
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the rays of a robot in its level frames; rays in the plane are level already."""
        if self._config.dimension == 2:
            return seen.rays, seen.errors_rad
        return self.path(robot).leveled_rays(seen.stamps_s, seen.rays, seen.errors_rad)

    @cached_property
    def _places(self) -> Interval:
        """The places of the anchors by index of their points, shape (n, 3)."""
        lower, upper = np.zeros((2, len(self._config.points), 3))
        for point, box in self._anchors.boxes.items():
            lower[point, : box.lower.size], upper[point, : box.upper.size] = box.lower, box.upper
        return Interval(lower, upper)

    def _placed(
        self, seen: Table, points: NDArray[np.int64], end: int, poses: PastPoses | None
    ) -> Interval:
        """Return the points of one body, shape (m, 3), by its past poses; the world has none."""
        own = points[:, end]
        places = self._places[own] if poses is None else self._points(own, seen.stamps_s, poses)
        if not self._config.elevations_m:
            return places
        # Ranges are projected to the plane already; range differences are not.
        raised, names = seen.differences, self._config.points
        heights_m = np.array([self._config.elevation_m(names[point]) for point in own[raised]])
        lower, upper = places.lower.copy(), places.upper.copy()
        lower[raised, 2], upper[raised, 2] = heights_m.reshape(-1, 2).T
        return Interval(lower, upper)

    def _points(
        self, points: NDArray[np.int64], stamps_s: NDArray[np.float64], poses: PastPoses
    ) -> Interval:
        """Return the places of points of a robot at its past poses, shape (m, 3)."""
        config = self._config
        names = [config.points[point] for point in points] if config.sensors else []
        if config.sensors.keys().isdisjoint(names):
            return poses.position_m
        arms_m = places_on_body(config, names)
        if config.dimension == 3:
            robot = self._config.rows[config.robot_of(names[0])]
            arms_m = self.path(robot).leveled_points(stamps_s, arms_m)
        return poses.points_now(arms_m)
