# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The best point of a hypothesis: the placement that fits the likeliest readings best.

A fit starts at a placement of the hypothesis and stays in its enclosure. Where no other hypothesis
is left, others start in the middle of the enclosure and all over it. What is remembered joins in a
second fit. The result is published as it is when it agrees with the problem, and else the point
towards the start that does.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.least_squares import Bodies, Fit, fit_terms
from dg_localization.fleet.best_point.past import Misfit, Past
from dg_localization.fleet.best_point.terms import LEAST_HALF_WIDTH, RAY, UNIFORM, Term, Terms
from dg_localization.fleet.rotations import best_rotation, rotations_about_z, unit_vectors
from dg_localization.interval.arrays import Interval
from dg_localization.solver.place.proofs import agrees
from dg_localization.solver.problem import Problem

FloatArray = NDArray[np.float64]

HALVINGS = 6
"""How often the way back to the start is halved."""

DRAWN_STARTS = 2
MOST_BODIES = 30
"""Larger fleets have one start only: a fit takes the cube of their number."""

MOST_EFFORT = 50_000_000
"""Most work on one problem: the sum of the cubes of the numbers that its fits change."""

CLEAR_GAIN = 1e-3
"""A later start counts where its cost is lower by this part of the others', or of 1: costs near
zero differ by rounding errors, and these by the processor."""

LEAST_WIDTH_M = 1e-9
"""What the enclosure leaves less of is given by the frame, but for rounding."""

UNKNOWN_VARIANCE_M2 = 1e12

MOST_SPREAD = 1e12
"""Information that is smaller than the largest by so much is lost in rounding errors."""


@dataclass(frozen=True)
class BestPoint:
    """
    A placement, and how it was chosen.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        Inside the enclosure.
    proved : bool
        Whether it meets every constraint of the problem, checked with outward rounding.
    rotations : numpy.ndarray, shape (n, 3, 3)
        Of the bodies that turn, from body to fixed frame.
    covariances : numpy.ndarray, shape (n, 6, 6)
        Of each position (m) and of a small rotation about the axes of the fixed frame (rad), for
        errors that are anywhere in their bounds. Those of readings of the moment are independent
        of each other; `Past.spread` says so of the past. Zero for what the frame fixes, and for
        rotations that are not fitted; NaN where nothing was fitted.
    cost : float
        The mean square of the residuals that the fit leaves, in half widths; infinite where
        nothing was fitted.
    misfits : tuple of Misfit
        What is remembered and too far off the fit.

    """

    positions_m: FloatArray
    proved: bool
    rotations: FloatArray
    covariances: FloatArray
    cost: float
    misfits: tuple[Misfit, ...] = ()

    def fitted_yaws_rad(self) -> FloatArray:
        """Return the headings in the plane, shape (n,); NaN where none was fitted."""
        # A rotation that was not fitted has no variance, one that was has some.
        fitted = self.covariances[:, 5, 5] > 0.0
        if self.positions_m.shape[1] != 2:
            fitted[:] = False
        yaws = np.arctan2(self.rotations[:, 1, 0], self.rotations[:, 0, 0])
        return np.where(fitted, yaws, np.nan)


