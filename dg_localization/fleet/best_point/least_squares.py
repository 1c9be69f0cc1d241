# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Least squares within bounds: a start, what may change, and what the fit makes of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.descent import descend
from dg_localization.fleet.best_point.normal_equations import LEFT_OUT, normal_equations
from dg_localization.fleet.best_point.terms import Terms

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class Bodies:
    """
    Where bodies are, and where they may be.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, 3)
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to fixed frame.
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the positions; they hold `positions_m`.
    free : numpy.ndarray of bool, shape (n, 6)
        Which coordinates, and which rotations about the axes of the fixed frame, may change.

    """

    positions_m: FloatArray
    rotations: FloatArray
    lower_m: FloatArray
    upper_m: FloatArray
    free: BoolArray


@dataclass(frozen=True)
class Fit:
    """
    The result of a fit.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, 3)
    rotations : numpy.ndarray, shape (n, 3, 3)
    cost : float
        Sum of the squared residuals, in half widths; less for those that are robust.
    columns : numpy.ndarray of int, shape (n, 6)
        The row of each coordinate in `matrix`, or `LEFT_OUT`.
    matrix : numpy.ndarray, shape (k, k)
        The normal equations at the result: products of the derivatives of the residuals.

    """

    positions_m: FloatArray
    rotations: FloatArray
    cost: float
    columns: IntArray
    matrix: FloatArray


def fit_terms(terms: Terms, start: Bodies, *, robust: bool = False) -> Fit:
    """Lower the sum of squared residuals from a start, within bounds."""
    columns = np.full(start.free.shape, LEFT_OUT, dtype=np.int64)
    size = int(start.free.sum())
    columns[start.free] = np.arange(size)
    placed = start.positions_m, start.rotations, start.lower_m, start.upper_m
    cost, positions_m, rotations, matrix = descend(*terms, robust, *placed, columns, size)
    return Fit(positions_m, rotations, float(cost), columns, matrix)


def matrix_at(terms: Terms, fit: Fit) -> FloatArray:
    """Return the matrix of the normal equations of other terms at the result of a fit."""
    matrix, vector = np.empty_like(fit.matrix), np.empty(len(fit.matrix))
    placed = fit.positions_m, fit.rotations, fit.columns
    normal_equations(*terms, True, *placed, matrix, vector)
    return matrix
