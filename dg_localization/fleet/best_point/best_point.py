# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The best point of a hypothesis: the placement that fits the likeliest readings best.

A fit starts at a placement of the hypothesis and stays in its enclosure. A single hypothesis gets
more fits, from the middle of the enclosure and from random points in it. A second fit adds the
readings of the window. If the result does not agree with the problem but the start does, a point
between them that agrees is returned.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.least_squares import (
    Bodies,
    Fit,
    equations_at,
    fit_terms,
    lines_of,
)
from dg_localization.fleet.best_point.normal_equations import SHORTEST_M
from dg_localization.fleet.best_point.past import Misfit, Past
from dg_localization.fleet.best_point.terms import (
    LEAST_HALF_WIDTH,
    MOST_BODIES,
    RANGE,
    RAY,
    UNIFORM,
    Term,
    Terms,
)
from dg_localization.fleet.rotations import best_rotation, rotations_about_z, unit_vectors
from dg_localization.interval.arrays import Interval
from dg_localization.solver.place.proofs import agrees
from dg_localization.solver.problem import Problem

FloatArray = NDArray[np.float64]

HALVINGS = 6
"""Bisections of the segment from the start to the result."""

DRAWN_STARTS = 2

MOST_EFFORT = 50_000_000
"""Most work on one problem: the sum, over its fits, of the cube of the number of unknowns."""

CLEAR_GAIN = 1e-3
"""A later start must lower the cost by this fraction of the cost, or of 1 if that is more: costs
near zero differ by rounding errors, which depend on the processor."""

UNKNOWN_VARIANCE_M2 = 1e12

MOST_SPREAD = 1e12
"""Information smaller than the largest by this factor is lost in rounding errors."""

SLIGHT = 0.1
"""A further error below this, in half widths, widens a covariance by at most 1 %."""


class BestPoint(NamedTuple):
    """
    A placement, and how it was chosen.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        Inside the enclosure.
    proved : bool
        Whether it meets every constraint of the problem, checked with outward rounding.
    rotations : numpy.ndarray, shape (n, 3, 3)
        Rotations of the bodies that turn, from body to fixed frame.
    covariances : numpy.ndarray, shape (n, 6, 6)
        Covariances of each position (m) and of a small rotation about the axes of the fixed frame
        (rad), for errors distributed uniformly within their bounds. Errors of readings of the
        moment count as independent; for the past see `Past.spread`. Zero for coordinates that the
        frame fixes and for rotations that are not fitted; NaN if nothing was fitted.
    cost : float
        The mean square of the residuals of the fit, in half widths; infinite if nothing was
        fitted.
    misfits : tuple of Misfit
        Groups of past readings and odometry steps that are too far off the fit.

    """

    positions_m: FloatArray
    proved: bool
    rotations: FloatArray
    covariances: FloatArray
    cost: float
    misfits: tuple[Misfit, ...] = ()

    def fitted_yaws_rad(self) -> FloatArray:
        """Return the headings in the plane, shape (n,); NaN for headings that were not fitted."""
        # Only fitted rotations have a variance above zero.
        fitted = self.covariances[:, 5, 5] > 0.0
        if self.positions_m.shape[1] != 2:
            fitted[:] = False
        yaws = np.arctan2(self.rotations[:, 1, 0], self.rotations[:, 0, 0])
        return np.where(fitted, yaws, np.nan)


class Sensor(NamedTuple):
    """A point on a body: the rows of both, and its position in the body frame, (3,)."""

    row: int
    body: int
    arm_m: FloatArray


