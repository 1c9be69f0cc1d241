# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What is remembered as terms of a fit: a window smoother.

A robot that moves is a body now and one at each of a few earlier times. Its odometry joins each of
them to the next, as right as its bounds say. A reading belongs to the bodies nearest in time, and
where its ends were just then is an arm in their frames. So all readings of a window count, and an
error of the odometry is shared by all that came before it.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.stated_way import StatedWay, seen_from
from dg_localization.fleet.best_point.terms import (
    AT_ORIGIN,
    LEAST_HALF_WIDTH,
    RANGE,
    RAY,
    STEP,
    TURN,
    PackedTerms,
)
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.directions import best_rotation
from dg_localization.fleet.odometry import MotionLimits
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.memory import STAMP_S, Ends, Observation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LONGEST_S = 30.0
"""What is older has little to say, since odometry drifts."""

SPACING_S = 3.0
"""Between two bodies of a robot, at least."""

MOST_POSES = 60
"""Of all robots before now: a fit takes the cube of their number."""

LEAST_POSES = 2
"""Of each robot before now; larger fleets have no smoother."""

LEAST_STEP_ERROR = 1e-3
"""Odometry is never as exact as its bounds may say, in m and in rad."""

LEAST_RANGE_M = 0.1
"""A target that is nearer may be seen in any direction once its observer has moved."""

GUESS_ROUNDS = 5
GUESS_SCALE_M = 0.5
"""A landmark that is farther off than this counts less when a pose is guessed."""


@dataclass(frozen=True, eq=False)
class Past:
    """
    Poses that robots had, and what was measured from there.

    Parameters
    ----------
    terms : PackedTerms
        The bodies are the points of the problem, and after these the past poses.
    rows : numpy.ndarray of int, shape (k,)
        The robot of each past pose.
    first_body : int
        The first past pose; those before are the points of the problem.
    poses : numpy.ndarray, shape (k, 3)
        x, y and yaw of each, seen from where its robot is now, as odometry states them.
    guesses : dict of int to numpy.ndarray, shape (3,)
        Poses of robots among landmarks, from what they saw of these.
    ends : dict of (str, str) to frozenset of int
        Whose measurements the terms contain, and which robots moved meanwhile.

    """

    terms: PackedTerms
    rows: IntArray
    first_body: int
    poses: FloatArray
    guesses: dict[int, FloatArray]
    ends: Mapping[Ends, frozenset[int]]

    def of_robots(self, rows: Collection[int]) -> Past:
        """Return this without the readings of all robots but some."""
        others = np.setdiff1d(self.rows, list(rows))
        past = self.first_body + np.flatnonzero(np.isin(self.rows, others))
        left_out = np.isin(self.terms.bodies, np.concatenate([others, past]))
        kept = np.flatnonzero(np.count_nonzero(left_out, axis=1) == 0)
        ends = {pair: moved for pair, moved in self.ends.items() if moved <= {*rows}}
        return replace(self, terms=self.terms.chosen(kept), ends=ends)


def past_of(snapshot: Snapshot, solved: Constraints, headed: Collection[str] = ()) -> Past | None:
    """
    Return what a window says of the points that are placed together; None when nothing.

    Parameters
    ----------
    snapshot : Snapshot
    solved : Constraints
        Of the points that are placed together; a body is one of them.
    headed : collection of str
        Robots without cameras whose headings are known.

    """
    config = snapshot.config
    if config.dimension != 2 or not snapshot.window.observations:
        return None
    moving = _moving(snapshot, solved, headed)
    if not 0 < len(moving) <= MOST_POSES // LEAST_POSES:
        return None
    times_s = _times_s(snapshot, len(moving))
    if times_s[-1] >= snapshot.stamp_s:
        return None
    ways: dict[str, _Poses] = {}
    for robot in moving:
        ways[robot] = _Poses(
            StatedWay(
                snapshot.motion.odometry[robot],
                float(times_s[-1]),
                config.odometry_error_of(robot),
                MotionLimits(config.speed_m_s(robot), config.max_turn_rate_rad_s),
            ),
            times_s,
            solved.rows[robot],
            len(solved.points) + (len(times_s) - 1) * len(ways),
        )
    seen, ends = _seen(snapshot, solved, ways, float(times_s[-1]))
    parts = _terms_of(seen, ways.values())
    for way in ways.values():
        parts += way.steps()
    return Past(
        PackedTerms.joined(parts),
        np.concatenate([np.full(len(times_s) - 1, way.row) for way in ways.values()]),
        len(solved.points),
        np.concatenate([way.seen_from_now[1:] for way in ways.values()]),
        _guesses(seen, ways.values(), _landmarks_m(snapshot, solved)),
        ends,
    )


