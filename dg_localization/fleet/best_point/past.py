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

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.least_squares import (
    MOST_EFFORT,
    Fit,
    equations_at,
    residuals_of,
)
from dg_localization.fleet.best_point.stated_way import StatedWay, points_on, seen_from
from dg_localization.fleet.best_point.terms import (
    AT_ORIGIN,
    LEAST_HALF_WIDTH,
    PLACE,
    RANGE,
    RAY,
    STEP,
    TURN,
    Terms,
)
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.rotations import best_rotation
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.memory import Ends, Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LONGEST_S = 30.0
"""What is older has little to say, since odometry drifts."""

SPACING_S = 3.0
"""Between two bodies of a robot, at least."""

GUESS_ROUNDS = 5
GUESS_SCALE_M = 0.5
"""A landmark that is farther off than this counts less when a pose is guessed."""

GREATEST_OFF, MEAN_OFF, FEW = 2.0, 1.05, 8
"""Bounds do not hold where one term is farther off a fit than the first, in half widths, or where
the root mean square of at least `FEW` terms is above the second."""

LATE_STEPS = 10

NEAREST_M = 0.1
"""A target that is nearer may be seen in any direction once its observer has moved."""


class Misfit(NamedTuple):
    """Readings or steps that are off a fit, and by how many half widths."""

    kind: int
    robot: int
    other: int
    rms: float
    most: float


@dataclass(frozen=True, eq=False)
class Past:
    """
    Poses that robots had, and what was measured from there.

    Parameters
    ----------
    terms : Terms
        The bodies are the points of the problem, and after these the past poses.
    rows : numpy.ndarray of int, shape (k,)
        The robot of each past pose.
    poses : numpy.ndarray, shape (k, 3)
        x, y and yaw of each, seen from where its robot is now, as odometry states them.
    guesses : mapping of int to numpy.ndarray, shape (3,)
        By row, the poses of robots now that lay what they saw of landmarks on the map.
    ends : frozenset of (str, str)
        Whose measurements the terms contain.
    ways : mapping of int to StatedWay
        By row, the odometry of each robot.
    widened : numpy.ndarray, shape (m,)
        How many times as wide as in the fit the bounds of the last terms are, with what odometry
        may do wrong from the nearest body to a reading.

    """

    terms: Terms
    rows: IntArray
    poses: FloatArray
    guesses: Mapping[int, FloatArray]
    ends: frozenset[Ends]
    ways: Mapping[int, StatedWay]
    widened: FloatArray

    def spread(self, fit: Fit) -> FloatArray:
        """
        Return the products of the gradients that errors of the terms make at a robust fit.

        Errors are independent of each other, but for those of readings of one target in a while.
        """
        is_reading = np.isin(self.terms.kinds, (RANGE, RAY))
        residuals = np.where(is_reading, residuals_of(self.terms, fit), 0.0)
        widened = np.ones(len(residuals))
        widened[-len(self.widened) :] = np.hypot(1.0, self.widened - 1.0)
        common = self.terms.common_errors(residuals / widened)
        shares = widened * np.sqrt(common) / np.hypot(1.0, residuals)
        return equations_at(self.terms._replace(weights=shares * self.terms.weights), fit)[0]

    def late(self, rotations: FloatArray) -> Iterator[tuple[int, FloatArray]]:
        """Yield by what the odometry of robots may be late: a row, and steps (m, 6)."""
        for row, way in self.ways.items():
            steps = np.zeros((LATE_STEPS, 6))
            steps[:, [0, 1, 5]] = way.late(np.linspace(0.0, SPACING_S, LATE_STEPS))
            steps[:, :3] = steps[:, :3] @ rotations[row].T
            yield row, steps

    def misfits(self, fit: Fit) -> Iterator[Misfit]:
        """
        Yield the readings and steps that are farther off a robust fit than their bounds allow.

        How late odometry is moves the place of a reading, too.
        """
        residuals, kinds = np.abs(residuals_of(self.terms, fit)), self.terms.kinds
        n_points = len(fit.columns) - len(self.rows)
        ends = np.append(np.arange(n_points), self.rows)[self.terms.bodies]
        for robot, way in self.ways.items():
            own = (ends == robot).any(axis=1) & (kinds != PLACE)
            late_m, late_rad = way.most_late()
            late = np.where(np.isin(kinds, (RANGE, STEP)), late_m, late_rad + late_m)
            off = np.maximum(0.0, residuals - 2.0 * late * self.terms.weights)
            off[-len(self.widened) :] /= self.widened
            others = np.where(ends[:, 0] == robot, ends[:, 1], ends[:, 0])
            yield from _misfits(kinds[own], others[own], off[own], robot)


