# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Least squares within bounds: Levenberg-Marquardt steps, projected on a box.

Every accepted step lowers the cost and stays in the box. There is no outward rounding: the result
is an estimate.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.normal_equations import (
    LEFT_OUT,
    SHORTEST_M,
    normal_equations,
)
from dg_localization.fleet.best_point.terms import (
    DIFFERENCE,
    PLACE,
    RANGE,
    RAY,
    STEP,
    TURN,
    Terms,
)
from dg_localization.solver.place.placements import MOST_DAMPING, MOST_STEPS, THOROUGH

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]

FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
"""Terms added to the diagonal of the normal equations, as fractions of it."""

VECTOR_PRODUCT = np.cross(np.eye(3)[:, None], np.eye(3)).swapaxes(1, 2).reshape(3, 9)
"""A vector times this is its cross-product matrix, row by row."""


class Bodies(NamedTuple):
    """
    Poses of bodies, with bounds.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, 3)
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to fixed frame.
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the positions; they hold `positions_m`.
    free : numpy.ndarray of bool, shape (n, 6)
        Whether each coordinate and each rotation about an axis of the fixed frame may change.

    """

    positions_m: FloatArray
    rotations: FloatArray
    lower_m: FloatArray
    upper_m: FloatArray
    free: BoolArray

    def moved(self, step: FloatArray) -> Bodies:
        """Return the bodies after a step of the free coordinates, clipped to the bounds."""
        moves = np.zeros(self.free.shape)
        moves[self.free] = step
        positions_m = np.minimum(self.positions_m + moves[:, :3], self.upper_m)
        positions_m = np.maximum(positions_m, self.lower_m)
        positions_m = np.where(self.free[:, :3], positions_m, self.positions_m)
        rotations = self.rotations
        if self.free[:, 3:].any():
            rotations = _small_rotations(moves[:, 3:]) @ rotations
        return self._replace(positions_m=positions_m, rotations=rotations)

    def is_pushed_out(self, gradient: FloatArray) -> BoolArray:
        """Return which free coordinates are at a bound that a descent step would cross."""
        pulls = np.zeros(self.free.shape)
        pulls[self.free] = gradient
        pushed = np.zeros(self.free.shape, dtype=bool)
        pushed[:, :3] = (self.positions_m <= self.lower_m) & (pulls[:, :3] > 0.0)
        pushed[:, :3] |= (self.positions_m >= self.upper_m) & (pulls[:, :3] < 0.0)
        return pushed[self.free]


class Fit(NamedTuple):
    """
    The result of a fit.

    Parameters
    ----------
    bodies : Bodies
        The fitted poses.
    cost : float
        Sum of the squared residuals, in half widths; robust terms cost less.
    columns : numpy.ndarray of int, shape (n, 6)
        The row of each coordinate in `matrix`, or `LEFT_OUT`.
    matrix : numpy.ndarray, shape (k, k)
        The normal equations at the result: products of the derivatives of the residuals.

    """

    bodies: Bodies
    cost: float
    columns: IntArray
    matrix: FloatArray


def fit_terms(terms: Terms, start: Bodies, *, robust: bool = False) -> Fit:
    """Minimize the sum of squared residuals from a start, within bounds."""
    columns = np.full(start.free.shape, LEFT_OUT, dtype=np.int64)
    columns[start.free] = np.arange(size := int(start.free.sum()))

    best, damping = start, FIRST_DAMPING
    cost, matrix, vector = _equations(terms, start, columns, size, robust)
    for _ in range(MOST_STEPS if size else 0):
        held = best.is_pushed_out(vector)
        # A coordinate without terms gets a diagonal too, and does not move.
        diagonal = np.diag(matrix)
        damped = matrix + np.diag(damping * diagonal + 1e-12 * max(1e-288, diagonal.max()))
        damped[held], damped[:, held] = 0.0, 0.0
        damped[held, held] = 1.0
        try:
            step = np.linalg.solve(damped, np.where(held, 0.0, -vector))
        except np.linalg.LinAlgError:
            break
        trial = best.moved(np.asarray(step, dtype=float))
        trial_cost, *equations = _equations(terms, trial, columns, size, robust)
        if trial_cost < cost:
            gain, cost, best, (matrix, vector) = cost - trial_cost, trial_cost, trial, equations
            damping = max(0.1 * damping, LEAST_DAMPING)
            # The gain counts relative to a cost of at least one.
            if gain <= THOROUGH.least_gain * max(1.0, cost):
                break
        elif (damping := 10.0 * damping) > MOST_DAMPING:
            break
    return Fit(best, float(cost), columns, matrix)


