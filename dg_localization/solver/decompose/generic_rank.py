# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Rigidity at generic coordinates, in any dimension: exact elimination modulo a large prime.

The rank at random coordinates is the generic rank, but for a chance of about one in the prime;
modulo a prime it never exceeds it, so that rigidity is certain. A random motion that keeps
all measured distances keeps, with the same certainty, only those that are implied by them.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import IntArray

PRIME = 2**31 - 1
"""Products of two residues fit into 64 bits."""

SEED = 1
"""The coordinates are random, and the same in every run."""


@kernel
def _inverse(value: int) -> int:
    """Return the inverse modulo the prime (Fermat)."""
    result = 1
    exponent = PRIME - 2
    while exponent:
        if exponent & 1:
            result = result * value % PRIME
        value = value * value % PRIME
        exponent >>= 1
    return result


@kernel
def _eliminate_some(
    positions: IntArray, pairs: IntArray, rows: IntArray, pivots: IntArray, rank: int
) -> int:
    """Go on with the elimination over some pairs; return the rank."""
    dimension = positions.shape[1]
    n_columns = rows.shape[1]
    for x in range(len(pairs)):
        if rank == len(rows) - 1:
            break
        row = rows[rank]
        row[:] = 0
        for axis in range(dimension):
            i, j = pairs[x, 0], pairs[x, 1]
            difference = (positions[i, axis] - positions[j, axis]) % PRIME
            row[i * dimension + axis] = difference
            row[j * dimension + axis] = (PRIME - difference) % PRIME
        for y in range(rank):
            factor = row[pivots[y]]
            if factor:
                for column in range(pivots[y], n_columns):
                    row[column] = (row[column] + (PRIME - factor) * rows[y, column]) % PRIME
        pivot = 0
        while pivot < n_columns and row[pivot] == 0:
            pivot += 1
        if pivot == n_columns:
            continue
        scale = _inverse(row[pivot])
        for column in range(pivot, n_columns):
            row[column] = row[column] * scale % PRIME
        # Sorted by pivot, one pass clears a row.
        place = rank
        while place > 0 and pivots[place - 1] > pivot:
            place -= 1
        new = row.copy()
        for y in range(rank, place, -1):
            rows[y] = rows[y - 1]
            pivots[y] = pivots[y - 1]
        rows[place] = new
        pivots[place] = pivot
        rank += 1
    return rank


def _eliminated(
    n_points: int, pairs: IntArray, dimension: int
) -> tuple[IntArray, IntArray, IntArray, int]:
    """Return random coordinates, the rows in echelon form, their pivots (ones), and the rank."""
    most = rigid_rank(n_points, dimension)
    positions = _random_residues((n_points, dimension), SEED)
    rows = np.empty((most + 1, n_points * dimension), dtype=np.int64)
    pivots = np.empty(most + 1, dtype=np.int64)
    rank = 0
    at_once = 1 + WORK_PER_LOOK // rows.size
    for first in range(0, len(pairs), at_once):
        some = pairs[first : first + at_once]
        rank = int(_eliminate_some(positions, some, rows, pivots, rank))
        look_after(len(some) * rows.size)
    return positions, rows, pivots, rank


def _random_residues(shape: tuple[int, ...], seed: int) -> IntArray:
    return np.random.default_rng(seed).integers(1, PRIME, size=shape)


def rigid_rank(n_points: int, dimension: int) -> int:
    """Return the rank of the rigidity matrix of so many rigid points in general position."""
    span = min(n_points - 1, dimension)
    return n_points * dimension - dimension - span * (2 * dimension - span - 1) // 2


def generic_rank(n_points: int, pairs: IntArray, dimension: int) -> int:
    """Return the generic rank of the rigidity matrix of some pairs."""
    return _eliminated(n_points, pairs, dimension)[-1]


@kernel
def _solve_back(rows: IntArray, pivots: IntArray, rank: int, motion: IntArray) -> None:
    """Choose the pivot entries of a motion such that every row vanishes on it."""
    for y in range(rank - 1, -1, -1):
        total = 0
        for column in range(pivots[y] + 1, rows.shape[1]):
            total = (total + rows[y, column] * motion[column]) % PRIME
        motion[pivots[y]] = (PRIME - total) % PRIME


@kernel
def _kept_distances(positions: IntArray, motion: IntArray) -> NDArray[np.bool_]:
    """Tell which distances a motion keeps."""
    n_points, dimension = positions.shape
    kept = np.ones((n_points, n_points), dtype=np.bool_)
    for i in range(n_points):
        for j in range(i + 1, n_points):
            total = 0
            for axis in range(dimension):
                across = (positions[i, axis] - positions[j, axis]) % PRIME
                speed = (motion[i * dimension + axis] - motion[j * dimension + axis]) % PRIME
                total = (total + across * speed) % PRIME
            kept[i, j] = kept[j, i] = total == 0
    return kept


def implied_pairs(n_points: int, pairs: IntArray, dimension: int) -> NDArray[np.bool_]:
    """Tell which distances the measured ones imply, generically and up to finitely many values."""
    positions, rows, pivots, rank = _eliminated(n_points, pairs, dimension)
    motion = _random_residues((n_points * dimension,), SEED + 1)
    _solve_back(rows, pivots, rank, motion)
    return np.asarray(_kept_distances(positions, motion))
