# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of pairs that patches share, and compatibility of the hypotheses of patches.

A pair in several patches has a squared distance that each of them bounds. Hypotheses whose bounds
do not meet the bounds of all other patches are dropped, until none is left to drop (arc
consistency). Choices of one hypothesis for every patch are listed if they are few.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import islice

import numpy as np

from dg_localization.solver.assemble.combinations import FREE, Combinations, Network, PieceLink
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import BoolArray, Pair, Points
from dg_localization.solver.pair_bounds import PairBounds, pairs_among
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis


@dataclass(eq=False)
class Patch:
    """Points of a piece with the hypotheses that hold all their placements."""

    points: Points
    hypotheses: list[Hypothesis]
    pending: set[bytes]  # the bounds of boxes that were not examined
    left: BoolArray = field(init=False)  # which hypotheses agree with the other patches

    def __post_init__(self) -> None:
        """Start with all hypotheses."""
        self.left = np.ones(len(self.hypotheses), dtype=np.bool_)

    def remaining(self) -> list[Hypothesis]:
        """Return the remaining hypotheses."""
        return [self.hypotheses[x] for x in np.flatnonzero(self.left)]

    def n_boxes(self) -> int:
        """Return the number of boxes of the remaining hypotheses."""
        return sum(len(hypothesis.boxes) for hypothesis in self.remaining())

    def n_pending(self) -> int:
        """Return the number of these boxes that were not examined."""
        if not self.pending:
            return 0
        boxes = (box for hypothesis in self.remaining() for box in hypothesis.boxes)
        return sum(box.tobytes() in self.pending for box in boxes)


class KnownPairs(PairBounds):
    """Bounds of the pairs that are measured or lie in patches."""

    def __init__(
        self, problem: Problem, measured: Sequence[Pair], patches: Sequence[Patch]
    ) -> None:
        n_points, keys = problem.n_points, []
        for points in (np.array(patch.points) for patch in patches):
            rows, columns = pairs_among(len(points))
            keys.append(points[rows] * n_points + points[columns])
        rows, columns = np.array(measured, dtype=np.int64).T
        every = np.unique(np.concatenate([rows * n_points + columns, *keys]))
        super().__init__(n_points, every, *problem.pairs.of(*np.divmod(every, n_points)))
        self._patches = patches
        self.numbers = [np.searchsorted(every, of_patch) for of_patch in keys]
        self._bounds = [_bounds_of(patch) for patch in patches]

    def narrow(self) -> int | None:
        """Drop hypotheses until all agree; return a patch without any left, or None."""
        for number, patch in enumerate(self._patches):
            if not patch.left.any():
                return number
        if not self._patches:
            return None
        counts = [len(patch.hypotheses) for patch in self._patches]
        left = np.concatenate([patch.left for patch in self._patches])
        empty = self._drop(left, counts)
        for patch, of_patch in zip(self._patches, np.split(left, np.cumsum(counts)), strict=False):
            patch.left = of_patch
        return empty

    def _drop(self, left: BoolArray, counts: Sequence[int]) -> int | None:
        """Drop hypotheses and narrow pairs to a fixed point; return a patch without any left."""
        sizes = [len(numbers) for numbers in self.numbers]
        first_row = np.cumsum([0, *counts[:-1]])
        # One entry per pair of each hypothesis: its hypothesis, and the index of its pair.
        rows = np.repeat(np.arange(len(left)), np.repeat(sizes, counts))
        blocks = zip(np.cumsum([0, *sizes[:-1]]), sizes, counts, strict=True)
        slots = np.concatenate([np.tile(np.arange(a, a + m), k) for a, m, k in blocks])
        numbers = np.concatenate(self.numbers)
        low, high = np.concatenate([bounds.reshape(2, -1) for bounds in self._bounds], axis=1)
        while True:
            ends = self.lower[numbers], self.upper[numbers]
            left[rows[(low > ends[1][slots]) | (high < ends[0][slots])]] = False
            gone = ~np.logical_or.reduceat(left, first_row)
            if gone.any():
                return int(np.argmax(gone))
            least, most = np.full(len(numbers), np.inf), np.full(len(numbers), -np.inf)
            kept = left[rows]
            np.minimum.at(least, slots[kept], low[kept])
            np.maximum.at(most, slots[kept], high[kept])
            np.maximum.at(self.lower, numbers, least)
            np.minimum.at(self.upper, numbers, most)
            crossed = self.lower[numbers] > self.upper[numbers]
            if crossed.any():
                return int(np.searchsorted(np.cumsum(sizes), np.argmax(crossed), side='right'))
            if (ends[0] == self.lower[numbers]).all() and (ends[1] == self.upper[numbers]).all():
                return None

    def bounds_of(self, patch: int, hypothesis: int) -> tuple[IntArray, FloatArray]:
        """Return the numbers of a patch's pairs, and their bounds in one of its hypotheses."""
        return self.numbers[patch], self._bounds[patch][:, hypothesis]

    def bounds_of_shared(self, first: int, second: int) -> tuple[FloatArray, FloatArray]:
        """Return the bounds of two patches on their common pairs."""
        _, of_first, of_second = np.intersect1d(
            self.numbers[first], self.numbers[second], assume_unique=True, return_indices=True
        )
        return self._bounds[first][:, :, of_first], self._bounds[second][:, :, of_second]


