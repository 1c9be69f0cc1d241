# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which points of a fleet are rigid together, and what measurement would join two pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from dg_localization.solver.decompose.joints import Joint, JointKind
from dg_localization.solver.result import Piece, Result

MOST_REMEDIES = 8
"""How many measurements are proposed at most."""


@dataclass(frozen=True)
class Rigidity:
    """
    What holds a fleet together, and what is missing.

    Parameters
    ----------
    pieces : tuple of tuple of str
        The points of each part that can only move as a whole.
    remedies : tuple of str
        Measurements that would join two of them, as short sentences; at most `MOST_REMEDIES`.

    """

    pieces: tuple[tuple[str, ...], ...] = ()
    remedies: tuple[str, ...] = ()

    def __add__(self, other: Rigidity) -> Rigidity:
        """Return the rigidity of two parts of a fleet that nothing joins."""
        remedies = self.remedies + other.remedies
        return Rigidity(self.pieces + other.pieces, remedies[:MOST_REMEDIES])


NOT_RIGID = Rigidity()


def rigidity_of(names: Sequence[str], result: Result, dimension: int) -> Rigidity:
    """
    Return what the answer of the solver says about connected points.

    Parameters
    ----------
    names : sequence of str
        The points of the problem.
    result : Result
    dimension : int

    Returns
    -------
    Rigidity

    """
    pieces = tuple(
        tuple(names[point] for point in piece.points)
        for piece in result.pieces
        if not any(hypothesis.flexible for hypothesis in piece.hypotheses)
    )
    remedies: list[str] = []
    # What is free to turn first: it is worse than what has two places.
    for joint in sorted(result.joints, key=lambda joint: joint.kind is JointKind.REFLECTION):
        for number in joint.pieces[1:]:
            if len(remedies) == MOST_REMEDIES:
                break
            pair = result.pieces[joint.pieces[0]], result.pieces[number]
            remedies += _Joined(names, joint, pair, result, dimension).remedies()
    return Rigidity(pieces, tuple(remedies))


def missing_ranges(n_first: int, n_second: int, n_shared: int, dimension: int) -> int:
    """
    Return how many ranges between two rigid pieces are missing, so that they cannot move.

    Parameters
    ----------
    n_first, n_second, n_shared : int
        The numbers of their points, and of those that they share.
    dimension : int

    Returns
    -------
    int
        With so many there are finitely many placements of one against the other.

    """
    n_all = n_first + n_second - n_shared
    apart = _freedoms(n_first, dimension) + _freedoms(n_second, dimension)
    return apart - _freedoms(n_shared, dimension) - _freedoms(n_all, dimension)


def _freedoms(n_points: int, dimension: int) -> int:
    """Return the number of coordinates of a rigid set of points."""
    n_spanning = min(n_points, dimension)
    return n_spanning * dimension - n_spanning * (n_spanning - 1) // 2


@dataclass(frozen=True)
class _Joined:
    """Two pieces and the joint between them."""

    names: Sequence[str]
    joint: Joint
    pieces: tuple[Piece, Piece]
    result: Result
    dimension: int

    def remedies(self) -> Iterator[str]:
        """Yield what would leave the joint no freedom, or one side only."""
        shared = ', '.join(self.names[point] for point in self.joint.points)
        if self.joint.kind is JointKind.REFLECTION:
            pair = self._best_pair(lambda first, second: first * second)
            if pair is not None and self._tells_apart(*pair):
                yield f'{self._range(*pair)} or bearings would decide the reflection in {shared}'
            return
        first, second = (len(piece.points) for piece in self.pieces)
        missing = missing_ranges(first, second, len(self.joint.points), self.dimension)
        pair = self._best_pair(min)
        if missing == 1 and pair is not None:
            yield f'{self._range(*pair)} would fix the hinge at {shared}'
        elif missing > 1:
            ends = ' and '.join(self._others(piece) for piece in self.pieces)
            yield f'{missing} ranges between {ends} would fix the joint at {shared}'

    def _range(self, first: int, second: int) -> str:
        return f'range {self.names[first]} - {self.names[second]}'

    def _others(self, piece: Piece) -> str:
        """Return the names of the points of a piece that the other does not have."""
        return ', '.join(self.names[p] for p in piece.points if p not in self.joint.points)

    def _best_pair(self, merit: Callable[[float, float], float]) -> tuple[int, int] | None:
        """Return the pair across the joint with the greatest merit of the distances from it."""
        first, second = (_distances_m(piece, self.joint.points) for piece in self.pieces)
        pairs = {
            (a, b): (merit(first[a], second[b]), max(first[a], second[b]))
            for a, b in product(first, second)
        }
        return max(pairs, key=lambda pair: pairs[pair]) if pairs else None

    def _tells_apart(self, first: int, second: int) -> bool:
        """Return whether some hypotheses have different distances of a pair."""
        lower = [hypothesis.lower[first, second] for hypothesis in self.result.hypotheses]
        upper = [hypothesis.upper[first, second] for hypothesis in self.result.hypotheses]
        return max(lower, default=0.0) > min(upper, default=0.0)


def _distances_m(piece: Piece, shared: tuple[int, ...]) -> dict[int, float]:
    """Return how far the points of a piece are from the point, line or plane that it shares."""
    rows = [piece.points.index(point) for point in shared]
    others = [row for row, point in enumerate(piece.points) if point not in shared]
    positions = next((h.positions for h in piece.hypotheses if h.positions is not None), None)
    if positions is None:
        return {piece.points[row]: 1.0 for row in others}
    arms = positions - positions[rows[0]]
    along = np.linalg.qr(arms[rows[1:]].T)[0]
    distances_m = np.linalg.norm(arms - arms @ along @ along.T, axis=1)
    return {piece.points[row]: float(distances_m[row]) for row in others}
