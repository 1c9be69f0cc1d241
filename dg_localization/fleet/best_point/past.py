# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A window smoother: past poses, odometry and readings of the window as terms of a fit.

A moving robot has one body now and one at each of a few earlier times. Odometry joins each body to
the next, weighted by its bounds. A reading belongs to the bodies nearest in time; the poses of its
ends at its own time are lever arms in their frames. So all readings of a window count, and an
error of the odometry is shared by all bodies before it.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.best_point.least_squares import (
    Bodies,
    Fit,
    equations_at,
    fit_terms,
    residuals_of,
)
from dg_localization.fleet.best_point.stated_way import VARIANTS, StatedWay, directions, packed
from dg_localization.fleet.best_point.terms import (
    AT_ORIGIN,
    DIFFERENCE,
    MOST_BODIES,
    RANGE,
    RAY,
    READINGS,
    STEP,
    TURN,
    Terms,
)
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.rotations import rotation_angle_rad, rotations_about_z
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.memory import Ends, Table

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LONGEST_S = 30.0
"""Older readings carry little information, since odometry drifts."""

SPACING_S = 3.0
"""Least time between two bodies of a robot."""

START_YAWS_RAD = (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi)
SAME_RAD, DOUBTFUL_COST = 0.5, 3.0
"""A guess is doubtful if the fit at another rotation costs less than this more (in squared half
widths; three squared half widths are nine squared deviations)."""

GREATEST_OFF, MEAN_OFF, FEW = 2.0, 1.05, 8
"""Bounds count as violated if one residual exceeds the first, in half widths, or if the root mean
square of at least `FEW` residuals exceeds the second."""

NEAREST_M = 0.1
"""A nearer target may be seen in any direction after a small motion of its observer."""


class _Readings(NamedTuple):
    """Observations between moving robots and of landmarks."""

    seen: Table
    bodies: IntArray  # (m, 2): of the observers and the targets
    arms_m: FloatArray  # (m, 2, 2): of both
    places_m: FloatArray  # (m, 2): of the references of range differences

    def where(self, chosen: ArrayLike) -> _Readings:
        """Return the chosen readings."""
        (seen, bodies, arms_m, places_m), index = self, np.flatnonzero(chosen)
        return _Readings(seen.some(index), bodies[index], arms_m[index], places_m[index])


class _Ends(NamedTuple):
    """The bodies of the observers and the targets of readings, and poses in their frames."""

    bodies: IntArray  # (m, 2)
    poses: FloatArray  # (v, m, 2, 3): x, y and yaw, as stated and for each error of odometry
    unknown: FloatArray  # (m, 2, 2): uncertainty of these from silent odometry, in m and rad
    moves: NDArray[np.bool_]  # (m, 2): whether the body is a moving robot, not a fixed point


class Misfit(NamedTuple):
    """Readings or odometry steps that are off a fit, with their residuals in half widths."""

    kind: int
    robot: int
    other: int
    rms: float
    most: float


class Past(NamedTuple):
    """
    Past poses of robots, and the readings taken there.

    Parameters
    ----------
    terms : Terms
        Terms over the points of the problem, followed by the past poses.
    rows : numpy.ndarray of int, shape (k,)
        The robot of each past pose.
    poses : numpy.ndarray, shape (k, 3)
        x, y and yaw of each, relative to the pose of its robot now, as odometry states them.
    start : Bodies
        The poses of the points now at which a fit starts.
    ends : frozenset of (str, str)
        Observers and targets of the readings in the terms.
    ways : tuple of Terms
        The terms of each robot in several variants: the first as stated by odometry, the others
        with a constant odometry error along the whole path.
    constants : tuple of (float, float)
        For each robot, the odometry error at one time, in m and in rad: its constant error, and
        the motion within its latency.

    """

    terms: Terms
    rows: IntArray
    poses: FloatArray
    start: Bodies
    ends: frozenset[Ends]
    ways: tuple[Terms, ...]
    constants: tuple[tuple[float, float], ...]

    def residuals(self, fit: Fit) -> list[FloatArray]:
        """Return the residuals of the stated terms of each robot at a fit, in half widths."""
        return [residuals_of(way.variant(0), fit) for way in self.ways]

    def spread(self, fit: Fit, residuals: Sequence[FloatArray]) -> FloatArray:
        """
        Return the summed outer products of the error gradients at a robust fit.

        Errors of readings count as independent, except errors of one target near one time.
        Odometry may err the same way along the whole path, so its gradients are added first.
        `residuals` are the residuals of each robot.
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
        Yield the readings and odometry steps whose residuals at a robust fit exceed their bounds.

        Odometry errors shift a reading relative to the nearest body of the fit. The part of a
        residual that they explain does not count. `residuals` are the residuals of each robot.
        """
        n_points = len(fit.columns) - len(self.rows)
        owners = np.append(np.arange(n_points), self.rows)
        robots = dict.fromkeys(self.rows.tolist())
        for way, robot, stated, (constant_m, constant_rad) in zip(
            self.ways, robots, residuals, self.constants, strict=True
        ):
            is_step = np.isin(way.kinds, (STEP, TURN))
            in_m = np.isin(way.kinds, (RANGE, STEP, DIFFERENCE))
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
    """Yield the groups of terms of one kind and other end whose residuals are too large."""
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
    """Return the residuals of readings, zero for other terms."""
    return np.where(np.isin(terms.kinds, READINGS), residuals, 0.0)


