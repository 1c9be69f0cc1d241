# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rigid pieces of a fleet, and measurements that would join two of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.solver.decompose.rigid_components import rigid_components
from dg_localization.solver.result import Joint, JointKind, Piece, Result

FloatArray = NDArray[np.float64]

MOST_REMEDIES = 8
"""Most measurements that are proposed."""


class Remedy(NamedTuple):
    """
    A measurement that would join two pieces.

    Parameters
    ----------
    text : str
        The measurement, as a short sentence.
    face, pair : tuple of str
        At a reflection: the points that the two pieces share, and one more point of each. Empty
        at other joints.

    """

    text: str
    face: tuple[str, ...] = ()
    pair: tuple[str, ...] = ()

    def is_open(self, names: Sequence[str], places_m: Iterable[FloatArray]) -> bool:
        """
        Return whether the placements still leave the joint open.

        A reflection is decided if all placements have the pair on the same side of the face, or
        all have it on opposite sides.
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
    The rigid pieces of a fleet, and the measurements missing between them.

    Parameters
    ----------
    pieces : tuple of tuple of str
        The points of each part that can only move as a whole.
    remedies : tuple of Remedy
        Measurements that would join two pieces; at most `MOST_REMEDIES`.

    """

    pieces: tuple[tuple[str, ...], ...] = ()
    remedies: tuple[Remedy, ...] = ()

    def __add__(self, other: Rigidity) -> Rigidity:
        """Return the rigidity of two separate parts of a fleet."""
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
    """Return the rigidity of connected points by a result of the solver."""
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
    # Hinges come first: they are worse than reflections, which leave two places.
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
    """Return the number of further ranges that would make two rigid pieces one."""
    n_all = n_first + n_second - n_shared
    apart = _freedoms(n_first, dimension) + _freedoms(n_second, dimension)
    return apart - _freedoms(n_shared, dimension) - _freedoms(n_all, dimension)


def _freedoms(n_points: int, dimension: int) -> int:
    """Return the number of coordinates of a rigid set of points."""
    n_spanning = min(n_points, dimension)
    return n_spanning * dimension - n_spanning * (n_spanning - 1) // 2


class _Joined(NamedTuple):
    """Two pieces and the joint between them."""

    names: Sequence[str]
    joint: Joint
    pieces: tuple[Piece, Piece]
    result: Result
    dimension: int
    all_listed: bool

    def remedies(self) -> Iterator[Remedy]:
        """Yield measurements that would fix the joint or decide its reflection."""
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
        """Return the names of the points of a piece outside the joint."""
        return ', '.join(self.names[p] for p in piece.points if p not in self.joint.points)

    def _best_pair(self, merit: Callable[[float, float], float]) -> tuple[int, int] | None:
        """Return the pair across the joint whose distances from it have the greatest merit."""
        first, second = (_distances_m(piece, self.joint.points) for piece in self.pieces)

        def key(pair: tuple[int, int]) -> tuple[float, float]:
            apart_m = first[pair[0]], second[pair[1]]
            return merit(*apart_m), max(apart_m)

        return max(product(first, second), key=key, default=None)

    def _tells_apart(self, first: int, second: int) -> bool:
        """
        Return whether the distance of a pair decides the reflection at the joint.

        That is so if the distances of all hypotheses with both points on the same side differ from
        those with points on opposite sides. Reflections of other pieces change these distances.
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
    """Return 1 if two points are on the same side of a face, -1 if not, None if unknown."""
    arms = positions - positions[face[0]]
    corners = arms[[(*face[1:], point) for point in (first, second)]]
    if not np.isfinite(corners).all():
        return None
    return float(np.prod(np.sign(np.linalg.det(corners))))


def _distances_m(piece: Piece, shared: tuple[int, ...]) -> dict[int, float]:
    """Return the distances of the points of a piece from the shared point, line or plane."""
    rows = [piece.points.index(point) for point in shared]
    others = [row for row, point in enumerate(piece.points) if point not in shared]
    positions = next((h.positions for h in piece.hypotheses if h.positions is not None), None)
    if positions is None:
        return {piece.points[row]: 1.0 for row in others}
    arms = positions - positions[rows[0]]
    along = np.linalg.qr(arms[rows[1:]].T)[0]
    distances_m = np.linalg.norm(arms - arms @ along @ along.T, axis=1)
    return {piece.points[row]: float(distances_m[row]) for row in others}
