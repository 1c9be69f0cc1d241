# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One placement of the whole fleet from one placement of every piece.

Pieces are laid against each other by their shared points, mirrored as a combination says. What a
joint leaves open is chosen such that the pieces keep apart. Nothing is proved here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.problem import Side, SideConstraint
from dg_localization.solver.result import Joint

MOST_TURNS = 6
"""How many ways to turn a piece about a joint are tried."""


def _orthogonal(rng: np.random.Generator, count: int, dimension: int) -> FloatArray:
    """Return random rotations or reflections, shape (count, q, q)."""
    matrices, upper = np.linalg.qr(rng.standard_normal((count, dimension, dimension)))
    return np.asarray(matrices * np.sign(np.diagonal(upper, axis1=1, axis2=2))[:, None])


def _aligned(
    local: FloatArray, shared: FloatArray, target: FloatArray, turns: FloatArray, signs: FloatArray
) -> FloatArray:
    """Lay points that are turned against others by some that they share, once for every turn."""
    turned = shared @ turns
    centers, target_center = turned.mean(axis=1, keepdims=True), target.mean(axis=0)
    left, _, right = np.linalg.svd((turned - centers).swapaxes(1, 2) @ (target - target_center))
    left[..., -1] *= (signs * np.sign(np.linalg.det(left @ right @ turns)))[:, None]
    return np.asarray((local @ turns - centers) @ left @ right + target_center)


def _volume(face: FloatArray, apex: FloatArray) -> float:
    """Return the signed volume of a simplex."""
    return float(np.linalg.det(np.vstack([face[1:], apex]) - face[0]))


class Layout:
    """
    Lays pieces against each other.

    `positions` are those of the points that are placed, in a scale of their own; `has_chosen`
    tells whether anything was open, which is chosen anew for every seed.

    """

    def __init__(
        self,
        pieces: Sequence[tuple[Points, FloatArray]],
        joints: Sequence[Joint],
        sides: Sequence[SideConstraint],
        dimension: int,
        seed: int,
    ) -> None:
        # Squares of coordinates must not overflow; a power of two changes no digit.
        finite = [np.nan_to_num(local, posinf=0.0, neginf=0.0) for _, local in pieces]
        _, exponent = np.frexp(max(float(np.abs(local).max()) for local in finite))
        self._half = int(exponent) // 2
        self._pieces = [
            (points, self._scaled(local, -1))
            for (points, _), local in zip(pieces, finite, strict=True)
        ]
        self._joints_of: list[list[Joint]] = [[] for _ in pieces]
        for joint in joints:
            for number in joint.pieces:
                self._joints_of[number].append(joint)
        self._sides = sides
        self._sides_at: dict[int, list[int]] = {}
        for number, side in enumerate(sides):
            for point in (*side.face, side.first, side.second):
                self._sides_at.setdefault(point, []).append(number)
        self._dimension = dimension
        self._rng = np.random.default_rng(seed)
        n_points = 1 + max(max(points) for points, _ in pieces)
        self.positions = np.full((n_points, dimension), np.nan)
        self.has_chosen = False

    def _scaled(self, values: FloatArray, sign: int) -> FloatArray:
        """Scale to the size of one, or back, in two steps that cannot overflow."""
        half = sign * self._half
        return np.ldexp(np.ldexp(values, half), half)

    def place(self, least_m: float) -> FloatArray:
        """Place all pieces, those that nothing joins farther apart than `least_m`."""
        clearance = 1.0 + 2.0 * float(self._scaled(np.array(least_m), -1))
        done = [False] * len(self._pieces)
        edge = 0.0
        for root, (points, local) in enumerate(self._pieces):
            if done[root]:
                continue
            placed = np.isfinite(self.positions[:, 0])
            self.positions[list(points)] = local
            done[root] = True
            queue = deque([root])
            while queue:
                number = queue.popleft()
                for joint in self._joints_of[number]:
                    for other in joint.pieces:
                        if not done[other]:
                            self._add(joint, other)
                            done[other] = True
                            queue.append(other)
            new = np.isfinite(self.positions[:, 0]) & ~placed
            if placed.any():
                self.positions[new, 0] += edge - self.positions[new, 0].min()
            edge = float(self.positions[new, 0].max()) + clearance
        return self._scaled(self.positions, 1)

    def _add(self, joint: Joint, number: int) -> None:
        """Lay a piece against those that are placed, on the sides that are known."""
        points, local = self._pieces[number]
        members, face = np.array(points), list(joint.points)
        is_new = ~np.isfinite(self.positions[members, 0])
        if not is_new.any():
            return
        is_face = len(face) == self._dimension
        n_turns = 1 if is_face else MOST_TURNS // 2
        if is_face:
            turns, signs = np.repeat(np.eye(self._dimension)[None], 2, axis=0), np.array([1, -1])
        else:
            turns = _orthogonal(self._rng, MOST_TURNS, self._dimension)
            signs = np.repeat([1, -1], n_turns)
        shared = local[np.searchsorted(members, face)]
        candidates = _aligned(local[is_new], shared, self.positions[face], turns, signs)
        old = self.positions[np.isfinite(self.positions[:, 0])]
        ranks = []
        for candidate in candidates:
            self.positions[members[is_new]] = candidate
            apart = np.min(((candidate[:, None] - old) ** 2).sum(axis=-1))
            ranks.append(
                (-self._n_violated(members[is_new]), self._rng.random() if is_face else apart)
            )
        best = max(range(len(ranks)), key=ranks.__getitem__)
        self.has_chosen |= not is_face or ranks[0][0] == ranks[1][0]
        self.positions[members[is_new]] = candidates[best]

    def _n_violated(self, new: IntArray) -> int:
        """Return how many of the known sides that name new points are not kept."""
        named = {number for point in new.tolist() for number in self._sides_at.get(point, ())}
        count = 0
        for number in named:
            side = self._sides[number]
            corners = self.positions[[*side.face, side.first, side.second]]
            if np.isfinite(corners[:, 0]).all():
                face, first, second = corners[:-2], corners[-2], corners[-1]
                is_opposite = _volume(face, first) * _volume(face, second) < 0.0
                count += is_opposite != (side.side is Side.OPPOSITE)
        return count
