# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What is remembered as terms of a fit: old readings, carried to now by odometry.

Where a robot was is an arm of its body now. What odometry leaves open of the arm is added to the
half width of the reading.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
import math

import numpy as np

from dg_localization.fleet.best_point.terms import RangeTerm, RayTerm, Term
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.window.carry import WORLD, Pair
from dg_localization.interval.arrays import Interval
from dg_localization.pairs import PairReadings

MOST_PER_PAIR = 32
"""How many old readings of two bodies count at most, spread in time."""

WIDEST_RAY_RAD = 0.5 * math.pi


def remembered_terms(
    snapshot: Snapshot, solved: Constraints, anchors: Mapping[int, Interval]
) -> Iterator[Term]:
    """
    Yield a term for each old reading between bodies whose rotation is fitted.

    Parameters
    ----------
    snapshot : Snapshot
    solved : Constraints
        Of the points that are placed together; a body is one of them.
    anchors : mapping of int to Interval
        Coordinates of the anchors, where these give the frame.

    Yields
    ------
    Term

    """
    config = snapshot.config
    if config.dimension != 2 or not snapshot.window.observations:
        return
    row_of = {
        number: solved.rows[robot]
        for number, robot in enumerate(config.robots)
        if robot in solved.rows and robot not in config.anchors
    }
    # Any anchor does for the world: none of them turns.
    world = next(iter(anchors), None)
    if world is not None:
        row_of[WORLD] = world
    terms: list[RangeTerm | RayTerm] = []
    carried = snapshot.carried
    for pair in carried.pairs:
        if row_of.keys() >= set(pair):
            stamps_s = carried.stamps_s(pair)
            old = np.flatnonzero(stamps_s < snapshot.stamp_s - config.max_age_s)
            origin_m = np.zeros(3)
            if pair[0] == WORLD and world is not None:
                origin_m[:2] = 0.5 * (anchors[world].lower + anchors[world].upper)
            rows = row_of[pair[0]], row_of[pair[1]]
            terms += _terms_of(carried.readings(pair), old, rows, origin_m)
    # The arm of a body whose rotation is not fitted points anywhere.
    turning = {solved.rows[config.robot_of(observer)] for observer in solved.rays}
    turning |= {term.observer for term in terms if isinstance(term, RayTerm)}
    turning |= set() if world is None else {world}
    yield from (term for term in terms if turning >= set(_ends_of(term)))


def _terms_of(
    readings: PairReadings, old: np.ndarray, rows: Pair, origin_m: np.ndarray
) -> Iterator[RangeTerm | RayTerm]:
    """Yield the terms of some readings of two bodies."""
    points_a_m, spread_a_m = _middles(readings.points_a_m)
    points_b_m, spread_b_m = _middles(readings.points_b_m)
    points_a_m = points_a_m - origin_m
    first, second = rows
    lower_m, upper_m = readings.distance_m.lower, readings.distance_m.upper
    chosen = old[np.linspace(0, len(old) - 1, min(len(old), MOST_PER_PAIR)).astype(int)]
    for i in chosen.tolist():
        arms = points_a_m[i], points_b_m[i]
        spread_m = spread_a_m[i] + spread_b_m[i]
        apart_m = math.inf
        if math.isfinite(upper_m[i]):
            apart_m = 0.5 * (lower_m[i] + upper_m[i])
            half_width_m = 0.5 * (upper_m[i] - lower_m[i]) + spread_m
            yield RangeTerm(first, second, apart_m, half_width_m, *arms)
        if readings.ray_errors_rad[i] < WIDEST_RAY_RAD and spread_m < apart_m < math.inf:
            half_width_rad = float(readings.ray_errors_rad[i]) + spread_m / apart_m
            if readings.seen_by_b[i]:
                yield RayTerm(second, first, readings.rays[i], half_width_rad, *arms[::-1])
            else:
                yield RayTerm(first, second, readings.rays[i], half_width_rad, *arms)


def _ends_of(term: RangeTerm | RayTerm) -> tuple[int, int]:
    """Return the rows of the two bodies of a term."""
    if isinstance(term, RayTerm):
        return term.observer, term.target
    return term.first, term.second


def _middles(points: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles of boxes, and how far a point of each can be from there."""
    middles = 0.5 * (points.lower + points.upper)
    return middles, np.linalg.norm(points.upper - middles, axis=1)
