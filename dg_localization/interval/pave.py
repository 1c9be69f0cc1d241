# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Branch and prune: the loop over boxes that all searches share (Section 4).

A box may be one of distances, of coordinates or of poses (SIVIA; Jaulin, Walter, Set inversion via
interval analysis, Automatica 29(4), 1993): the loop only asks what is left of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from heapq import heappop, heappush
from itertools import count
from typing import Generic, NamedTuple, TypeVar

B = TypeVar('B')

LEAST_GAIN = 0.05
"""A step that shortens no interval by more than this fraction is the last of its kind."""


class Examined(NamedTuple, Generic[B]):
    """
    What is left of a box: nothing if it is empty.

    `kept` are finished boxes, `parts` are to be examined next, and `rest` is what there was no
    time to examine.
    """

    kept: Sequence[B] = ()
    parts: Sequence[B] = ()
    rest: Sequence[B] = ()


@dataclass
class Paving(Generic[B]):
    """The kept and the pending boxes of a search, which hold every solution, and its effort."""

    kept: list[B] = field(default_factory=list)
    pending: list[B] = field(default_factory=list)
    empty: int = 0
    split: int = 0

    @property
    def processed(self) -> int:
        """The number of examined boxes."""
        return self.empty + self.split + len(self.kept)


def pave(
    boxes: Iterable[B],
    examine: Callable[[B], Examined[B]],
    watch: Callable[[Paving[B], int], bool],
    rank: Callable[[B], float] = lambda box: 0.0,
) -> Paving[B]:
    """
    Cover all solutions in some boxes by smaller boxes: each lies in a kept or a pending box.

    `watch` sees the paving so far and the number of waiting boxes, before each box and at the end,
    and says whether to go on. Boxes of the least rank are examined first, those of equal rank in
    their order.
    """
    paving, order = Paving[B](), count()
    waiting: list[tuple[float, int, B]] = []

    def add(some: Iterable[B]) -> None:
        for box in some:
            heappush(waiting, (rank(box), next(order), box))

    add(boxes)
    while watch(paving, len(waiting)) and waiting:
        *_, box = heappop(waiting)
        kept, parts, rest = examine(box)
        paving.kept += kept
        paving.split += bool(parts)
        paving.empty += not (kept or parts or rest)
        add(parts)
        add(rest)
    paving.pending = [box for *_, box in sorted(waiting)]
    return paving
