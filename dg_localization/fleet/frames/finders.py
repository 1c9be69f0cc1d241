# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The best points of placements, by the readings of the moment and of the window."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.best_point.best_point import BestPointFinder, Sensor
from dg_localization.fleet.best_point.past import Misfit, past_of
from dg_localization.fleet.best_point.terms import (
    AT_ORIGIN,
    DIFFERENCE,
    PLACE,
    RANGE,
    RAY,
    STEP,
    TURN,
    Term,
    Terms,
)
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind, Placement, spread_out
from dg_localization.fleet.frames.plan import FramePlan
from dg_localization.fleet.rotations import yaw_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.interval.arrays import Interval
from dg_localization.solver.problem import Problem

FloatArray = NDArray[np.float64]


def finder_of(
    snapshot: Snapshot,
    solved: Constraints,
    plan: FramePlan,
    dropped: frozenset[LinkKey] = frozenset(),
) -> BestPointFinder:
    """Return the finder of best points for the placements of a plan with points `solved`."""
    rows = solved.rows
    sensors = [
        Sensor(rows[point], rows[snapshot.config.robot_of(point)], arm_m)
        for point, arm_m in snapshot.mounts.arms_m.items()
        if point in rows
    ]
    terms = list(_terms_of(snapshot, solved, plan, dropped))
    return BestPointFinder(solved.problem(), terms, plan.held, sensors)


def fit_with_past(
    snapshot: Snapshot,
    constraints: Constraints,
    alone: Collection[FramePlan],
    plan: FramePlan,
    placement: Placement,
) -> Placement:
    """
    Return a placement in the plane with the best point by readings of the moment and the window.

    Past readings of a robot count if its rotation is known by rays, its sensors or the window, or
    can be guessed from anchors. `constraints` are the constraints of all points of the fleet,
    `alone` the plans with one hypothesis. The placement is unchanged if the window holds nothing
    that a fit could use and robots are measured now.
    """
    if snapshot.config.dimension != 2 or placement.dropped:
        return placement
    solved, points = constraints.of(plan.points), list(plan.points)
    n_robots = len(snapshot.config.robots)
    yaws_rad = {
        row: yaw_of(placement.orientations_xyzw[point])
        for row, point in enumerate(points)
        if point < n_robots and placement.heading_known[point]
    }
    finder = finder_of(snapshot, solved, plan)
    places_m, boxes_m = _places_of_all(snapshot, placement)
    enclosure = Interval(boxes_m[points, 0], boxes_m[points, 1])
    start = finder.start_of(places_m[points], enclosure)
    past = past_of(snapshot, solved, start, {*plan.held, *finder.turning}, yaws_rad)
    if past is None:
        by_sets_alone = not snapshot.keys and plan.frame.kind is FrameKind.ANCHORS
        return _in_the_middle(placement) if by_sets_alone else placement
    # The enclosure of a hypothesis may hold points of another one.
    among = None if plan in alone else _squared_bounds(solved.problem(), points, placement)
    if among and np.any(among[0] > among[1]):
        return placement
    in_past = frozenset(key for key in snapshot.keys if key.ends in past.ends)
    beside = Terms.of([*_terms_of(snapshot, solved, plan, in_past)])
    past = past._replace(terms=Terms.joined([beside, past.terms]))
    best = finder.find(places_m[points], enclosure, among, past)
    is_another = among and not (best.proved or _within(among, best.positions_m))
    if is_another or math.isinf(best.cost):
        return placement
    places_m[points] = best.positions_m
    covariances = spread_out(len(places_m), points, best.covariances)
    fitted_yaws_rad = spread_out(len(places_m), points, best.fitted_yaws_rad())
    if placement.covariances is not None:
        for robot in np.flatnonzero(np.isnan(fitted_yaws_rad[:n_robots])):
            covariances[robot, 3:] = placement.covariances[robot, 3:]
            covariances[robot, :, 3:] = placement.covariances[robot, :, 3:]
    return replace(
        placement,
        positions_m=places_m[:n_robots],
        landmarks_m=places_m[n_robots : n_robots + len(placement.landmarks_m)],
        proved=best.proved,
        covariances=covariances[:n_robots],
        fitted_yaws_rad=fitted_yaws_rad[:n_robots],
        misfits=tuple(sorted(_sentence(solved, one) for one in best.misfits)),
    )


def _in_the_middle(placement: Placement) -> Placement:
    """Return a placement in the middle of its pose sets: no pose in them is likelier."""
    low_m, high_m = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    known = np.isfinite(low_m) & np.isfinite(high_m)
    positions_m = placement.positions_m.copy()
    positions_m[known] = 0.5 * (low_m[known] + high_m[known])
    return replace(placement, positions_m=positions_m, proved=False)