def _moving(snapshot: Snapshot, solved: Constraints, headed: Collection[str]) -> list[str]:
    """Return the robots with odometry up to now that have seen others: their rotation is known."""
    config, odometry = snapshot.config, snapshot.motion.odometry
    turning = robots_that_saw(snapshot).union(headed)
    return [
        robot
        for robot in config.robots
        if robot in turning & odometry.keys() & solved.rows.keys()
        and robot not in config.anchors
        and odometry[robot][-1].stamp_s >= snapshot.stamp_s - config.max_age_s
    ]


def robots_that_saw(snapshot: Snapshot) -> frozenset[str]:
    """Return the robots whose cameras saw others in a window."""
    since_s = snapshot.stamp_s - min(LONGEST_S, snapshot.config.memory_s)
    return frozenset(
        snapshot.config.robot_of(observer)
        for (observer, _), seen in snapshot.window.observations.items()
        if any(one.direction is not None and one.stamp_s >= since_s for one in seen)
    )


def _times_s(snapshot: Snapshot, robots: int) -> FloatArray:
    """Return the times of the bodies of each robot, now first."""
    oldest_s = min(seen[0].stamp_s for seen in snapshot.window.observations.values())
    span_s = min(LONGEST_S, snapshot.stamp_s - oldest_s)
    count = min(math.ceil(span_s / SPACING_S), MOST_POSES // robots)
    return snapshot.stamp_s - np.linspace(0.0, span_s, max(1, count) + 1)


@dataclass(frozen=True, eq=False)
class _Seen:
    """
    Observations; observers and targets are rows of bodies, and NaN is what was not measured.

    Arms are where on its body each of them is.
    """

    observers: IntArray
    targets: IntArray
    stamps_s: FloatArray
    distances_m: FloatArray
    half_widths_m: FloatArray
    bearings_rad: FloatArray
    errors_rad: FloatArray
    observer_arms_m: FloatArray
    target_arms_m: FloatArray

    def chosen(self, kept: NDArray[np.bool_]) -> _Seen:
        """Return some of them."""
        return _Seen(*(getattr(self, field.name)[kept] for field in fields(self)))


def _seen(
    snapshot: Snapshot, solved: Constraints, ways: Mapping[str, _Poses], oldest_s: float
) -> tuple[_Seen, dict[Ends, frozenset[int]]]:
    """Return what robots on their ways and landmarks observed of each other, and who moved."""
    config, arms = snapshot.config, snapshot.mounts.arms_m
    fixed = config.anchors.keys() & solved.rows.keys()
    # How a parked robot is turned, and so where its sensors are, is not known.
    sensors_at_rest = {end for end in config.sensors if config.robot_of(end) in fixed}
    rows, ends = [], dict[Ends, frozenset[int]]()
    for (observer, target), seen in snapshot.window.observations.items():
        on_bodies = [config.robot_of(end) for end in (observer, target)]
        both = {*on_bodies}
        if not both <= ways.keys() | fixed or both <= fixed:
            continue
        if not sensors_at_rest.isdisjoint((observer, target)):
            continue
        arms_m = [arms.get(end, AT_ORIGIN)[axis] for end in (observer, target) for axis in (0, 1)]
        moved = both & ways.keys()
        since_s = max([oldest_s, *(ways[end].since_s for end in moved)])
        first = bisect_left(seen, since_s, key=STAMP_S)
        if first < len(seen):
            ends[observer, target] = frozenset(solved.rows[end] for end in moved)
        error_rad = config.bearing_expected_error_of(observer, target)
        rows += [
            (
                *(solved.rows[body] for body in on_bodies),
                one.stamp_s,
                one.likeliest_m,
                0.5 * (one.upper_m - one.lower_m),
                _bearing_rad(one) - error_rad,
                one.half_width_rad,
                *arms_m,
            )
            for one in seen[first:]
        ]
    table = np.array(rows).reshape(-1, 11)
    observers, targets, *columns = table[:, :7].T.copy()
    columns += [table[:, 7:9], table[:, 9:]]
    return _Seen(observers.astype(int), targets.astype(int), *columns), ends


def _bearing_rad(seen: Observation) -> float:
    """Return where a target was seen; who may look anywhere has seen nothing."""
    if seen.direction is None or seen.half_width_rad >= math.pi:
        return math.nan
    return math.atan2(*seen.direction[1::-1])


def _landmarks_m(snapshot: Snapshot, solved: Constraints) -> dict[int, FloatArray]:
    """Return the places of the anchors by row."""
    points, boxes = snapshot.config.points, snapshot.anchors.boxes
    places_m = {points[point]: 0.5 * (box.lower + box.upper) for point, box in boxes.items()}
    return {solved.rows[name]: m for name, m in places_m.items() if name in solved.rows}


class _Poses:
    """
    A robot as an end of readings: its bodies now and before.

    Parameters
    ----------
    way : StatedWay
    times_s : numpy.ndarray, shape (k,)
        Of the bodies, now first.
    row : int
        The body of now.
    first_past : int
        That of the second time; the others follow.

    """

    def __init__(self, way: StatedWay, times_s: FloatArray, row: int, first_past: int) -> None:
        self.way, self.row = way, row
        # Where it was before its odometry began, or started anew, is not known.
        self.since_s = float(way.stamps_s[0])
        self._times_s = times_s
        self._bodies = np.concatenate([[row], first_past + np.arange(len(times_s) - 1)])
        self._stated = way.poses(times_s)
        self.seen_from_now = seen_from(self._stated[0], self._stated)

    def ends(self, stamps_s: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """
        Return the bodies nearest to some times, and the pose at each time in their frames.

        The last array, shape (m, 2), is what silent odometry leaves open of each, in m and rad.
        """
        spacing_s = self._times_s[0] - self._times_s[1]
        nearest = np.rint((self._times_s[0] - stamps_s) / spacing_s).astype(int)
        nearest = np.clip(nearest, 0, len(self._times_s) - 1)
        unknown = self.way.unknown_motion(stamps_s, self._times_s[nearest])
        poses = seen_from(self._stated[nearest], self.way.poses(stamps_s))
        return self._bodies[nearest], poses, np.stack(unknown, axis=-1)

    def points_now(self, seen: _Seen) -> FloatArray:
        """Return where the observations have their target, in the body frame of now."""
        poses = seen_from(self._stated[0], self.way.poses(seen.stamps_s))
        away = _directions(poses[:, 2] + seen.bearings_rad)[:, :2]
        return _with_arms(poses, seen.observer_arms_m)[:, :2] + seen.distances_m[:, None] * away

    def steps(self) -> Iterator[PackedTerms]:
        """Yield the terms that odometry makes of the bodies."""
        bodies = np.stack([self._bodies[:-1], self._bodies[1:]], axis=-1)
        between = seen_from(self._stated[:-1], self._stated[1:])
        errors_m, errors_rad = self.way.errors(self._times_s[1:], self._times_s[:-1])
        ends = np.zeros((len(bodies), 2, 3))
        ends[:, 0, :2] = between[:, :2]
        nothing = np.zeros((len(bodies), 3))
        yield _packed(STEP, bodies, ends, nothing, np.maximum(errors_m, LEAST_STEP_ERROR))
        axes = _directions(between[:, 2])
        errors_rad = np.maximum(errors_rad, LEAST_STEP_ERROR)
        yield _packed(TURN, bodies, np.zeros((len(bodies), 2, 3)), axes, errors_rad)


def _ends(
    rows: IntArray, arms_m: FloatArray, stamps_s: FloatArray, ways: Iterable[_Poses]
) -> tuple[IntArray, FloatArray, FloatArray]:
    """
    Return the bodies that points were on at some times, their poses and what is open of these.

    Poses are in the frames of the bodies. What is fixed has always been the same body.
    """
    bodies, poses = rows.copy(), np.zeros((len(rows), 3))
    unknown = np.zeros((len(rows), 2))
    for way in ways:
        own = rows == way.row
        bodies[own], poses[own], unknown[own] = way.ends(stamps_s[own])
    return bodies, _with_arms(poses, arms_m), unknown


def _with_arms(poses: FloatArray, arms_m: FloatArray) -> FloatArray:
    """Return the poses (x, y, yaw) of points on bodies with some poses, shape (m, 3)."""
    c, s = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    x, y = arms_m.T
    return poses + np.stack([c * x - s * y, s * x + c * y, np.zeros(len(poses))], axis=-1)


def _terms_of(seen: _Seen, ways: Collection[_Poses]) -> list[PackedTerms]:
    """Return the ranges and the rays of observations."""
    first_bodies, first_poses, first_unknown = _ends(
        seen.observers, seen.observer_arms_m, seen.stamps_s, ways
    )
    second_bodies, second_poses, second_unknown = _ends(
        seen.targets, seen.target_arms_m, seen.stamps_s, ways
    )
    unknown_m = first_unknown[:, 0] + second_unknown[:, 0]
    apart_m = np.where(np.isfinite(seen.distances_m), seen.distances_m, np.inf)
    unknown_rad = first_unknown[:, 1] + unknown_m / np.maximum(apart_m, LEAST_RANGE_M)
    bodies = np.stack([first_bodies, second_bodies], axis=-1)
    arms_m = np.zeros((len(bodies), 2, 3))
    arms_m[:, 0, :2], arms_m[:, 1, :2] = first_poses[:, :2], second_poses[:, :2]
    distances_m = np.zeros((len(bodies), 3))
    distances_m[:, 0] = seen.distances_m
    directions = _directions(first_poses[:, 2] + seen.bearings_rad)
    ranged = np.isfinite(seen.distances_m) & np.isfinite(seen.half_widths_m)
    # How what is fixed is turned is not known.
    sighted = np.isfinite(seen.bearings_rad) & np.isin(seen.observers, [way.row for way in ways])
    return [
        _packed(kind, bodies[known], arms_m[known], values[known], half_widths[known])
        for kind, known, values, half_widths in (
            (RANGE, ranged, distances_m, seen.half_widths_m + unknown_m),
            (RAY, sighted, directions, seen.errors_rad + unknown_rad),
        )
    ]


def _packed(
    kind: int, bodies: IntArray, arms_m: FloatArray, values: FloatArray, half_widths: FloatArray
) -> PackedTerms:
    """Return terms of one kind."""
    weights = 1.0 / np.maximum(half_widths, LEAST_HALF_WIDTH)
    return PackedTerms(np.full(len(bodies), kind), bodies, arms_m, values, weights)


def _directions(angles_rad: FloatArray) -> FloatArray:
    """Return unit vectors in the plane, shape (m, 3)."""
    return np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(len(angles_rad))], axis=-1)


