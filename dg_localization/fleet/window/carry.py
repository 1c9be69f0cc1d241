# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Observations of a window, carried to the time of a snapshot by the odometry of both ends.

The bodies are the robots, by their indices, and the world with all anchors. A robot without
odometry is left out: how far it may have moved soon says nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
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
from dg_localization.interval.arrays import Interval
from dg_localization.pairs import NO_RAY_RAD, PairReadings, PastPoses

WORLD = -1
"""The body of the anchors."""

Pair = tuple[int, int]
"""Two bodies, the smaller index first: the world before any robot."""

AHEAD = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class _Row:
    """An observation with a point of the first body and one of the second."""

    observation: Observation
    seen_by_second: bool
    points: tuple[int, int]


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
        self._rows: dict[Pair, list[_Row]] = {}
        index = {name: i for i, name in enumerate(config.points)}
        for (observer, target), observations in window.observations.items():
            self._add(index[observer], index[target], observations)
        for rows in self._rows.values():
            rows.sort(key=lambda row: -row.observation.stamp_s)
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

    def span_s(self, pair: Pair) -> float:
        """Return the age of the oldest observation of a pair."""
        return self._now_s - min(self._stamps_of(pair))

    def stamps_s(self, pair: Pair) -> NDArray[np.float64]:
        """Return the times of the observations of a pair, newest first."""
        return np.array(self._stamps_of(pair))

    def between_origins(self, pair: Pair) -> tuple[Observation, ...]:
        """Return what two robots observed from origin to origin, newest first."""
        return tuple(row.observation for row in self._rows[pair] if row.points == pair)

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

    def readings_between(self, robot: int, after_s: float, until_s: float) -> PairReadings | None:
        """
        Return what a robot and the anchors observed of each other between two times.

        Parameters
        ----------
        robot : int
        after_s, until_s : float
            After the first, up to the second, at which the track of the robot is the frame.

        Returns
        -------
        PairReadings or None
            None where they observed nothing.

        """
        rows = self._rows_between(robot, after_s, until_s)
        if not rows:
            return None
        stamps = np.array([row.observation.stamp_s for row in rows])
        past = self.path(robot).past_poses_on_track(stamps, until_s).past
        return self._seen((WORLD, robot), rows, PastPoses.at_rest(len(rows)), past)

    def seen_between(self, robot: int, after_s: float, until_s: float) -> tuple[Observation, ...]:
        """Return what `readings_between` is made of."""
        return tuple(row.observation for row in self._rows_between(robot, after_s, until_s))

    def _rows_between(self, robot: int, after_s: float, until_s: float) -> list[_Row]:
        rows = self._rows.get((WORLD, robot), [])
        return [row for row in rows if after_s < row.observation.stamp_s <= until_s]

    def tracks(self, pair: Pair) -> tuple[PastPoses, PastPoses]:
        """Return where the tracks of a pair are now, seen from the two bodies."""
        now_s = np.array([self._now_s])
        first, second = (
            PastPoses.at_rest(1)
            if body == WORLD
            else self.path(body).past_poses_on_track(now_s, self._now_s).track
            for body in pair
        )
        return first, second

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
        oldest_s = self._now_s - newest_s
        rows = [row for row in self._rows[pair] if row.observation.stamp_s >= oldest_s]
        if most is not None and len(rows) > most:
            rows = [rows[i] for i in np.linspace(0, len(rows) - 1, most).astype(int)]
        stamps = np.array([row.observation.stamp_s for row in rows])
        poses = self._of(second, stamps, past)
        at_rest = first == WORLD
        other = PastPoses.at_rest(len(rows)) if at_rest else self._of(first, stamps, past)
        return self._seen(pair, rows, other, poses)

    def _seen(
        self, pair: Pair, rows: list[_Row], other: PastPoses, poses: PastPoses
    ) -> PairReadings:
        """Return observations of a pair, the poses of whose bodies at their times are given."""
        first, second = pair
        stamps = np.array([row.observation.stamp_s for row in rows])
        by_second = np.array([row.seen_by_second for row in rows])
        rays = np.array(
            [AHEAD if o.direction is None else o.direction for o in (r.observation for r in rows)]
        )
        errors = np.array([self._ray_error_rad(row) for row in rows])
        seen, seen_errors = poses.rays_now(*self._leveled_rays(second, stamps, rays, errors))
        if first != WORLD:
            leveled = self._leveled_rays(first, stamps, rays, errors)
            others_rays, others_errors = other.rays_now(*leveled)
            seen = np.where(by_second[:, None], seen, others_rays)
            seen_errors = np.where(by_second, seen_errors, others_errors)
        first_points, second_points = zip(*(row.points for row in rows), strict=True)
        return PairReadings.of(
            self._places(rows) if first == WORLD else self._points(first_points, stamps, other),
            self._points(second_points, stamps, poses),
            Interval(
                np.array([row.observation.lower_m for row in rows]),
                np.array([row.observation.upper_m for row in rows]),
            ),
            seen,
            seen_errors,
            by_second,
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
        rows += [_Row(seen, by_second, points) for seen in observations]

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

    def _stamps_of(self, pair: Pair) -> list[float]:
        return [row.observation.stamp_s for row in self._rows[pair]]

    def _stamps_with(self, robot: int) -> NDArray[np.float64]:
        """Return the times of all observations of a robot, ascending."""
        return np.unique(
            [stamp for pair in self._rows if robot in pair for stamp in self._stamps_of(pair)]
        )

    def _of(
        self, robot: int, stamps: NDArray[np.float64], past: Mapping[int, PastPoses]
    ) -> PastPoses:
        """Return where a robot was at some of the times of its observations."""
        poses = past[robot]
        index = np.searchsorted(self._stamps[robot], stamps)
        return PastPoses(poses.position_m[index], poses.yaw_rad[index])

    def _leveled_rays(
        self,
        robot: int,
        stamps_s: NDArray[np.float64],
        rays: NDArray[np.float64],
        errors_rad: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return rays of a robot in its level frames, in which rays in the plane are."""
        if self._config.dimension == 2:
            return rays, errors_rad
        return self.path(robot).leveled_rays(stamps_s, rays, errors_rad)

    def _ray_error_rad(self, row: _Row) -> float:
        """Return the error of a ray; how an anchor is turned is not known."""
        of_anchor = self._body_of(row.points[0]) == WORLD and not row.seen_by_second
        if row.observation.direction is None or of_anchor:
            return NO_RAY_RAD
        return row.observation.half_width_rad

    def _places(self, rows: list[_Row]) -> Interval:
        """Return the places of the anchors of some rows, shape (m, 3)."""
        boxes, dimension = self._anchors.boxes, self._config.dimension
        lower, upper = np.zeros((len(rows), 3)), np.zeros((len(rows), 3))
        for number, row in enumerate(rows):
            box = boxes[row.points[0]]
            lower[number, :dimension], upper[number, :dimension] = box.lower, box.upper
        return Interval(lower, upper)

    def _points(
        self, points: Sequence[int], stamps_s: NDArray[np.float64], poses: PastPoses
    ) -> Interval:
        """Return where points of a robot were in some past poses, shape (m, 3)."""
        config = self._config
        names = [config.points[point] for point in points]
        if config.sensors.keys().isdisjoint(names):
            return poses.position_m
        arms_m = places_on_body(config, names)
        if config.dimension == 3:
            robot = config.robots.index(config.robot_of(names[0]))
            arms_m = self.path(robot).leveled_points(stamps_s, arms_m)
        return poses.points_now(arms_m)