def _sentence(solved: Constraints, misfit: Misfit) -> str:
    """Return a sentence that names a misfit and its size."""
    robot, other = solved.points[misfit.robot], solved.points[misfit.other]
    what = {
        RANGE: f'ranges {robot} - {other}',
        RAY: f'bearings {robot} - {other}',
        DIFFERENCE: f'range differences {robot} - {other}',
        STEP: f'ways of the odometry of {robot}',
        TURN: f'turns of the odometry of {robot}',
    }[misfit.kind]
    return f'{what} ({misfit.rms:.1f} half widths off, at most {misfit.most:.1f})'


def _places_of_all(snapshot: Snapshot, placement: Placement) -> tuple[FloatArray, FloatArray]:
    """Return positions (n, 2) and enclosures (n, 2, 2) of all points; sensors as their robots."""
    config = snapshot.config
    places_m = [*placement.positions_m, *placement.landmarks_m]
    boxes_m = [*placement.enclosure_m, *placement.landmark_enclosure_m]
    for name, sensor in config.sensors.items():
        robot = config.rows[config.robot_of(name)]
        yaw_rad = yaw_of(placement.orientations_xyzw[robot])
        x, y = sensor.position_m
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        places_m.append(places_m[robot] + [c * x - s * y, s * x + c * y])
        reach_m = math.hypot(x, y) + sensor.bound_m
        boxes_m.append(boxes_m[robot] + np.array([[-reach_m], [reach_m]]))
    return np.array(places_m), np.array(boxes_m)


def _within(bounds_m2: tuple[FloatArray, FloatArray], positions_m: FloatArray) -> bool:
    """Return whether squared distances lie in their bounds, without a proof."""
    steps_m = positions_m[:, None] - positions_m[None]
    squared_m2 = (steps_m**2).sum(axis=-1)
    return bool(np.all((bounds_m2[0] <= squared_m2) & (squared_m2 <= bounds_m2[1])))


def _squared_bounds(
    problem: Problem, points: Sequence[int], placement: Placement
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds of a problem, with those between robots narrowed to a placement."""
    lower_m2, upper_m2 = problem.lower.copy(), problem.upper.copy()
    rows = [row for row, point in enumerate(points) if point < len(placement.lower_m)]
    here, there = np.ix_(rows, rows), np.ix_(*[[points[row] for row in rows]] * 2)
    apart = Interval(placement.lower_m[there], placement.upper_m[there]).square()
    lower_m2[here] = np.maximum(lower_m2[here], apart.lower)
    upper_m2[here] = np.minimum(upper_m2[here], apart.upper)
    return lower_m2, upper_m2


def _terms_of(
    snapshot: Snapshot,
    solved: Constraints,
    plan: FramePlan,
    dropped: frozenset[LinkKey],
) -> Iterator[Term]:
    """Yield a term for each reading of a snapshot between the points of `solved`."""
    rows = solved.rows
    config, arms_m = snapshot.config, snapshot.mounts.arms_m

    def end(point: str) -> tuple[int, ArrayLike]:
        """Return the body of a point, and its lever arm on the body."""
        return rows[config.robot_of(point)], arms_m.get(point, AT_ORIGIN)

    for reading in snapshot.distances:
        key = reading.key
        counts = key not in dropped and math.isfinite(reading.likeliest_m)
        if counts and rows.keys() >= {key.observer, key.target}:
            (first, first_arm_m), (second, second_arm_m) = end(key.observer), end(key.target)
            half_width_m = 0.5 * (reading.upper_m - reading.lower_m)
            value = (reading.likeliest_m, 0.0, 0.0)
            yield Term(RANGE, first, second, value, half_width_m, first_arm_m, second_arm_m)
    for observer, rays in solved.rays.items():
        for ray in rays:
            (row, arm_m), (target, target_arm_m) = end(observer), end(ray.key.target)
            # A ray with an error of a half turn or more measures nothing.
            if row != target and ray.half_width_rad < math.pi:
                direction = _turned_back(ray.direction, ray.expected_error_rad)
                yield Term(RAY, row, target, direction, ray.half_width_rad, arm_m, target_arm_m)
    by_anchors = plan.frame.kind is FrameKind.ANCHORS
    for row, box in (plan.by_row(snapshot.anchors.boxes) if by_anchors else {}).items():
        if (box.lower < box.upper).any():
            place_m = 0.5 * (box.lower + box.upper)
            half_width_m = 0.5 * float((box.upper - box.lower).max())
            yield Term(PLACE, row, row, (*place_m, 0.0)[:3], half_width_m)


def _turned_back(direction: FloatArray, error_rad: float) -> FloatArray:
    """Return a direction with an error about the vertical axis removed."""
    c, s = math.cos(error_rad), math.sin(error_rad)
    x, y, z = direction
    return np.array([c * x + s * y, c * y - s * x, z])