class BestPointFinder:
    """Finds the best points of the hypotheses of one problem."""

    def __init__(
        self,
        problem: Problem,
        terms: Sequence[Term],
        held: Collection[int],
        sensors: Sequence[Sensor] = (),
    ) -> None:
        self._problem = problem
        self._terms = Terms.of(terms)
        self._held = held
        self._sensors = sensors
        # A ray from the body to each sensor along its lever arm.
        to_sensors = [
            Term(RAY, body, row, arm_m / np.linalg.norm(arm_m), LEAST_HALF_WIDTH)
            for row, body, arm_m in sensors
            if arm_m.any()
        ]
        sights = Terms.joined([self._terms, Terms.of(to_sensors)])
        turns = (sights.kinds == RAY) & ~np.isin(sights.bodies[:, 0], list(held))
        self._sights = Terms(*(column[turns] for column in sights))
        self.turning = frozenset(self._sights.bodies[:, 0].tolist())
        self._effort = 0

    def find(
        self,
        start_m: FloatArray,
        enclosure: Interval,
        among: tuple[FloatArray, FloatArray] | None = None,
        past: Past | None = None,
    ) -> BestPoint:
        """Return the best point of a hypothesis, or the start if no effort is left."""
        problem = self._problem
        if among is not None:
            problem = Problem(*among, dimension=problem.dimension, chiralities=problem.chiralities)
        if not np.isfinite(start_m).all() or self._effort >= MOST_EFFORT:
            rotations = np.tile(np.eye(3), (len(start_m), 1, 1))
            unknown = np.full((len(start_m), 6, 6), np.nan)
            return BestPoint(start_m, agrees(problem, start_m), rotations, unknown, math.inf)
        misfits: tuple[Misfit, ...] = ()
        if past is None:
            spread, terms = None, self._terms
            has_more = among is None and len(start_m) <= MOST_BODIES
            starts_m = _starts(start_m, enclosure) if has_more else [start_m]
            fits = [fit_terms(terms, self.start_of(one_m, enclosure)) for one_m in starts_m]
            start, fit = fits[0].bodies, fits[0]
            for other in fits[1:]:
                gain = fit.cost - other.cost
                fit = other if gain > CLEAR_GAIN * max(1.0, fit.cost) else fit
        else:
            start, terms = past.start, past.terms
            fit = fit_terms(terms, fit_terms(terms, self._with_past(past)).bodies, robust=True)
            residuals = past.residuals(fit)
            spread, misfits = past.spread(fit, residuals), tuple(past.misfits(fit, residuals))
        self._effort += int(start.free.sum()) ** 3
        best_m = self._with_sensors(fit, enclosure)
        positions_m, proved = _agreeing(problem, start_m, best_m)
        n_points = len(start_m)
        covariances = _covariances(terms, fit, spread, n_points)
        cost = fit.cost / max(1, len(terms.kinds))
        rotations = fit.bodies.rotations[:n_points]
        return BestPoint(positions_m, proved, rotations, covariances, cost, misfits)

    def _with_sensors(self, fit: Fit, enclosure: Interval) -> FloatArray:
        """Return the positions of a fit, with sensors placed by the poses of their bodies."""
        positions_m = fit.bodies.positions_m[: len(enclosure.lower)].copy()
        for row, body, arm_m in self._sensors:
            positions_m[row] = positions_m[body] + fit.bodies.rotations[body] @ arm_m
        positions_m = positions_m[:, : enclosure.lower.shape[1]]
        return np.asarray(np.clip(positions_m, enclosure.lower, enclosure.upper))

    def _with_past(self, past: Past) -> Bodies:
        """Return the start of a fit with past poses: the start of the moment, carried back."""
        bodies, positions_m, rotations = past.start, past.start.positions_m, past.start.rotations
        free = bodies.free.copy()
        free[[row for row in past.rows.tolist() if row not in self._held], 5] = True
        turns = rotations[past.rows]
        arms_m = _in_space(past.poses[:, :2])
        unbounded = np.full((len(arms_m), 3), math.inf)
        before_m = positions_m[past.rows] + np.einsum('kij,kj->ki', turns, arms_m)
        return Bodies(
            np.vstack([positions_m, before_m]),
            np.vstack([rotations, turns @ rotations_about_z(past.poses[:, 2])]),
            np.vstack([bodies.lower_m, -unbounded]),
            np.vstack([bodies.upper_m, unbounded]),
            np.vstack([free, np.tile([True, True, False, False, False, True], (len(arms_m), 1))]),
        )

    def start_of(self, start_m: FloatArray, enclosure: Interval) -> Bodies:
        """Return the start of a fit and its bounds."""
        n_points, dimension = start_m.shape
        free = np.zeros((n_points, 6), dtype=bool)
        free[:, :dimension] = enclosure.upper - enclosure.lower > SHORTEST_M
        free[[sensor.row for sensor in self._sensors]] = False
        free[list(self.turning), 3 if dimension == 3 else 5 :] = True
        rotations = np.tile(np.eye(3), (n_points, 1, 1))
        observers, targets = self._sights.bodies.T
        # Rotations of turning bodies are unknown yet; other bodies are upright.
        upright = ~np.isin(targets, list(self.turning))
        ends_m = start_m[targets] + upright[:, None] * self._sights.arms_m[:, 1, :dimension]
        lines = unit_vectors(ends_m - start_m[observers])
        for observer in self.turning:
            own = observers == observer
            seen, weights = self._sights.values[own, :dimension], self._sights.weights[own]
            rotations[observer, :dimension, :dimension] = best_rotation(seen, lines[own], weights)
        return Bodies(
            _in_space(start_m),
            rotations,
            _in_space(enclosure.lower),
            _in_space(enclosure.upper),
            free,
        )


