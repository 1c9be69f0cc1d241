# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What the widths are measured against: the exact hull of a pair, or its linearization.

Both start from a placement known to satisfy the data and stay in its connected component: a
placement in which a measured triangle has turned over belongs to another hypothesis.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog, minimize
from scipy.sparse import csr_array, vstack

from benchmarks.problems import FloatArray, Pair, squared_distances
from dg_localization import Problem

FEASIBLE = 1e-7
"""Violation of an interval, relative to the largest squared distance, that counts as none."""


def measured_pairs(problem: Problem) -> list[Pair]:
    """Return the pairs the data bound from above."""
    return [p for p in combinations(range(problem.n_points), 2) if np.isfinite(problem.upper[p])]


def unknown_pairs(problem: Problem) -> list[Pair]:
    """Return the pairs the data say nothing of."""
    return [p for p in combinations(range(problem.n_points), 2) if np.isinf(problem.upper[p])]


def _gradients(positions: FloatArray, pairs: Sequence[Pair]) -> FloatArray:
    """Return the derivatives of the squared distances of `pairs`, one row each."""
    first, second = np.array(pairs).T
    rows = np.arange(len(pairs))
    gradients = np.zeros((len(pairs), *positions.shape))
    difference = 2.0 * (positions[first] - positions[second])
    gradients[rows, first] = difference
    gradients[rows, second] = -difference
    return gradients.reshape(len(pairs), -1)


def _simplices(problem: Problem) -> NDArray[np.int64]:
    """Return the sets of q + 1 points of which all pairs are measured."""
    measured = np.isfinite(problem.upper)
    size = problem.dimension + 1
    return np.array(
        [
            points
            for points in combinations(range(problem.n_points), size)
            if all(measured[pair] for pair in combinations(points, 2))
        ],
        dtype=np.int64,
    ).reshape(-1, size)


def chiralities(positions: FloatArray, simplices: NDArray[np.int64]) -> FloatArray:
    """Return the sign of det[p2 - p1, ..., p(q+1) - p1] of each simplex."""
    corners = positions[simplices]
    return np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1]))


def linearized_hull(problem: Problem, placement: FloatArray, pairs: Sequence[Pair]) -> FloatArray:
    """
    Bound squared distances to first order about a placement, by linear programs.

    Parameters
    ----------
    problem : Problem
        The data; sides are not used.
    placement : ndarray, shape (n, q)
        A placement that satisfies them, in m.
    pairs : sequence of (int, int)
        The pairs to bound.

    Returns
    -------
    ndarray, shape (k, 2)
        Lower and upper bound of each pair in m^2.

    """
    distances = squared_distances(placement)
    measured = measured_pairs(problem)
    rigidity = csr_array(_gradients(placement, measured))
    low = np.array([problem.lower[pair] - distances[pair] for pair in measured])
    high = np.array([problem.upper[pair] - distances[pair] for pair in measured])
    matrix = vstack([rigidity, -rigidity], format='csr')
    right = np.concatenate([high, -low])
    bounds = np.empty((len(pairs), 2))
    for row, (pair, gradient) in enumerate(zip(pairs, _gradients(placement, pairs), strict=True)):
        for column, sign in enumerate((1.0, -1.0)):
            program = linprog(sign * gradient, matrix, right, bounds=(None, None), method='highs')
            change = sign * program.fun if program.status == 0 else -sign * np.inf
            bounds[row, column] = distances[pair] + change
    return bounds


def exact_hull(
    problem: Problem, placement: FloatArray, pairs: Sequence[Pair], starts: int = 5, seed: int = 0
) -> FloatArray:
    """
    Bound squared distances over the component of a placement, by nonlinear programs.

    Parameters
    ----------
    problem : Problem
        The data; sides are not used, a turned triangle is refused instead.
    placement : ndarray, shape (n, q)
        A placement that satisfies them, in m.
    pairs : sequence of (int, int)
        The pairs to bound.
    starts : int, optional
        From how many placements each program is started.
    seed : int, optional
        Of the starts.

    Returns
    -------
    ndarray, shape (k, 2)
        Lower and upper bound of each pair in m^2. Every value is attained by a placement that
        satisfies the data to `FEASIBLE`, so the true hull is never narrower; that it is no wider
        rests on the starts having found the global extremes.

    """
    measured = measured_pairs(problem)
    low = np.array([problem.lower[pair] for pair in measured])
    high = np.array([problem.upper[pair] for pair in measured])
    simplices = _simplices(problem)
    signs = chiralities(placement, simplices)
    scale = high.max()
    random = np.random.default_rng(seed)
    spread = 0.5 * np.sqrt(high).max() * np.max((high - low) / (high + low))
    shape = placement.shape

    def slack(flat: FloatArray) -> FloatArray:
        values = squared_distances(flat.reshape(shape))[tuple(np.array(measured).T)]
        return np.concatenate([values - low, high - values]) / scale

    def slack_gradient(flat: FloatArray) -> FloatArray:
        rigidity = _gradients(flat.reshape(shape), measured) / scale
        return np.vstack([rigidity, -rigidity])

    def extreme(pair: Pair, sign: float) -> float:
        def objective(flat: FloatArray) -> tuple[float, FloatArray]:
            positions = flat.reshape(shape)
            value = squared_distances(positions)[pair]
            return sign * value / scale, sign * _gradients(positions, [pair])[0] / scale

        best = squared_distances(placement)[pair]
        for start in range(starts):
            shift = spread * random.standard_normal(shape) if start else 0.0
            found = minimize(
                objective,
                (placement + shift).ravel(),
                jac=True,
                method='SLSQP',
                constraints={'type': 'ineq', 'fun': slack, 'jac': slack_gradient},
                options={'maxiter': 200, 'ftol': 1e-13},
            ).x
            same = np.array_equal(chiralities(found.reshape(shape), simplices), signs)
            value = squared_distances(found.reshape(shape))[pair]
            if same and slack(found).min() > -FEASIBLE and sign * value < sign * best:
                best = value
        return best

    return np.array([[extreme(pair, 1.0), extreme(pair, -1.0)] for pair in pairs])