def _misfits(kinds: IntArray, others: IntArray, off: FloatArray, robot: int) -> Iterator[Misfit]:
    """Yield the groups of one kind and one other end that are off by too many half widths."""
    groups, numbers, counts = np.unique(
        np.stack([kinds, others]), axis=1, return_inverse=True, return_counts=True
    )
    numbers = numbers.ravel()
    most, means = np.zeros(len(counts)), np.sqrt(np.bincount(numbers, off**2) / counts)
    np.maximum.at(most, numbers, off)
    for group in np.flatnonzero(
        (most > GREATEST_OFF) | ((means > MEAN_OFF) & (counts >= FEW))
    ).tolist():
        kind, other = groups[:, group].tolist()
        yield Misfit(kind, robot, other, float(means[group]), float(most[group]))


class _Seen(NamedTuple):
    """
    What robots on their ways and landmarks observed of each other.

    Of each observation the rows of both ends, (m, 2), and where on their bodies they are,
    (m, 2, 2); the bearing is NaN where nothing was seen.
    """

    table: Table
    bodies: IntArray
    arms_m: FloatArray
    bearings_rad: FloatArray

    def some(self, kept: NDArray[np.bool_]) -> _Seen:
        """Return some of the observations."""
        table = self.table.some(np.flatnonzero(kept))
        return _Seen(table, self.bodies[kept], self.arms_m[kept], self.bearings_rad[kept])


