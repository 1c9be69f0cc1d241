# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One hypothesis for every patch: which choices agree, listed while they are few."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import islice

import numpy as np

from dg_localization.solver.assemble.combinations import FREE, Combinations, Network, PieceLink
from dg_localization.solver.patches.known_pairs import KnownPairs, Patch

Choice = dict[int, int]
"""The hypothesis chosen for each patch that has several left."""


class Ambiguities:
    """The patches that have several hypotheses left, and which of these go together."""

    def __init__(
        self, patches: Sequence[Patch], known: KnownPairs, stopped: Callable[[], bool]
    ) -> None:
        self._patches = patches
        self._ambiguous = [x for x, patch in enumerate(patches) if patch.left.sum() > 1]
        self._left = [np.flatnonzero(patches[x].left).tolist() for x in self._ambiguous]
        links = []
        for first, second in self._overlapping():
            if stopped():
                # Choices that do not agree are told apart no more, which loses none.
                break
            numbers = self._ambiguous[first], self._ambiguous[second]
            (low, high), (other_low, other_high) = known.bounds_of_shared(*numbers)
            agree = (low[:, None] <= other_high[None]).all(axis=2)
            agree &= (other_low[None] <= high[:, None]).all(axis=2)
            agree = agree[np.ix_(self._left[first], self._left[second])]
            if not agree.all():
                allowed = {(int(x), int(y)): FREE for x, y in np.argwhere(agree)}
                links.append(PieceLink(first, second, allowed=allowed))
        counts = [len(numbers) for numbers in self._left]
        self._combinations = Combinations(counts, Network(links=links))

    def _overlapping(self) -> Iterator[tuple[int, int]]:
        """Yield the ambiguous patches that share pairs, two at a time, in their order."""
        holders: dict[int, list[int]] = {}
        for second, number in enumerate(self._ambiguous):
            points = self._patches[number].points
            n_shared = Counter(first for point in points for first in holders.get(point, ()))
            yield from ((first, second) for first, n in n_shared.items() if n > 1)
            for point in points:
                holders.setdefault(point, []).append(second)

    def drop_unmatched(self) -> bool:
        """Drop hypotheses that a neighbor has no match for; return whether there were any."""
        dropped = False
        for number, numbers, kept in zip(
            self._ambiguous, self._left, self._combinations.left, strict=True
        ):
            gone = [x for place, x in enumerate(numbers) if place not in kept]
            self._patches[number].left[gone] = False
            dropped = dropped or bool(gone)
        return dropped

    def choices(self, most: int) -> list[Choice] | None:
        """Return all choices that agree pair by pair, None where there are more than `most`."""
        if not self._ambiguous:
            return [{}]
        listed = self._combinations.listed(lambda _: True)
        found = list(islice(listed, most + 1))
        if len(found) > most:
            return None
        return [
            {self._ambiguous[x]: self._left[x][y] for x, y in sorted(c.hypotheses.items())}
            for c in found
        ]