def _small_rotations(turns_rad: FloatArray) -> FloatArray:
    """Return rotations about the axes of the fixed frame, shape (n, 3, 3) (Rodrigues)."""
    angles_rad = np.sqrt((turns_rad**2).sum(axis=1))[:, None, None]
    cross = turns_rad @ VECTOR_PRODUCT
    cross = cross.reshape(-1, 3, 3) / np.maximum(angles_rad, 1e-300)
    turned = np.sin(angles_rad) * cross + (1.0 - np.cos(angles_rad)) * (cross @ cross)
    return np.asarray(np.eye(3) + turned)


def equations_at(terms: Terms, fit: Fit, *, robust: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations (matrix and vector) of other terms at the result of a fit."""
    return _equations(terms, fit.bodies, fit.columns, len(fit.matrix), robust)[1:]


def _equations(
    terms: Terms, bodies: Bodies, columns: IntArray, size: int, robust: bool
) -> tuple[float, FloatArray, FloatArray]:
    """Return the cost and the normal equations (matrix and vector) of terms at some poses."""
    matrix, vector = np.empty((size, size)), np.empty(size)
    placed = bodies.positions_m, bodies.rotations, columns
    return normal_equations(*terms, robust, *placed, matrix, vector), matrix, vector


def _ends_of(terms: Terms, bodies: Bodies) -> FloatArray:
    """Return the places of both ends of terms, shape (m, 2, 3)."""
    arms_m = np.einsum('mbij,mbj->mbi', bodies.rotations[terms.bodies], terms.arms_m)
    return np.asarray(bodies.positions_m[terms.bodies] + arms_m)


def lines_of(terms: Terms, bodies: Bodies) -> tuple[FloatArray, FloatArray]:
    """Return the lengths (m,) and directions (m, 3) of the lines between the ends of terms."""
    lines_m = np.diff(_ends_of(terms, bodies), axis=1)[:, 0]
    lengths_m = np.linalg.norm(lines_m, axis=1)
    return lengths_m, lines_m / np.maximum(lengths_m, SHORTEST_M)[:, None]


def residuals_of(terms: Terms, fit: Fit) -> FloatArray:
    """
    Return the residuals of terms in the plane, in half widths; zero for a `PLACE`.

    Fitted ranges shorter than measured, and rays to the right of the measured ones, are negative.
    """
    rotations = fit.bodies.rotations[terms.bodies]
    lengths_m, rays = lines_of(terms, fit.bodies)
    sights = np.einsum('mij,mj->mi', rotations[:, 0], terms.values)
    to_left = sights[:, 0] * rays[:, 1] > sights[:, 1] * rays[:, 0]
    to_fixed_m = terms.values[:, :2] - _ends_of(terms, fit.bodies)[:, 0, :2]
    off = {
        RANGE: lengths_m - terms.values[:, 0],
        RAY: np.where(to_left, 1.0, -1.0) * np.linalg.norm(rays - sights, axis=1),
        PLACE: np.zeros(len(lengths_m)),
        STEP: lengths_m,
        TURN: np.linalg.norm(rotations[:, 1, :, 0] - sights, axis=1),
        DIFFERENCE: lengths_m - np.linalg.norm(to_fixed_m, axis=1) - terms.values[:, 2],
    }
    return terms.weights * np.choose(terms.kinds, [off[kind] for kind in sorted(off)])
