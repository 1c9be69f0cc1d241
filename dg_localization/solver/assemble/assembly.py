# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds and placements of combinations of hypotheses, one for each piece.

A combination narrows the problem to the bounds of its hypotheses, with a side for every apex. One
contraction, without a split, bounds the distances between the pieces. If there are many points or
combinations, two linked pieces at a time are contracted, and chains of known distances bound the
rest.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cached_property
import math

import numpy as np

from dg_localization.solver.assemble.combinations import Combination, Combinations
from dg_localization.solver.assemble.links import Linker
from dg_localization.solver.assemble.solved_pieces import SolvedPieces
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.problem import Problem, Side, SideConstraint
from dg_localization.solver.result import Joint
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import contracted, smoothed
from dg_localization.solver.subproblem import Bounds, bounds_within, restricted


def _orthogonal(rng: np.random.Generator, dimension: int) -> FloatArray:
    """Return a random rotation or reflection, shape (q, q)."""
    matrix, upper = np.linalg.qr(rng.standard_normal((dimension, dimension)))
    return np.asarray(matrix * np.sign(np.diagonal(upper)))


def _aligned(
    local: FloatArray, shared: FloatArray, target: FloatArray, turn: FloatArray
) -> list[FloatArray]:
    """Align rotated points with their shared points at a target: as they are, and mirrored."""
    turned = shared @ turn
    center, target_center = turned.mean(axis=0), target.mean(axis=0)
    left, _, right = np.linalg.svd((turned - center).T @ (target - target_center))
    candidates = []
    for sign in (1.0, -1.0):
        left[:, -1] *= sign * np.sign(np.linalg.det(left @ right @ turn))
        candidates.append((local @ turn - center) @ left @ right + target_center)
    return candidates


def _volume(face: FloatArray, apex: FloatArray) -> float:
    """Return the signed volume of a simplex."""
    return float(np.linalg.det(np.vstack([face[1:], apex]) - face[0]))


class Layout:
    """
    Aligns pieces with each other at their joints.

    `positions` are the positions of the placed points, in an internal scale; `has_chosen` says
    whether a random choice was made, which differs between seeds.

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
        """Place all pieces; pieces without a joint are farther apart than `least_m`."""
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
        """Align a piece with the placed ones, on its known sides."""
        points, local = self._pieces[number]
        members, face = np.array(points), list(joint.points)
        is_new = ~np.isfinite(self.positions[members, 0])
        if not is_new.any():
            return
        q = self._dimension
        is_face = len(face) == q
        turn = np.eye(q) if is_face else _orthogonal(self._rng, q)
        shared = local[np.searchsorted(members, face)]
        candidates = _aligned(local[is_new], shared, self.positions[face], turn)
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
        """Return the number of violated side constraints on new points."""
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


class Assembly:
    """Bounds and places the combinations of the solved pieces of a problem."""

    def __init__(
        self,
        problem: Problem,
        budget: Budget,
        solved: SolvedPieces,
        combinations: Combinations,
        linker: Linker | None,
        within: Sequence[Bounds] | None,
    ) -> None:
        self.problem = problem
        self.solved = solved
        self.combinations = combinations
        self._linker = linker
        self._within = within
        self._unlimited = budget.again(replace(budget.options, max_seconds=math.inf))
        self._every = tuple(range(problem.n_points))

    def __getstate__(self) -> dict[str, object]:
        """Return the state to pickle, without functions that read the clock of the call."""
        return vars(self) | {'_linker': None}

    @cached_property
    def hull(self) -> Bounds | None:
        """The hull of the bounds of all combinations; None if they prove that none exists."""
        if len(self.solved.pieces) == 1:
            return self.solved.pieces[0].hull(sorted(self.combinations.left[0]))
        return self.bounds(Combination({}, {}))

    def bounds(
        self,
        combination: Combination,
        budget: Budget | None = None,
        in_twos: bool = False,
        is_tightened: bool = False,
    ) -> Bounds | None:
        """
        Return the bounds of all pairs in a combination; None if it holds no placement.

        All points are contracted together or, if there are many, two linked pieces at a time.
        """
        n_times = 1 + any(site.is_merged for site in self.combinations.sites)
        chosen = self._chosen(combination)
        if in_twos:
            n_times = 1
            for link in self.combinations.forest:
                pieces = (link.first, link.second)
                signs = [combination.sides.get((link.number, piece), 0) for piece in pieces]
                # The product of two signs is -1 on opposite sides.
                side = -signs[0] * signs[1]
                x, y = (combination.hypotheses[piece] for piece in pieces)
                two = self._linker.bounds_of_two(link, x, y, side) if self._linker else None
                if two is None:
                    return None
                chosen.append(two)
        bounds: Bounds | None = bounds_within(self._every, chosen)
        decided = [] if in_twos else combination.constraints(self.combinations.sites)
        for _ in range(n_times):
            problem = restricted(self.problem, self._every, bounds, decided)
            if problem is None:
                return None
            if in_twos:
                return smoothed(problem, self._within)
            # The first pass on flat pieces decides the sides of the pieces at their ends.
            bounds = contracted(problem, budget or self._unlimited, self._within, is_tightened)
            if bounds is None:
                return None
        return bounds

    def placements(
        self, combination: Combination, least_m: float, most: int
    ) -> Iterator[FloatArray]:
        """Yield placements in m of aligned pieces; nothing if a piece has no placement."""
        pieces = [
            (piece.points, piece.hypotheses[combination.hypotheses[x]].positions)
            for x, piece in enumerate(self.solved.pieces)
        ]
        known = [(points, local) for points, local in pieces if local is not None]
        sides = combination.constraints(self.combinations.sites)
        for seed in range(most if len(known) == len(pieces) else 0):
            placer = Layout(known, self.solved.joints, sides, self.problem.dimension, seed)
            yield placer.place(least_m)
            if not placer.has_chosen:
                break

    def with_sides(self, combination: Combination) -> Problem:
        """Return the problem with the sides of a combination."""
        decided = combination.constraints(self.combinations.sites)
        return restricted(self.problem, self._every, None, decided) or self.problem

    def _chosen(self, combination: Combination) -> list[tuple[Points, Bounds]]:
        """Return the bounds of each piece; the hull of its hypotheses if none is chosen."""
        chosen = []
        for number, piece in enumerate(self.solved.pieces):
            x = combination.hypotheses.get(number)
            left = sorted(self.combinations.left[number]) if x is None else [x]
            chosen.append((piece.points, piece.hull(left)))
        return chosen