class Sensor(NamedTuple):
    """A point that moves with a body: rows of both, and where it is in the body frame, (3,)."""

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
        # The body has each sensor in the direction of its arm.
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
        yaws_rad: Mapping[int, float] = MappingProxyType({}),
    ) -> BestPoint:
        """Return the best point of a hypothesis, or the start where the effort is used up."""
        problem = self._problem
        if among is not None:
            problem = Problem(*among, dimension=problem.dimension, chiralities=problem.chiralities)
        if not np.isfinite(start_m).all() or self._effort >= MOST_EFFORT:
            rotations = np.tile(np.eye(3), (len(start_m), 1, 1))
            unknown = np.full((len(start_m), 6, 6), np.nan)
            return BestPoint(start_m, agrees(problem, start_m), rotations, unknown, math.inf)
        bodies = self._bodies(start_m, enclosure)
        self._effort += int(bodies.free.sum()) ** 3
        misfits: tuple[Misfit, ...] = ()
        if past is None:
            spread, terms = None, self._terms
            has_more = among is None and len(start_m) <= MOST_BODIES
            starts = _starts(start_m, enclosure) if has_more else [start_m]
            fits = [fit_terms(terms, self._bodies(one_m, enclosure)) for one_m in starts]
            fit = fits[0]
            for other in fits[1:]:
                gain = fit.cost - other.cost
                fit = other if gain > CLEAR_GAIN * max(1.0, fit.cost) else fit
        else:
            terms = past.terms
            bodies = self._with_past(past, bodies, yaws_rad)
            fit = fit_terms(terms, fit_terms(terms, bodies).bodies, robust=True)
            residuals = past.residuals(fit)
            spread, misfits = past.spread(fit, residuals), tuple(past.misfits(fit, residuals))
        best_m = self._with_sensors(fit, enclosure)
        positions_m, proved = _agreeing(problem, start_m, best_m)
        n_points = len(start_m)
        covariances = _covariances(fit, spread, n_points)
        cost = fit.cost / max(1, len(terms.kinds))
        rotations = fit.bodies.rotations[:n_points]
        return BestPoint(positions_m, proved, rotations, covariances, cost, misfits)

    def _with_sensors(self, fit: Fit, enclosure: Interval) -> FloatArray:
        """Return the positions of a fit, with the sensors where their bodies have them."""
        positions_m = fit.bodies.positions_m[: len(enclosure.lower)].copy()
        for row, body, arm_m in self._sensors:
            positions_m[row] = positions_m[body] + fit.bodies.rotations[body] @ arm_m
        positions_m = positions_m[:, : enclosure.lower.shape[1]]
        return np.asarray(np.clip(positions_m, enclosure.lower, enclosure.upper))

    def _with_past(self, past: Past, bodies: Bodies, yaws_rad: Mapping[int, float]) -> Bodies:
        """Return where a fit with what is remembered starts: at that of the moment."""
        positions_m, rotations = bodies.positions_m.copy(), bodies.rotations.copy()
        free = bodies.free.copy()
        for row in {*past.rows.tolist()} - {*self._held}:
            free[row, 5] = True
            if row in self.turning:
                continue
            if row not in past.guesses:
                yaw_rad = yaws_rad[row]
            else:
                x, y, yaw_rad = past.guesses[row]
                guess_m = np.clip([x, y, 0.0], bodies.lower_m[row], bodies.upper_m[row])
                positions_m[row] = np.where(free[row, :3], guess_m, positions_m[row])
            rotations[row] = rotations_about_z(np.array([yaw_rad]))[0]
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

    def _bodies(self, start_m: FloatArray, enclosure: Interval) -> Bodies:
        """Return where the fit starts and where it may go."""
        n_points, dimension = start_m.shape
        free = np.zeros((n_points, 6), dtype=bool)
        free[:, :dimension] = enclosure.upper - enclosure.lower > LEAST_WIDTH_M
        free[[sensor.row for sensor in self._sensors]] = False
        free[list(self.turning), 3 if dimension == 3 else 5 :] = True
        rotations = np.tile(np.eye(3), (n_points, 1, 1))
        observers, targets = self._sights.bodies.T
        # How other bodies are turned is not known yet, and those that do not turn are upright.
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
    """Return places in space, those in the plane at zero height, shape (n, 3)."""
    in_space_m = np.zeros((len(places_m), 3))
    in_space_m[:, : places_m.shape[1]] = places_m
    return in_space_m


def _starts(start_m: FloatArray, enclosure: Interval) -> list[FloatArray]:
    """
    Return where fits start: the middle of the enclosure where it is bounded, and all over it.

    The middle comes first: where readings leave a point open, it is the one that is left.
    """
    bounded = np.isfinite(enclosure.lower) & np.isfinite(enclosure.upper)
    lower_m = np.where(bounded, enclosure.lower, start_m)
    width_m = np.where(bounded, enclosure.upper, start_m) - lower_m
    if width_m.max() <= LEAST_WIDTH_M:
        return [start_m]
    # Always the same ones, so that an answer does not depend on those before it.
    rng = np.random.default_rng(0)
    drawn = [lower_m + rng.random(start_m.shape) * width_m for _ in range(DRAWN_STARTS)]
    return [lower_m + 0.5 * width_m, start_m, *drawn]


def _agreeing(
    problem: Problem, start_m: FloatArray, best_m: FloatArray
) -> tuple[FloatArray, bool]:
    """Return the placement nearest to the best one that agrees with the problem, if one does."""
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


def _covariances(fit: Fit, spread: FloatArray | None, n_points: int) -> FloatArray:
    """
    Return the covariance of each point: of its position, and of its rotation.

    `spread` are the products of the gradients that errors make, where these depend on each other.
    Those of independent ones are the matrix of the fit.
    """
    bodies = fit.bodies
    sides_m = np.maximum(bodies.upper_m - bodies.positions_m, bodies.positions_m - bodies.lower_m)
    turns = np.full(sides_m.shape, np.pi / np.sqrt(UNIFORM))
    widths = np.concatenate([sides_m, turns], axis=1)
    # The enclosure counts as one more reading, so that nothing is wider than it.
    variances = np.minimum(widths[bodies.free] ** 2, UNKNOWN_VARIANCE_M2)
    equations = UNIFORM * fit.matrix + np.diag(1.0 / variances)
    size = int(bodies.free[:n_points].sum())
    # What was before now is eliminated.
    before = -np.linalg.solve(equations[size:, size:], equations[size:, :size])
    inverse = _inverse(
        equations[:size, :size] + equations[:size, size:] @ before, variances[:size]
    )
    if spread is not None:
        gain = inverse @ np.hstack([np.eye(size), before.T])
        inverse = inverse + gain @ (UNIFORM * (spread - fit.matrix)) @ gain.T
    everything = np.zeros((size + 1, size + 1))
    everything[:size, :size] = 0.5 * (inverse + inverse.T)
    # The last row, -1, stands for what is left out.
    rows = fit.columns[:n_points]
    return np.asarray(everything[rows[:, :, None], rows[:, None, :]])


def _inverse(equations: FloatArray, variances: FloatArray) -> FloatArray:
    """
    Return the inverse of normal equations that hold some variances.

    These alone are what is left of information that rounding hides: of points that are known well
    from each other, and hardly at all from the rest.
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