def past_of(snapshot: Snapshot, solved: Constraints, turning: Collection[int]) -> Past | None:
    """
    Return what a window says of the points that are placed together; None when nothing.

    `turning` are the rows of the robots whose rotation is known or fitted to what they see now.
    That of others is guessed where they have seen landmarks, or what they saw is left out.
    """
    config, rows, odometry = snapshot.config, solved.rows, snapshot.motion.odometry
    tables, now_s = snapshot.carried.tables, snapshot.stamp_s
    if config.dimension != 2 or not tables:
        return None
    moving = [
        robot
        for robot in config.robots
        if robot in rows
        and robot in odometry
        and robot not in config.anchors
        and odometry[robot][-1].stamp_s >= now_s - config.max_age_s
    ]
    span_s = min(
        LONGEST_S, now_s - min(s[0].stamp_s for s in snapshot.window.observations.values())
    )
    most_poses = int(MOST_EFFORT ** (1 / 3)) // 3
    # Larger fleets have no smoother.
    if span_s <= 0.0 or len(moving) > most_poses // 2:
        return None
    ways = {rows[robot]: StatedWay(snapshot, robot, now_s - span_s) for robot in moving}
    seen = _seen(snapshot, solved, ways, Table.joined(tables.values()))
    places_m = np.full((len(solved.points), 2), np.nan)
    for point, box in snapshot.anchors.boxes.items():
        if config.points[point] in rows:
            places_m[rows[config.points[point]]] = 0.5 * (box.lower + box.upper)
    laid = {row: _laid_on_map(row, way, seen, places_m) for row, way in ways.items()}
    guesses = {row: pose for row, pose in laid.items() if pose is not None}
    known = {row: way for row, way in ways.items() if row in turning or row in guesses}
    left_out = np.isin(seen.bodies, [*ways.keys() - known.keys()])
    seen = seen.some(np.asarray(~left_out.any(axis=1)))
    if not len(seen.bodies):
        return None
    count = max(1, min(math.ceil(span_s / SPACING_S), most_poses // len(known)))
    times_s = now_s - np.linspace(0.0, span_s, count + 1)
    terms, widened = _terms(seen, known, times_s, len(solved.points))
    return Past(
        terms,
        np.repeat([*known], count),
        np.concatenate([way.poses_now(times_s[1:]) for way in known.values()]),
        guesses,
        frozenset((config.points[o], config.points[t]) for o, t in seen.table.ends.tolist()),
        known,
        widened,
    )


def _seen(
    snapshot: Snapshot, solved: Constraints, ways: Mapping[int, StatedWay], seen: Table
) -> _Seen:
    """Return what counts of a table; range differences are left out: a term has two ends."""
    config, arms, row_of = snapshot.config, snapshot.mounts.arms_m, solved.rows
    rows = np.array([row_of.get(config.robot_of(point), -1) for point in config.points])
    fixed = [row_of[name] for name in config.anchors if name in row_of]
    since_s = np.full(len(solved.points), math.inf)
    since_s[fixed] = -math.inf
    since_s[[*ways]] = [way.since_s for way in ways.values()]
    bodies = rows[seen.ends]
    kept = (bodies >= 0).all(axis=1) & (seen.stamps_s >= since_s[bodies].max(axis=1))
    kept &= np.isin(bodies, [*ways]).any(axis=1)
    kept[seen.differences] = False
    arms_m = np.array([arms.get(point, AT_ORIGIN)[:2] for point in config.points])[seen.ends]
    bearings_rad = np.arctan2(seen.rays[:, 1], seen.rays[:, 0]) - seen.expected_errors_rad
    # Who may look anywhere has seen nothing.
    bearings_rad[seen.errors_rad >= math.pi] = math.nan
    return _Seen(seen, bodies, arms_m, bearings_rad).some(kept)


def _terms(
    seen: _Seen, ways: Mapping[int, StatedWay], times_s: FloatArray, n_points: int
) -> tuple[Terms, FloatArray]:
    """
    Return the terms of readings and odometry, and how much wider their bounds may be.

    Each robot has bodies at falling times: itself, and after the points its past poses in turn.
    What is fixed has always been the same body.
    """
    table, bodies = seen.table, seen.bodies.copy()
    apart_m = np.where(np.isfinite(table.likeliest_m), table.likeliest_m, np.inf)
    # As the fit has them, and as wide as they may be.
    halves_m = np.stack([0.5 * (table.upper_m - table.lower_m)] * 2)
    halves_rad = np.stack([table.errors_rad] * 2)
    arms_m, rays_rad = np.pad(seen.arms_m, ((0, 0), (0, 0), (0, 1))), seen.bearings_rad.copy()
    nearest = np.rint((times_s[0] - table.stamps_s) / (times_s[0] - times_s[1])).astype(int)
    nearest, n_past = np.clip(nearest, 0, len(times_s) - 1), len(times_s) - 1
    parts: list[Terms] = []
    widened: list[FloatArray] = []
    for number, (row, way) in enumerate(ways.items()):
        own = np.append(row, n_points + n_past * number + np.arange(n_past))
        of_bodies, is_own = way.poses(times_s), seen.bodies == row
        poses = seen_from(of_bodies[nearest], way.poses(table.stamps_s))
        bodies[is_own] = np.stack([own[nearest]] * 2, axis=-1)[is_own]
        for end in (0, 1):
            mine = is_own[:, end]
            arms_m[mine, end, :2] = points_on(poses[mine], seen.arms_m[mine, end])
        rays_rad += np.where(is_own[:, 0], poses[:, 2], 0.0)
        between_s = table.stamps_s, times_s[nearest]
        off = np.stack([way.unknown(*between_s), way.errors(*between_s)], axis=1)
        off *= is_own.any(axis=1)
        halves_m += off[0]
        halves_rad += off[1] * is_own[:, 0] + off[0] / np.maximum(apart_m, NEAREST_M)
        errors = way.errors(times_s[1:], times_s[:-1])
        parts += _steps(own, of_bodies, errors)
        widened.append(np.ones(errors.size))
    ranged = np.isfinite(table.likeliest_m) & np.isfinite(halves_m[0])
    # How what is fixed is turned is not known.
    sighted = np.isfinite(rays_rad) & np.isin(seen.bodies[:, 0], [*ways])
    distances_m = np.pad(table.likeliest_m[:, None], ((0, 0), (0, 2)))
    for kind, some, values, halves in (
        (RANGE, ranged, distances_m, halves_m),
        (RAY, sighted, directions(rays_rad), halves_rad),
    ):
        least, most = np.maximum(halves[:, some], LEAST_HALF_WIDTH)
        parts.append(_packed(kind, bodies[some], arms_m[some], values[some], least))
        widened.append(most / least)
    return Terms.joined(parts), np.concatenate(widened)


def _steps(own: IntArray, poses: FloatArray, errors: FloatArray) -> list[Terms]:
    """Return the terms that odometry makes of the bodies of a robot."""
    bodies, between = np.stack([own[:-1], own[1:]], axis=-1), seen_from(poses[:-1], poses[1:])
    nothing = np.zeros((len(bodies), 2, 3))
    ends = nothing.copy()
    ends[:, 0, :2] = between[:, :2]
    turned = _packed(TURN, bodies, nothing, directions(between[:, 2]), errors[1])
    return [_packed(STEP, bodies, ends, nothing[:, 0], errors[0]), turned]


def _packed(
    kind: int, bodies: IntArray, arms_m: FloatArray, values: FloatArray, half_widths: FloatArray
) -> Terms:
    """Return terms of one kind."""
    weights = 1.0 / np.maximum(half_widths, LEAST_HALF_WIDTH)
    return Terms(np.full(len(bodies), kind), bodies, arms_m, values, weights)


def directions(angles_rad: FloatArray) -> FloatArray:
    """Return unit vectors in the plane, shape (m, 3)."""
    return np.stack([np.cos(angles_rad), np.sin(angles_rad), 0.0 * angles_rad], axis=-1)


def _laid_on_map(row: int, way: StatedWay, seen: _Seen, places_m: FloatArray) -> FloatArray | None:
    """
    Return the pose (x, y, yaw) that puts the landmarks that a robot saw where the map has them.

    Landmarks that are off count less in every round, so that a few that were misread do not
    matter. None where fewer than two are known.
    """
    own = seen.some(seen.bodies[:, 0] == row)
    poses, true_m = way.poses_now(own.table.stamps_s), places_m[own.bodies[:, 1]]
    seen_m = points_on(poses, own.arms_m[:, 0])
    seen_m += own.table.likeliest_m[:, None] * directions(poses[:, 2] + own.bearings_rad)[:, :2]
    known = np.isfinite(seen_m).all(axis=1) & np.isfinite(true_m).all(axis=1)
    seen_m, true_m = seen_m[known], true_m[known]
    if len(np.unique(true_m, axis=0)) < 2:
        return None
    weights = np.ones(len(seen_m))
    for _ in range(GUESS_ROUNDS):
        shares = weights / weights.sum()
        seen_middle_m, true_middle_m = shares @ seen_m, shares @ true_m
        turn = best_rotation(seen_m - seen_middle_m, true_m - true_middle_m, shares)
        origin_m = true_middle_m - turn @ seen_middle_m
        off_m = np.linalg.norm(seen_m @ turn.T + origin_m - true_m, axis=1)
        weights = 1.0 / (1.0 + (off_m / GUESS_SCALE_M) ** 2)
    return np.array([*origin_m, math.atan2(turn[1, 0], turn[0, 0])])
