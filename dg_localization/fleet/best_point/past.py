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

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.least_squares import Fit, equations_at, residuals_of
from dg_localization.fleet.best_point.stated_way import VARIANTS, StatedWay, directions, packed
from dg_localization.fleet.best_point.terms import AT_ORIGIN, RANGE, RAY, STEP, TURN, Terms
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

MOST_POSES = 60
"""Of all robots before now: a fit takes the cube of their number. Larger fleets than half as many
robots have no smoother."""

GUESS_ROUNDS = 5
GUESS_SCALE_M = 0.5
"""A landmark that is farther off than this counts less when a pose is guessed."""

GREATEST_OFF, MEAN_OFF, FEW = 2.0, 1.05, 8
"""Bounds do not hold where one term is farther off a fit than the first, in half widths, or where
the root mean square of at least `FEW` terms is above the second."""

NEAREST_M = 0.1
"""A target that is nearer may be seen in any direction once its observer has moved."""


class _End(NamedTuple):
    """The bodies that observers, or targets, of readings were on, and where in their frames."""

    bodies: IntArray  # (m,)
    poses: FloatArray  # (v, m, 3): x, y and yaw, as stated and by each error of odometry
    unknown: FloatArray  # (m, 2): what silent odometry leaves open of these, in m and rad
    moves: NDArray[np.bool_]  # (m,): whether a robot moved there, and what is fixed did not


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
    ways : tuple of Terms
        For each robot, its terms: arms and values as stated come first of several, and then what
        they were if its odometry erred all along.
    constants : tuple of (float, float)
        For each robot, how far its odometry is off at one time, in m and in rad: by its constant
        error, and by what it did within its latency.

    """

    terms: Terms
    rows: IntArray
    poses: FloatArray
    guesses: Mapping[int, FloatArray]
    ends: frozenset[Ends]
    ways: tuple[Terms, ...]
    constants: tuple[tuple[float, float], ...]

    def residuals(self, fit: Fit) -> list[FloatArray]:
        """Return by how many half widths the terms of each robot are off a fit, as stated."""
        return [residuals_of(way.variant(0), fit) for way in self.ways]

    def spread(self, fit: Fit, residuals: Sequence[FloatArray]) -> FloatArray:
        """
        Return the products of the gradients that errors of the terms make at a robust fit.

        Errors of readings are independent of each other, but for those of one target in a while.
        What odometry does wrong it may do all along, so that its gradients add up first.
        `residuals` are those of each robot.
        """
        of_readings = _of_readings(self.terms, residuals_of(self.terms, fit))
        shares = np.sqrt(self.terms.common_errors(of_readings)) / np.hypot(1.0, of_readings)
        spread, _ = equations_at(self.terms._replace(weights=shares * self.terms.weights), fit)
        for way, stated in zip(self.ways, residuals, strict=True):
            weights = way.weights / np.hypot(1.0, _of_readings(way, stated))
            weighted = way._replace(weights=weights)
            balance, *pulls = (
                equations_at(weighted.variant(number), fit)[1] for number in range(VARIANTS)
            )
            for pull in pulls:
                spread += np.outer(pull - balance, pull - balance)
        return spread

    def misfits(self, fit: Fit, residuals: Sequence[FloatArray]) -> Iterator[Misfit]:
        """
        Yield the readings and steps that are farther off a robust fit than their bounds allow.

        Errors of the odometry move the place of a reading, seen from the nearest body of the fit.
        The part of a residual that they explain does not count. `residuals` are those of each
        robot.
        """
        n_points = len(fit.columns) - len(self.rows)
        owners = np.append(np.arange(n_points), self.rows)
        robots = dict.fromkeys(self.rows.tolist())
        for way, robot, stated, (constant_m, constant_rad) in zip(
            self.ways, robots, residuals, self.constants, strict=True
        ):
            is_step = np.isin(way.kinds, (STEP, TURN))
            in_m = np.isin(way.kinds, (RANGE, STEP))
            constant = np.where(in_m, constant_m, constant_rad + constant_m * ~is_step)
            off = np.maximum(0.0, np.abs(stated) - 2.0 * constant * way.weights)
            ends = owners[way.bodies]
            others = np.where(ends[:, 0] == robot, ends[:, 1], ends[:, 0])
            if not any(_misfits(way.kinds, others, off, robot)):
                continue
            erring = [residuals_of(way.variant(n), fit) for n in range(1, VARIANTS)]
            explained = np.abs(np.array(erring) - stated).sum(axis=0)
            off = np.maximum(0.0, off - np.where(is_step, 0.0, explained))
            yield from _misfits(way.kinds, others, off, robot)


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


def _of_readings(terms: Terms, residuals: FloatArray) -> FloatArray:
    """Return the residuals of ranges and rays, zero for other terms."""
    return np.where(np.isin(terms.kinds, (RANGE, RAY)), residuals, 0.0)


def past_of(snapshot: Snapshot, solved: Constraints, turning: Collection[int]) -> Past | None:
    """
    Return what a window says of the points that are placed together; None when nothing.

    `turning` are the rows of the robots whose rotation is known or fitted to what they see now.
    That of others is guessed where they have seen landmarks, or what they saw is left out.
    """
    config, rows, odometry = snapshot.config, solved.rows, snapshot.motion.odometry
    if config.dimension != 2 or not snapshot.window.observations:
        return None
    moving = [
        robot
        for robot in config.robots
        if robot in rows
        and robot in odometry
        and robot not in config.anchors
        and odometry[robot][-1].stamp_s >= snapshot.stamp_s - config.max_age_s
    ]
    oldest_s = min(seen[0].stamp_s for seen in snapshot.window.observations.values())
    span_s = min(LONGEST_S, snapshot.stamp_s - oldest_s)
    if span_s <= 0.0 or len(moving) > MOST_POSES // 2:
        return None
    oldest_s = snapshot.stamp_s - span_s
    ways = {robot: StatedWay(snapshot, robot, oldest_s, rows[robot]) for robot in moving}
    table = _readings(snapshot, solved, ways)
    places_m = np.full((len(solved.points), 2), np.nan)
    for point, box in snapshot.anchors.boxes.items():
        if config.points[point] in rows:
            places_m[rows[config.points[point]]] = 0.5 * (box.lower + box.upper)
    laid = {way.row: _laid_on_map(way, table, places_m) for way in ways.values()}
    guesses = {row: pose for row, pose in laid.items() if pose is not None}
    known = [way for way in ways.values() if way.row in turning or way.row in guesses]
    left_out = [way.row for way in ways.values() if way not in known]
    table = table[~np.isin(table[:, :2], left_out).any(axis=1)]
    if not len(table):
        return None
    count = max(1, min(math.ceil(span_s / SPACING_S), MOST_POSES // len(known)))
    for number, way in enumerate(known):
        way.place_bodies(len(solved.points) + count * number, count)
    ends_of_all, steps = _ends(table, known), [way.steps() for way in known]
    observed = np.unique(table[:, 11:].astype(int), axis=0)
    return Past(
        Terms.joined([*_packed(table, ends_of_all), *steps]).variant(0),
        np.repeat([way.row for way in known], count),
        np.concatenate([way.poses_now(way.times_s[1:]) for way in known]),
        guesses,
        frozenset((config.points[o], config.points[t]) for o, t in observed.tolist()),
        tuple(
            Terms.joined([*_packed(*_by_errors(way, table, ends_of_all)), own_steps])
            for way, own_steps in zip(known, steps, strict=True)
        ),
        tuple(way.constants() for way in known),
    )


def _readings(
    snapshot: Snapshot, solved: Constraints, ways: Mapping[str, StatedWay]
) -> FloatArray:
    """
    Return what robots on their ways and landmarks observed of each other, shape (m, 13).

    A row has the bodies of observer and target, the time, the likeliest distance and its half
    width, the bearing and its error, the arms of both ends, and the points observer and target;
    NaN is what was not measured. Range differences are left out: a term has two ends.
    """
    config, arms, tables = snapshot.config, snapshot.mounts.arms_m, snapshot.carried.tables
    if not tables:
        return np.empty((0, 13))
    seen = Table.joined(tables.values())
    fixed = config.anchors.keys() & solved.rows.keys()
    robots = [config.robot_of(point) for point in config.points]
    rows = [solved.rows[robot] if robot in ways or robot in fixed else -1 for robot in robots]
    since_s = [ways[robot].since_s if robot in ways else -math.inf for robot in robots]
    observed_s = np.array(since_s)[seen.ends].max(axis=1)
    bodies = np.array(rows)[seen.ends]
    kept = (bodies >= 0).all(axis=1) & (seen.stamps_s >= observed_s) & (observed_s > -math.inf)
    kept[seen.differences] = False
    seen, bodies = seen.some(np.flatnonzero(kept)), bodies[kept]
    arms_m = np.array([arms.get(point, AT_ORIGIN)[:2] for point in config.points])[seen.ends]
    # Who may look anywhere has seen nothing.
    bearings_rad = np.arctan2(seen.rays[:, 1], seen.rays[:, 0]) - seen.expected_errors_rad
    bearings_rad[seen.errors_rad >= math.pi] = math.nan
    return np.column_stack(
        [
            bodies,
            seen.stamps_s,
            seen.likeliest_m,
            0.5 * (seen.upper_m - seen.lower_m),
            bearings_rad,
            seen.errors_rad,
            arms_m.reshape(-1, 4),
            seen.ends,
        ]
    )


def _by_errors(
    way: StatedWay, table: FloatArray, ends: Sequence[_End]
) -> tuple[FloatArray, list[_End]]:
    """Return the readings of a robot and their ends by each error of its own odometry alone."""
    own = table[:, :2].T == way.row
    mine = own.any(axis=0)
    erring = [
        _End(
            end.bodies[mine],
            np.where(on_way[mine, None], end.poses[:, mine], end.poses[0, mine]),
            end.unknown[mine],
            end.moves[mine],
        )
        for end, on_way in zip(ends, own, strict=True)
    ]
    return table[mine], erring


def _packed(table: FloatArray, ends: Sequence[_End]) -> list[Terms]:
    """Return the ranges and the rays of observations, as `_readings` has them."""
    distances_m, half_widths_m, bearings_rad, errors_rad = table[:, 3:7].T.copy()
    first, second = ends
    unknown_m = first.unknown[:, 0] + second.unknown[:, 0]
    apart_m = np.where(np.isfinite(distances_m), distances_m, np.inf)
    unknown_rad = first.unknown[:, 1] + unknown_m / np.maximum(apart_m, NEAREST_M)
    bodies = np.stack([first.bodies, second.bodies], axis=-1)
    arms_m = np.zeros((VARIANTS, len(bodies), 2, 3))
    for end, columns in enumerate((slice(7, 9), slice(9, 11))):
        arms_m[:, :, end, :2] = _points_on(ends[end].poses, table[:, columns])
    values = np.zeros((VARIANTS, len(bodies), 3))
    values[..., 0] = distances_m
    rays = directions(first.poses[..., 2] + bearings_rad)
    ranged = np.isfinite(distances_m) & np.isfinite(half_widths_m)
    # How what is fixed is turned is not known.
    sighted = np.isfinite(bearings_rad) & first.moves
    return [
        packed(kind, bodies[known], arms_m[:, known], value[:, known], half_widths[known])
        for kind, known, value, half_widths in (
            (RANGE, ranged, values, half_widths_m + unknown_m),
            (RAY, sighted, rays, errors_rad + unknown_rad),
        )
    ]


def _ends(table: FloatArray, ways: Iterable[StatedWay]) -> list[_End]:
    """
    Return where the observers and the targets of a table were, by the ways of robots.

    What is fixed has always been the same body.
    """
    found = []
    for rows in table[:, :2].T.astype(int):
        count = len(rows)
        poses, unknown = np.zeros((VARIANTS, count, 3)), np.zeros((count, 2))
        end = _End(rows.copy(), poses, unknown, np.zeros(count, bool))
        for way in ways:
            if (own := rows == way.row).any():
                end.bodies[own], end.poses[:, own], end.unknown[own] = way.ends(table[own, 2])
                end.moves[own] = True
        found.append(end)
    return found


def _points_on(poses: FloatArray, arms_m: FloatArray) -> FloatArray:
    """Return where points on bodies are, shape (..., m, 2), by the poses (x, y, yaw) of these."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = arms_m.T
    return poses[..., :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _laid_on_map(way: StatedWay, table: FloatArray, places_m: FloatArray) -> FloatArray | None:
    """
    Return the pose (x, y, yaw) that puts the landmarks that a robot saw where the map has them.

    Landmarks that are off count less in every round, so that a few that were misread do not
    matter. None where fewer than two are known.
    """
    own = table[table[:, 0] == way.row]
    poses, true_m = way.poses_now(own[:, 2]), places_m[own[:, 1].astype(int)]
    seen_m = _points_on(poses, own[:, 7:9])
    seen_m += own[:, 3:4] * directions(poses[:, 2] + own[:, 5])[:, :2]
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