def past_of(
    snapshot: Snapshot,
    solved: Constraints,
    start: Bodies,
    turning: Collection[int],
    yaws_rad: Mapping[int, float],
) -> Past | None:
    """
    Return the past of the points that are placed together; None if the window has no use.

    `start` is the start of a fit to the moment. `turning` are the rows of the robots whose
    rotation is known or fitted to readings of now. Poses of other robots are guessed from readings
    of anchors, with a start at `yaws_rad` where known; without a guess their readings are left
    out.
    """
    config, rows, odometry = snapshot.config, solved.rows, snapshot.motion.odometry
    if config.dimension != 2 or not snapshot.carried.tables:
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
    if span_s <= 0.0 or len(moving) > MOST_BODIES:
        return None
    oldest_s = snapshot.stamp_s - span_s
    ways = {robot: StatedWay(snapshot, robot, oldest_s, rows[robot]) for robot in moving}
    readings = _readings(snapshot, solved, ways, start)
    is_moving = np.isin(readings.bodies, [way.row for way in ways.values()])
    of_anchors = readings.where(~is_moving.all(axis=1))
    known = []
    for way in ways.values():
        laid: Bodies | None = start
        if way.row not in turning:
            laid = _laid_on_map(way, of_anchors, start, yaws_rad.get(way.row))
        if laid is not None:
            start = laid
            known.append(way)
    left_out = [way.row for way in ways.values() if way not in known]
    readings = readings.where(~np.isin(readings.bodies, left_out).any(axis=1))
    if not len(readings.bodies):
        return None
    count = max(1, min(math.ceil(span_s / SPACING_S), 2 * MOST_BODIES // len(known)))
    for number, way in enumerate(known):
        way.place_bodies(len(solved.points) + count * number, count)
    ends, steps = _ends(readings, known), [way.steps() for way in known]
    observed = np.unique(readings.seen.ends, axis=0)
    return Past(
        Terms.joined([*_packed(readings, ends), *steps]).variant(0),
        np.repeat([way.row for way in known], count),
        np.concatenate([way.poses_now(way.times_s[1:]) for way in known]),
        start,
        frozenset((config.points[o], config.points[t]) for o, t in observed.tolist()),
        tuple(
            Terms.joined([*_packed(*_by_errors(way, readings, ends)), own_steps])
            for way, own_steps in zip(known, steps, strict=True)
        ),
        tuple(way.constants() for way in known),
    )


def _readings(
    snapshot: Snapshot, solved: Constraints, ways: Mapping[str, StatedWay], start: Bodies
) -> _Readings:
    """Return the readings of some robots; range differences count if of anchors in the plane."""
    config, arms = snapshot.config, snapshot.mounts.arms_m
    seen = Table.joined(snapshot.carried.tables.values())
    fixed = config.anchors.keys() & solved.rows.keys()
    robots = [config.robot_of(point) for point in config.points]
    rows = np.array(
        [solved.rows[robot] if robot in ways or robot in fixed else -1 for robot in robots]
    )
    since_s = [ways[robot].since_s if robot in ways else -math.inf for robot in robots]
    observed_s = np.array(since_s)[seen.ends].max(axis=1)
    bodies, references = rows[seen.ends], rows[seen.references_of_targets]
    kept = (bodies >= 0).all(axis=1) & (seen.stamps_s >= observed_s) & (observed_s > -math.inf)
    is_level = np.array([config.elevation_m(point) == (0.0, 0.0) for point in config.points])
    is_held = is_level & (rows >= 0) & ~start.free[rows, :2].any(axis=1)
    is_held &= ~np.isin(config.points, list(arms))
    ends = np.column_stack([seen.ends[:, 1], seen.references_of_targets])
    usable = is_level[seen.ends[:, 0]] & is_held[ends].all(axis=1)
    kept[seen.differences] &= usable[seen.differences]
    seen, bodies, references = seen.some(np.flatnonzero(kept)), bodies[kept], references[kept]
    arms_m = np.array([arms.get(point, AT_ORIGIN)[:2] for point in config.points])[seen.ends]
    return _Readings(seen, bodies, arms_m, start.positions_m[references, :2])


def _by_errors(way: StatedWay, readings: _Readings, ends: _Ends) -> tuple[_Readings, _Ends]:
    """Return the readings of a robot, and their ends with errors of its own odometry only."""
    on_way = readings.bodies == way.row
    mine = on_way.any(axis=1)
    bodies, poses, unknown, moves = ends
    erring = np.where(on_way[mine, :, None], poses[:, mine], poses[0, mine])
    return readings.where(mine), _Ends(bodies[mine], erring, unknown[mine], moves[mine])


def _packed(readings: _Readings, ends: _Ends) -> list[Terms]:
    """Return terms for readings."""
    bodies, seen = ends.bodies, readings.seen
    distances_m, half_widths_m = seen.likeliest_m, 0.5 * (seen.upper_m - seen.lower_m)
    bearings_rad = np.arctan2(seen.rays[:, 1], seen.rays[:, 0]) - seen.expected_errors_rad
    unknown_m = ends.unknown[:, :, 0].sum(axis=1)
    apart_m = np.where(np.isfinite(distances_m), distances_m, np.inf)
    unknown_rad = ends.unknown[:, 0, 1] + unknown_m / np.maximum(apart_m, NEAREST_M)
    arms_m = np.zeros((VARIANTS, len(bodies), 2, 3))
    arms_m[..., :2] = _points_on(ends.poses, readings.arms_m)
    values = np.zeros((VARIANTS, len(bodies), 3))
    values[..., 0] = distances_m
    rays = directions(ends.poses[:, :, 0, 2] + bearings_rad)
    ranged = np.isfinite(distances_m) & np.isfinite(half_widths_m)
    # A ray with an error of a half turn or more measures nothing, nor does one of a fixed point,
    # whose orientation is unknown.
    sighted = (seen.errors_rad < math.pi) & ends.moves[:, 0]
    heard = np.isfinite(seen.most_m)
    least_m, most_m = np.where(heard, [seen.least_m, seen.most_m], 0.0)
    differences = np.zeros_like(values)
    differences[..., :2], differences[..., 2] = readings.places_m, 0.5 * (least_m + most_m)
    return [
        packed(kind, bodies[known], arms_m[:, known], value[:, known], half_widths[known])
        for kind, known, value, half_widths in (
            (RANGE, ranged, values, half_widths_m + unknown_m),
            (RAY, sighted, rays, seen.errors_rad + unknown_rad),
            (DIFFERENCE, heard, differences, 0.5 * (most_m - least_m) + unknown_m),
        )
    ]


def _ends(readings: _Readings, ways: Iterable[StatedWay]) -> _Ends:
    """
    Return the ends of readings.

    A fixed point is the same body at all times.
    """
    bodies, shape = readings.bodies.copy(), readings.bodies.shape
    poses, unknown = np.zeros((VARIANTS, *shape, 3)), np.zeros((*shape, 2))
    moves = np.zeros(shape, bool)
    for way in ways:
        own = readings.bodies == way.row
        if own.any():
            stamps_s = readings.seen.stamps_s[np.nonzero(own)[0]]
            bodies[own], poses[:, own], unknown[own] = way.ends(stamps_s)
            moves |= own
    return _Ends(bodies, poses, unknown, moves)


def _points_on(poses: FloatArray, arms_m: FloatArray) -> FloatArray:
    """Return the places of points on bodies with poses (x, y, yaw), shape (..., 2)."""
    c, s = np.cos(poses[..., 2]), np.sin(poses[..., 2])
    x, y = np.moveaxis(arms_m, -1, 0)
    return poses[..., :2] + np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _laid_on_map(
    way: StatedWay, readings: _Readings, start: Bodies, yaw_rad: float | None
) -> Bodies | None:
    """
    Return a start with one robot at the pose that fits its readings of anchors best.

    Its way is rigid here. A fit starts at the yaw, or at a few if that is unknown. Return None if
    another rotation fits nearly as well.
    """
    turned = []
    for turn in rotations_about_z(np.array(START_YAWS_RAD if yaw_rad is None else [yaw_rad])):
        rotations = start.rotations.copy()
        rotations[way.row] = turn
        turned.append(start._replace(rotations=rotations))
    own = readings.where((readings.bodies == way.row).any(axis=1))
    if not len(own.bodies):
        return None if yaw_rad is None else turned[0]
    way.place_bodies(way.row, 0)
    terms = Terms.joined(_packed(own, _ends(own, [way]))).variant(0)
    free = np.zeros_like(start.free)
    free[way.row, [0, 1, 5]] = True
    fits = [fit_terms(terms, one._replace(free=free), robust=True) for one in turned]
    best = min(fits, key=lambda fit: fit.cost)
    rotation = best.bodies.rotations[way.row]
    for fit in fits:
        apart_rad = rotation_angle_rad(rotation.T @ fit.bodies.rotations[way.row])
        if apart_rad > SAME_RAD and fit.cost < best.cost + DOUBTFUL_COST:
            return None
    return best.bodies._replace(free=start.free)
