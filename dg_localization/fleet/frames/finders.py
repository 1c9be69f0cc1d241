# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Finders of best points: for what is placed, and again when a window has told headings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.best_point import BestPointFinder, Sensor, rays_by_body
from dg_localization.fleet.best_point.past import Past, past_of, robots_that_saw
from dg_localization.fleet.best_point.readings import terms_of
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind, Placement
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
    past: Past | None,
    dropped: frozenset[LinkKey] = frozenset(),
    yaws_rad: Mapping[int, float] = MappingProxyType({}),
) -> BestPointFinder:
    """Return what finds the best points of the placements of a plan, by all readings."""
    rows, by_anchors = solved.rows, plan.frame.kind is FrameKind.ANCHORS
    anchors = plan.by_row(snapshot.anchors.boxes) if by_anchors else {}
    terms = list(terms_of(snapshot, solved, dropped, anchors))
    sensors = [
        Sensor(rows[point], rows[snapshot.config.robot_of(point)], arm_m)
        for point, arm_m in snapshot.mounts.arms_m.items()
        if point in rows
    ]
    beside_past = []
    if past is not None:
        turning = rays_by_body(terms, sensors, plan.held)
        past = past.of_robots({*plan.held, *turning, *past.guesses, *yaws_rad})
        in_past = frozenset(key for key in snapshot.keys if key.ends in past.ends)
        beside_past = list(terms_of(snapshot, solved, dropped | in_past, anchors))
    problem = solved.problem()
    return BestPointFinder(problem, terms, plan.held, sensors, past, beside_past, yaws_rad)


@dataclass(frozen=True)
class FittedPlacement:
    """
    A placement, and how well its best point fits.

    Parameters
    ----------
    placement : Placement
    cost : float
        The mean square of the residuals, in half widths; infinite where nothing was fitted.

    """

    placement: Placement
    cost: float = math.inf


def fit_headed(
    snapshot: Snapshot, constraints: Constraints, plan: FramePlan, placement: Placement
) -> FittedPlacement:
    """
    Return a placement with the best point by headings that a window has told.

    The heading of a robot without cameras is not known when it is placed. With it, what the robot
    measured before counts, too.
    """
    solved, points = constraints.of(plan.points), list(plan.points)
    robots, n_robots = snapshot.config.robots, len(snapshot.config.robots)
    headed = [
        robot
        for robot in _headed_by_window(snapshot, placement)
        if robot in points and points.index(robot) not in plan.held
    ]
    if not headed:
        return FittedPlacement(placement)
    past = past_of(snapshot, solved, [robots[robot] for robot in headed])
    if past is None:
        return FittedPlacement(placement)
    yaws_rad = {
        points.index(robot): yaw_of(placement.orientations_xyzw[robot])
        for robot in headed
        if points.index(robot) in past.rows
    }
    bounds_m2 = _squared_bounds(solved.problem(), points, placement)
    if not yaws_rad or np.any(bounds_m2[0] > bounds_m2[1]):
        return FittedPlacement(placement)
    places_m, boxes_m = _places_of_all(snapshot, placement)
    boxes_m = boxes_m[points]
    finder = finder_of(snapshot, solved, plan, past, yaws_rad=yaws_rad)
    best = finder.find(places_m[points], Interval(boxes_m[:, 0], boxes_m[:, 1]), bounds_m2)
    # The enclosure of a hypothesis may hold points of another one.
    if math.isinf(best.cost) or not (best.proved or _within(bounds_m2, best.positions_m)):
        return FittedPlacement(placement)
    places_m[points] = best.positions_m
    covariances = np.full((len(places_m), 6, 6), np.nan)
    covariances[points] = best.covariances
    fitted_yaws_rad = np.full(len(places_m), np.nan)
    fitted_yaws_rad[points] = best.fitted_yaws_rad()
    fitted = replace(
        placement,
        positions_m=places_m[:n_robots],
        landmarks_m=places_m[n_robots : n_robots + len(placement.landmarks_m)],
        proved=best.proved,
        covariances=_with_unfitted(covariances[:n_robots], fitted_yaws_rad, placement),
        fitted_yaws_rad=fitted_yaws_rad[:n_robots],
    )
    return FittedPlacement(fitted, best.cost)


def _places_of_all(snapshot: Snapshot, placement: Placement) -> tuple[FloatArray, FloatArray]:
    """Return places (n, 2) and enclosures (n, 2, 2) of all points, sensors with their robots."""
    config = snapshot.config
    places_m = [*placement.positions_m, *placement.landmarks_m]
    boxes_m = [*placement.enclosure_m, *placement.landmark_enclosure_m]
    for name, sensor in config.sensors.items():
        robot = config.robots.index(config.robot_of(name))
        yaw_rad = yaw_of(placement.orientations_xyzw[robot])
        x, y = sensor.position_m
        c, s = math.cos(yaw_rad), math.sin(yaw_rad)
        places_m.append(places_m[robot] + [c * x - s * y, s * x + c * y])
        reach_m = math.hypot(x, y) + sensor.bound_m
        boxes_m.append(boxes_m[robot] + np.array([[-reach_m], [reach_m]]))
    return np.array(places_m), np.array(boxes_m)


def _headed_by_window(snapshot: Snapshot, placement: Placement) -> list[int]:
    """Return the robots whose headings are known, and were not fitted to what is remembered."""
    if not placement.heading_known.any():
        return []
    seeing = robots_that_saw(snapshot)
    fitted = np.array([robot in seeing for robot in snapshot.config.robots])
    if placement.fitted_yaws_rad is not None:
        fitted &= np.isfinite(placement.fitted_yaws_rad)
    return np.flatnonzero(placement.heading_known & ~fitted).tolist()


def _with_unfitted(
    covariances: FloatArray, fitted_yaws_rad: FloatArray, placement: Placement
) -> FloatArray:
    """Return covariances with those of a placement for headings that were not fitted."""
    if placement.covariances is not None:
        for robot in np.flatnonzero(np.isnan(fitted_yaws_rad[: len(covariances)])):
            covariances[robot, 3:] = placement.covariances[robot, 3:]
            covariances[robot, :, 3:] = placement.covariances[robot, :, 3:]
    return covariances


def _within(bounds_m2: tuple[FloatArray, FloatArray], positions_m: FloatArray) -> bool:
    """Return whether squared distances lie in their bounds, without a proof."""
    steps_m = positions_m[:, None] - positions_m[None]
    squared_m2 = (steps_m**2).sum(axis=-1)
    return bool(np.all((bounds_m2[0] <= squared_m2) & (squared_m2 <= bounds_m2[1])))


def _squared_bounds(
    problem: Problem, points: Sequence[int], placement: Placement
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds of a problem, those between robots as narrow as in a placement."""
    lower_m2, upper_m2 = problem.lower.copy(), problem.upper.copy()
    rows = [row for row, point in enumerate(points) if point < len(placement.lower_m)]
    here, there = np.ix_(rows, rows), np.ix_(*[[points[row] for row in rows]] * 2)
    apart = Interval(placement.lower_m[there], placement.upper_m[there]).square()
    lower_m2[here] = np.maximum(lower_m2[here], apart.lower)
    upper_m2[here] = np.minimum(upper_m2[here], apart.upper)
    return lower_m2, upper_m2