def _guesses(
    seen: _Seen, ways: Iterable[_Poses], landmarks_m: Mapping[int, FloatArray]
) -> dict[int, FloatArray]:
    """Return poses of robots from the landmarks that they saw: these laid on the map, roughly."""
    found = {}
    for way in ways:
        own = seen.chosen((seen.observers == way.row) & np.isin(seen.targets, [*landmarks_m]))
        points_m = way.points_now(own)
        known = np.isfinite(points_m).all(axis=1)
        true_m = np.array([landmarks_m[row] for row in own.targets[known].tolist()])
        if len(np.unique(true_m, axis=0)) > 1:
            found[way.row] = _laid_on(points_m[known], true_m)
    return found


def _laid_on(seen_m: FloatArray, true_m: FloatArray) -> FloatArray:
    """Return the pose (x, y, yaw) under which points are where they are known to be."""
    weights = np.ones(len(seen_m))
    for _ in range(GUESS_ROUNDS):
        shares = weights / weights.sum()
        seen_middle_m, true_middle_m = shares @ seen_m, shares @ true_m
        turn = best_rotation(seen_m - seen_middle_m, true_m - true_middle_m, shares)
        origin_m = true_middle_m - turn @ seen_middle_m
        off_m = np.linalg.norm(seen_m @ turn.T + origin_m - true_m, axis=1)
        weights = 1.0 / (1.0 + (off_m / GUESS_SCALE_M) ** 2)
    return np.array([*origin_m, math.atan2(turn[1, 0], turn[0, 0])])
