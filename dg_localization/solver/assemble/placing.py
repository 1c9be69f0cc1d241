# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
One placement of the whole fleet from one placement of every piece.

Pieces are laid against each other by their shared points, mirrored as a combination says. What a
joint leaves open is chosen such that the pieces keep apart. Nothing is proved here.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence

import numpy as np

from dg_localization.solver.box import FloatArray
from dg_localization.solver.decompose.joints import Joint
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.problem import Side, SideConstraint

MOST_TURNS = 6
"""How many ways to turn a piece about a joint are tried."""


def _orthogonal(rng: np.random.Generator, count: int, dimension: int) -> FloatArray:
    """Return random rotations or reflections, shape (count, q, q)."""
    matrices, upper = np.linalg.qr(rng.standard_normal((count, dimension, dimension)))
    return np.asarray(matrices * np.sign(np.diagonal(upper, axis1=1, axis2=2))[:, None])


def _aligned(
    local: FloatArray, shared: FloatArray, target: FloatArray, turns: FloatArray, signs: FloatArray
) -> FloatArray:
    """
    Lay points that are turned against others by some that they share, once for every turn.

    Parameters
    ----------
    local : ndarray, shape (m, q)
        The points of a piece.
    shared, target : ndarray, shape (s, q)
        Some of them, and where these are to lie.
    turns : ndarray, shape (k, q, q)
        How to turn the piece first.
    signs : ndarray, shape (k,)
        1 to keep its handedness in all, -1 to mirror it.

    Returns
    -------
    ndarray, shape (k, m, q)
        The points.

    """
    turned = shared @ turns
    centers, target_center = turned.mean(axis=1, keepdims=True), target.mean(axis=0)
    left, _, right = np.linalg.svd((turned - centers).swapaxes(1, 2) @ (target - target_center))
    left[..., -1] *= (signs * np.sign(np.linalg.det(left @ right @ turns)))[:, None]
    return np.asarray((local @ turns - centers) @ left @ right + target_center)


def _volume(face: FloatArray, apex: FloatArray) -> float:
    """Return the signed volume of a simplex."""
    return float(np.linalg.det(np.vstack([face[1:], apex]) - face[0]))


class Placer:
    """
    Lays pieces against each other.

    Parameters
    ----------
    pieces : sequence of (tuple of int, ndarray)
        The points of each piece and a placement of them in m.
    joints : sequence of Joint
        What they share.
    reflections : mapping
        For (face, first, second), two pieces that share a face, the sides that they lie on.
    dimension : int
        The dimension q of the space.
    seed : int
        What is open is chosen anew for every seed.

    Attributes
    ----------
    positions : ndarray, shape (n, q)
        Of the points that are placed, in a scale of their own.
    has_chosen : bool
        Whether anything was open.

    """

    def __init__(
        self,
        pieces: Sequence[tuple[Points, FloatArray]],
        joints: Sequence[Joint],
        reflections: Mapping[tuple[Points, int, int], SideConstraint],
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
        self._reflections = reflections
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
                    # The others say on which side of the first they lie.
                    for other in joint.pieces:
                        if not done[other]:
                            self._add(joint, number, other)
                            done[other] = True
                            queue.append(other)
            new = np.isfinite(self.positions[:, 0]) & ~placed
            if placed.any():
                self.positions[new, 0] += edge - self.positions[new, 0].min()
            edge = float(self.positions[new, 0].max()) + clearance
        return self._scaled(self.positions, 1)

    def _add(self, joint: Joint, placed: int, number: int) -> None:
        """Lay a piece against those that are placed."""
        points, local = self._pieces[number]
        members, face = np.array(points), list(joint.points)
        shared = local[np.searchsorted(members, face)]
        target = self.positions[face]
        if len(face) == self._dimension:
            turns = np.eye(self._dimension)[None]
            signs = np.array([self._sign(joint, placed, number, local, shared, target)])
        else:
            self.has_chosen = True
            turns = _orthogonal(self._rng, MOST_TURNS, self._dimension)
            signs = np.repeat([1, -1], MOST_TURNS // 2)
        new = ~np.isfinite(self.positions[members, 0])
        if not new.any():
            return
        old = self.positions[np.isfinite(self.positions[:, 0])]
        candidates = _aligned(local[new], shared, target, turns, signs)
        apart = [np.min(((points[:, None] - old) ** 2).sum(axis=-1)) for points in candidates]
        self.positions[members[new]] = candidates[np.argmax(apart)]

    def _sign(
        self,
        joint: Joint,
        placed: int,
        number: int,
        local: FloatArray,
        shared: FloatArray,
        target: FloatArray,
    ) -> int:
        """Return whether to mirror a piece, by the side of the face that it has to lie on."""
        hub = joint.pieces[0]
        other = placed if number == hub else number
        known = self._reflections.get((joint.points, hub, other))
        if known is None:
            self.has_chosen = True
            return int(self._rng.choice([1, -1]))
        # The first apex is that of the hub.
        apexes = (known.first, known.second) if number == hub else (known.second, known.first)
        apex = local[self._pieces[number][0].index(apexes[0])]
        side = _volume(shared, apex) * _volume(target, self.positions[apexes[1]])
        return 1 if (side < 0.0) == (known.side is Side.OPPOSITE) else -1
