# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Checks of the bounds, pairs and points of a problem."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.interval.intake import lower_bounds, upper_bounds
from dg_localization.solver.pair_bounds import IntArray, PairBounds

Matrix = NDArray[np.float64]


class InvalidProblemError(ValueError):
    """A malformed problem; contradictory measurements are a verdict, not an error."""


def check_bounds(
    lower: ArrayLike, upper: ArrayLike, names: tuple[str, str] = ('lower', 'upper')
) -> tuple[Matrix, Matrix]:
    """
    Return bounds of squared distances in double precision, rounded outward.

    Parameters
    ----------
    lower, upper : array_like, shape (n, n)
        Real numbers of any kind.
    names : tuple of str, optional
        Their names in messages.

    Returns
    -------
    tuple of ndarray, shapes (n, n)
        New arrays.

    Raises
    ------
    InvalidProblemError
        If the bounds are not real numbers or not square.

    """
    bounds = _rounded_outward(lower, upper, names)
    for name, matrix in zip(names, bounds, strict=True):
        if matrix.ndim != 2 or matrix.shape[0] != matrix.shape[1]:
            raise InvalidProblemError(
                f'{name} has shape {matrix.shape}, a square matrix is needed'
            )
    return bounds


def _rounded_outward(
    lower: ArrayLike, upper: ArrayLike, names: tuple[str, str]
) -> tuple[Matrix, Matrix]:
    """Return bounds in double precision, as new arrays."""
    arrays = []
    for name, values, rounded in zip(
        names, (lower, upper), (lower_bounds, upper_bounds), strict=True
    ):
        try:
            arrays.append(rounded(values))
        except ValueError as error:
            raise InvalidProblemError(f'{name} {error}') from None
    return arrays[0], arrays[1]


def _checked_indices(name: str, values: ArrayLike, n_points: int) -> IntArray:
    """Return the points of pairs as integers."""
    if isinstance(values, np.ma.MaskedArray):
        raise InvalidProblemError(f'{name} is a masked array; leave unknown pairs out')
    try:
        points = np.asarray(values)
    except ValueError:
        raise InvalidProblemError(f'{name} is a list of lists of different lengths') from None
    if points.ndim != 1:
        raise InvalidProblemError(f'{name} has shape {points.shape}, one index a pair is needed')
    if points.size == 0:
        return np.empty(0, dtype=np.int64)
    if points.dtype.kind not in 'iu':
        raise InvalidProblemError(
            f'{name} has entries of type {points.dtype}, integers are needed'
        )
    wrong = np.flatnonzero((points < 0) | (points >= n_points))
    if len(wrong):
        x = wrong[0]
        raise InvalidProblemError(f'{name}[{x}] = {points[x]} is not in 0..{n_points - 1}')
    return points.astype(np.int64)


def checked_pairs(
    n_points: int, i: ArrayLike, j: ArrayLike, lower: ArrayLike, upper: ArrayLike
) -> PairBounds:
    """Return the bounds of listed pairs, each pair once."""
    first, second = (_checked_indices(*named, n_points) for named in (('i', i), ('j', j)))
    bounds = _rounded_outward(lower, upper, ('lower', 'upper'))
    for name, values in zip(('j', 'lower', 'upper'), (second, *bounds), strict=True):
        if values.shape != first.shape:
            raise InvalidProblemError(
                f'{name} has shape {values.shape}, i has shape {first.shape}: '
                'they must have one entry a pair'
            )
    low, high = bounds
    for wrong, text in (
        (first == second, 'i[{x}] = j[{x}] = {i}: a pair needs two points'),
        (np.isnan(low), 'lower[{x}] = {low} m^2 of pair ({i}, {j}) is NaN'),
        (np.isnan(high), 'upper[{x}] = {high} m^2 of pair ({i}, {j}) is NaN'),
        (low < 0.0, 'lower[{x}] = {low} m^2 of pair ({i}, {j}) is negative'),
        (high < 0.0, 'upper[{x}] = {high} m^2 of pair ({i}, {j}) is negative'),
        (np.isinf(low), 'lower[{x}] of pair ({i}, {j}) is infinite'),
        (
            low > high,
            'lower[{x}] = {low} m^2 of pair ({i}, {j}) exceeds upper[{x}] = {high} m^2',
        ),
    ):
        if wrong.any():
            x = int(np.argmax(wrong))
            named = {'i': first[x], 'j': second[x], 'low': low[x], 'high': high[x]}
            raise InvalidProblemError(text.format(x=x, **named))
    keys = np.minimum(first, second) * n_points + np.maximum(first, second)
    order = np.argsort(keys, kind='stable')
    again = np.flatnonzero(np.diff(keys[order]) == 0)
    if len(again):
        x, y = order[again[0]], order[again[0] + 1]
        raise InvalidProblemError(
            f'pair ({first[x]}, {second[x]}) is given twice, as entries {x} and {y}; '
            'give each pair once, with the bounds that all its readings have in common'
        )
    is_known = (low[order] > 0.0) | np.isfinite(high[order])
    order = order[is_known]
    return PairBounds(n_points, keys[order], low[order], high[order])


def is_whole(value: object) -> TypeGuard[int]:
    """Return whether a value is an integer of Python or NumPy, not a truth value."""
    return type(value) is int or (isinstance(value, Integral) and not isinstance(value, bool))


def checked_points(what: object, points: object, count: int, n_points: int) -> tuple[int, ...]:
    """Return the points of a constraint as integers of Python."""
    if not isinstance(points, Iterable):
        raise InvalidProblemError(f'{what}: {points!r} are no points')
    listed = tuple(points)
    if len(listed) != count:
        raise InvalidProblemError(f'{what}: {count} points are needed in this dimension')
    return different_points(what, listed, n_points)


def different_points(what: object, points: tuple[Any, ...], n_points: int) -> tuple[int, ...]:
    """Return points as Python integers; refuse repeated and unknown ones."""
    for point in points:
        if not is_whole(point):
            raise InvalidProblemError(f'{what}: point {point!r} is not an integer')
        if not 0 <= int(point) < n_points:
            raise InvalidProblemError(f'{what}: point {point} is not in 0..{n_points - 1}')
    checked = tuple(int(point) for point in points)
    if len(set(checked)) < len(checked):
        raise InvalidProblemError(f'{what}: points {checked} are not all different')
    return checked


def check_matrices(lower: Matrix, upper: Matrix) -> None:
    """Refuse matrices that are not bounds of squared distances."""
    if lower.shape != upper.shape:
        raise InvalidProblemError(f'lower is {lower.shape}, upper is {upper.shape}')
    if len(lower) == 0:
        raise InvalidProblemError('there are no points')
    for name, matrix in (('lower', lower), ('upper', upper)):
        for wrong, what in (
            (np.isnan(matrix), 'is NaN'),
            (matrix < 0.0, 'is negative'),
            (matrix != matrix.T, 'differs from its transpose'),
            (np.diag(np.diag(matrix) != 0.0), 'must be 0: it is on the diagonal'),
        ):
            if wrong.any():
                i, j = np.argwhere(wrong)[0]
                raise InvalidProblemError(f'{name}[{i},{j}] = {matrix[i, j]} m^2 {what}')
    if np.isinf(lower).any():
        i, j = np.argwhere(np.isinf(lower))[0]
        raise InvalidProblemError(f'lower[{i},{j}] is infinite')
    if (lower > upper).any():
        i, j = np.argwhere(lower > upper)[0]
        raise InvalidProblemError(
            f'lower[{i},{j}] = {lower[i, j]} m^2 exceeds upper[{i},{j}] = {upper[i, j]} m^2'
        )