def _bounds_of(patch: Patch) -> FloatArray:
    """Return the bounds in m^2 of the pairs of a patch by hypothesis, shape (2, k, m)."""
    rows, columns = pairs_among(len(patch.points))
    ends = [(h.lower[rows, columns], h.upper[rows, columns]) for h in patch.hypotheses]
    return np.array(ends).reshape(-1, 2, len(rows)).transpose(1, 0, 2)


Choice = dict[int, int]
"""The chosen hypothesis of each patch that has several left."""


class Ambiguities:
    """The patches that have several hypotheses left, and their compatible pairs."""

    def __init__(
        self, patches: Sequence[Patch], known: KnownPairs, stopped: Callable[[], bool]
    ) -> None:
        self._patches = patches
        self._ambiguous = [x for x, patch in enumerate(patches) if patch.left.sum() > 1]
        self._left = [np.flatnonzero(patches[x].left).tolist() for x in self._ambiguous]
        links = []
        for first, second in self._overlapping():
            if stopped():
                # Incompatible choices are no longer found, which loses no placement.
                break
            numbers = self._ambiguous[first], self._ambiguous[second]
            (low, high), (other_low, other_high) = known.bounds_of_shared(*numbers)
            agree = (low[:, None] <= other_high[None]).all(axis=2)
            agree &= (other_low[None] <= high[:, None]).all(axis=2)
            agree = agree[np.ix_(self._left[first], self._left[second])]
            if not agree.all():
                link = PieceLink(first, second)
                link.allowed.update(((int(x), int(y)), FREE) for x, y in np.argwhere(agree))
                links.append(link)
        counts = [len(numbers) for numbers in self._left]
        self._combinations = Combinations(counts, Network(links=links))

    def _overlapping(self) -> Iterator[tuple[int, int]]:
        """Yield two at a time the ambiguous patches that share pairs, in their order."""
        holders: dict[int, list[int]] = {}
        for second, number in enumerate(self._ambiguous):
            points = self._patches[number].points
            n_shared = Counter(first for point in points for first in holders.get(point, ()))
            yield from ((first, second) for first, n in n_shared.items() if n > 1)
            for point in points:
                holders.setdefault(point, []).append(second)

    def drop_unmatched(self) -> bool:
        """Drop hypotheses without a match in a neighbor; return whether there were any."""
        dropped = False
        for number, numbers, kept in zip(
            self._ambiguous, self._left, self._combinations.left, strict=True
        ):
            gone = [x for place, x in enumerate(numbers) if place not in kept]
            self._patches[number].left[gone] = False
            dropped = dropped or bool(gone)
        return dropped

    def choices(self, most: int) -> list[Choice]:
        """Return all choices that agree pair by pair, or an empty choice if there are too many."""
        listed = self._combinations.listed(lambda _: True)
        found = list(islice(listed, most + 1))
        if len(found) > most:
            return [{}]
        return [
            {self._ambiguous[x]: self._left[x][y] for x, y in sorted(c.hypotheses.items())}
            for c in found
        ]
