# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which points of a fleet are rigid together, and what measurement would join two pieces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dg_localization.solver.decompose.rigid_components import rigid_components
from dg_localization.solver.result import Joint, JointKind, Piece, Result

FloatArray = NDArray[np.float64]

MOST_REMEDIES = 8
"""How many measurements are proposed at most."""


@dataclass(frozen=True)
class Remedy:
    """
    What would join two pieces.

    Parameters
    ----------
    text : str
        What to measure, as a short sentence.
    face, pair : tuple of str
        Where a piece can be reflected: the points that the two share, and one more of each. Empty
        at other joints.

    """

    text: str
    face: tuple[str, ...] = ()
    pair: tuple[str, ...] = ()

    def is_open(self, names: Sequence[str], places_m: Iterable[FloatArray]) -> bool:
        """
        Return whether some placements still need it.

        A reflection is decided where all of them have the pair on the same side of the face, or
        all of them on opposite sides.
        """
        if not self.face or not {*self.face, *self.pair} <= {*names}:
            return True
        face = [names.index(name) for name in self.face]
        first, second = (names.index(name) for name in self.pair)
        sides = {_side(places, face, first, second) for places in places_m}
        return len(sides - {None}) != 1


@dataclass(frozen=True)
class Rigidity:
    """
    What holds a fleet together, and what is missing.

    Parameters
    ----------
    pieces : tuple of tuple of str
        The points of each part that can only move as a whole.
    remedies : tuple of Remedy
        What would join two of them; at most `MOST_REMEDIES`.

    """

    pieces: tuple[tuple[str, ...], ...] = ()
    remedies: tuple[Remedy, ...] = ()

    def __add__(self, other: Rigidity) -> Rigidity:
        """Return the rigidity of two parts of a fleet that nothing joins."""
        remedies = self.remedies + other.remedies
        return Rigidity(self.pieces + other.pieces, remedies[:MOST_REMEDIES])


NOT_RIGID = Rigidity()


def rigidity_of(
    names: Sequence[str],
    result: Result,
    dimension: int,
    all_listed: bool,
    measured: NDArray[np.bool_] | None = None,
) -> Rigidity:
    """Return what the answer of the solver says about connected points."""
    held = [True] * len(result.pieces)
    if measured is not None:
        pairs = np.ascontiguousarray(np.argwhere(np.triu(measured, 1)))
        bodies = [{*body} for body in rigid_components(len(names), pairs, dimension)]
        held = [any(body.issuperset(piece.points) for body in bodies) for piece in result.pieces]
    pieces = tuple(
        tuple(names[point] for point in piece.points)
        for piece, is_held in zip(result.pieces, held, strict=True)
        if is_held and not any(hypothesis.flexible for hypothesis in piece.hypotheses)
    )
    remedies: list[Remedy] = []
    # What is free to turn first: it is worse than what has two places.
    for joint in sorted(result.joints, key=lambda joint: joint.kind is JointKind.REFLECTION):
        for number in joint.pieces[1:]:
            if len(remedies) == MOST_REMEDIES:
                break
            if not (held[joint.pieces[0]] and held[number]):
                continue
            pair = result.pieces[joint.pieces[0]], result.pieces[number]
            remedies += _Joined(names, joint, pair, result, dimension, all_listed).remedies()
    return Rigidity(pieces, tuple(remedies))


def missing_ranges(n_first: int, n_second: int, n_shared: int, dimension: int) -> int:
    """Return how many ranges between two rigid pieces are missing, so that they cannot move."""
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
    all_listed: bool

    def remedies(self) -> Iterator[Remedy]:
        """Yield what would leave the joint no freedom, or one side only."""
        face = tuple(self.names[point] for point in self.joint.points)
        shared = ', '.join(face)
        if self.joint.kind is JointKind.REFLECTION:
            pair = self._best_pair(lambda first, second: first * second)
            if pair is not None and self.all_listed and self._tells_apart(*pair):
                text = f'{self._range(*pair)} or bearings would decide the reflection in {shared}'
                yield Remedy(text, face, tuple(self.names[point] for point in pair))
            return
        first, second = (len(piece.points) for piece in self.pieces)
        missing = missing_ranges(first, second, len(self.joint.points), self.dimension)
        pair = self._best_pair(min)
        if missing == 1 and pair is not None:
            yield Remedy(f'{self._range(*pair)} would fix the hinge at {shared}')
        elif missing > 1:
            ends = ' and '.join(self._others(piece) for piece in self.pieces)
            yield Remedy(f'{missing} ranges between {ends} would fix the joint at {shared}')

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
        """
        Return whether the distance of a pair tells on which side of the joint the two are.

        No hypothesis with both on the same side has a distance that one with the two on opposite
        sides may have, too: other pieces can be reflected as well, and change it.
        """
        bounds: dict[float | None, list[tuple[float, float]]] = {-1.0: [], 1.0: []}
        for hypothesis in self.result.hypotheses:
            side = None
            if hypothesis.positions is not None:
                side = _side(hypothesis.positions, self.joint.points, first, second)
            if side not in bounds:
                return False
            bounds[side].append(hypothesis.bounds_of_pair(first, second))
        opposite, same = (np.reshape(found, (-1, 2)) for found in bounds.values())
        apart = (opposite[:, None, 1] < same[:, 0]) | (same[:, 1] < opposite[:, None, 0])
        return bool(apart.size and apart.all())


def _side(positions: FloatArray, face: Sequence[int], first: int, second: int) -> float | None:
    """Return 1 where two points are on the same side of a face, else -1; None if not known."""
    arms = positions - positions[face[0]]
    corners = arms[[(*face[1:], point) for point in (first, second)]]
    if not np.isfinite(corners).all():
        return None
    return float(np.prod(np.sign(np.linalg.det(corners))))


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