def _in_space(places_m: FloatArray) -> FloatArray:
    """Return places in space, shape (n, 3), with zero height for places in the plane."""
    in_space_m = np.zeros((len(places_m), 3))
    in_space_m[:, : places_m.shape[1]] = places_m
    return in_space_m


def _starts(start_m: FloatArray, enclosure: Interval) -> list[FloatArray]:
    """
    Return the starts of fits: the middle of the enclosure, the given start, and random points.

    The middle comes first: coordinates that the readings leave open then stay in the middle.
    """
    bounded = np.isfinite(enclosure.lower) & np.isfinite(enclosure.upper)
    lower_m = np.where(bounded, enclosure.lower, start_m)
    width_m = np.where(bounded, enclosure.upper, start_m) - lower_m
    if width_m.max() <= SHORTEST_M:
        return [start_m]
    # A fixed seed, so that an answer does not depend on earlier answers.
    rng = np.random.default_rng(0)
    drawn = [lower_m + rng.random(start_m.shape) * width_m for _ in range(DRAWN_STARTS)]
    return [lower_m + 0.5 * width_m, start_m, *drawn]


def _agreeing(
    problem: Problem, start_m: FloatArray, best_m: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the best placement, or one towards the start that agrees, and whether one agrees."""
    if agrees(problem, best_m):
        return best_m, True
    if not agrees(problem, start_m):
        return best_m, False
    share = 0.0
    for halving in range(1, HALVINGS + 1):
        trial = share + 0.5**halving
        if agrees(problem, start_m + trial * (best_m - start_m)):
            share = trial
    return start_m + share * (best_m - start_m), True


def _covariances(terms: Terms, fit: Fit, spread: FloatArray | None, n_points: int) -> FloatArray:
    """
    Return the covariance of the position and rotation of each point.

    `spread` is the summed outer product of the gradients of dependent errors, after a robust fit.
    For independent errors that is the matrix of the fit.
    """
    rows = fit.columns[:n_points]
    excess = np.zeros_like(fit.matrix) if spread is None else spread - fit.matrix
    joint = _joint_covariance(fit, excess, n_points)
    # What ranges change to second order within this covariance counts as a further error.
    curved = _curvatures(terms, fit, joint[rows[:, :, None, None], rows])
    if curved.max(initial=0.0) > SLIGHT:
        widened = terms._replace(weights=terms.weights / np.hypot(1.0, curved))
        matrix, _ = equations_at(widened, fit, robust=spread is not None)
        joint = _joint_covariance(fit._replace(matrix=matrix), excess, n_points)
    return np.asarray(joint[rows[:, :, None], rows[:, None, :]])


def _curvatures(terms: Terms, fit: Fit, covariance: FloatArray) -> FloatArray:
    """
    Return the second-order changes of ranges, in half widths; zero for other terms.

    A range d grows by t^2 / (2 d) if an end moves by t across it, and a turn by w moves the end of
    an arm a by w x (w x a) / 2. The covariance of the points has the shape (n, 6, n, 6).
    """
    n_points = len(covariance)
    ranges = np.flatnonzero((terms.kinds == RANGE) & (terms.bodies < n_points).all(axis=1))
    bodies = terms.bodies[ranges]
    first, second = bodies.T
    lengths_m, along = (of_all[ranges] for of_all in lines_of(terms, fit.bodies))
    places = covariance[:, :3, :, :3]
    apart = places[first, :, first] + places[second, :, second]
    apart = apart - places[first, :, second] - places[second, :, first]
    across_m2 = np.trace(apart, axis1=1, axis2=2) - np.einsum('mi,mij,mj->m', along, apart, along)
    arms_m = np.einsum('mbij,mbj->mbi', fit.bodies.rotations[bodies], terms.arms_m[ranges])
    turns = covariance[bodies, 3:, bodies, 3:]
    turned_m = np.einsum('mbij,mbj,mi->mb', turns, arms_m, along)
    turned_m -= np.trace(turns, axis1=2, axis2=3) * np.einsum('mbi,mi->mb', arms_m, along)
    changes_m = across_m2 / np.maximum(lengths_m, SHORTEST_M) + np.abs(turned_m).sum(axis=1)
    curved = np.zeros(len(terms.kinds))
    curved[ranges] = 0.5 * UNIFORM * terms.weights[ranges] * changes_m
    return curved


def _joint_covariance(fit: Fit, excess: FloatArray, n_points: int) -> FloatArray:
    """
    Return the covariance of the free coordinates of the points, followed by a row of zeros.

    `excess` is what dependent errors add to the summed outer product of the gradients.
    """
    bodies = fit.bodies
    sides_m = np.maximum(bodies.upper_m - bodies.positions_m, bodies.positions_m - bodies.lower_m)
    turns = np.full(sides_m.shape, np.pi / np.sqrt(UNIFORM))
    widths = np.concatenate([sides_m, turns], axis=1)
    # The enclosure counts as one more reading, so that no deviation exceeds it.
    variances = np.minimum(widths[bodies.free] ** 2, UNKNOWN_VARIANCE_M2)
    equations = UNIFORM * fit.matrix + np.diag(1.0 / variances)
    size = int(bodies.free[:n_points].sum())
    try:
        np.linalg.cholesky(past := equations[size:, size:])
    except np.linalg.LinAlgError:
        # What is known about past poses is lost in rounding.
        inverse = np.diag(variances[:size])
    else:
        # Eliminate the past poses.
        before = -np.linalg.solve(past, equations[size:, :size])
        inverse = _inverse(
            equations[:size, :size] + equations[:size, size:] @ before, variances[:size]
        )
        gain = inverse @ np.hstack([np.eye(size), before.T])
        inverse = inverse + gain @ (UNIFORM * excess) @ gain.T
        # Where past poses are known far better than points, their errors are lost in rounding.
        lost = inverse.diagonal() < 0.0
        inverse[lost], inverse[:, lost] = 0.0, 0.0
        inverse[lost, lost] = variances[:size][lost]
    # Dependent errors must not exceed the enclosure either.
    shares = np.sqrt(variances[:size] / np.maximum(variances[:size], inverse.diagonal()))
    inverse *= shares[:, None] * shares
    # The last row, -1, stands for coordinates that are left out.
    everything = np.zeros((size + 1, size + 1))
    everything[:size, :size] = 0.5 * (inverse + inverse.T)
    return everything


def _inverse(equations: FloatArray, variances: FloatArray) -> FloatArray:
    """
    Return the inverse of normal equations that include prior variances.

    If points are known well relative to each other and badly relative to the rest, the weak
    information is lost in rounding; there the prior variances alone are used.
    """
    spread = float(np.max(equations.diagonal() * variances, initial=1.0))
    if spread <= MOST_SPREAD:
        return np.asarray(np.linalg.inv(equations))
    if not np.isfinite(equations).all():
        return np.diag(variances)
    scales = np.sqrt(variances)
    values, vectors = np.linalg.eigh(scales[:, None] * equations * scales)
    deviations = scales[:, None] * vectors
    deviations /= np.sqrt(np.where(values > spread / MOST_SPREAD, values, 1.0))
    return np.asarray(deviations @ deviations.T)
