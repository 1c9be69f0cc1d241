# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The graph of the bounded distances: which points are connected."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BoolArray = NDArray[np.bool_]


def connected_to(joined: BoolArray, start: int) -> set[int]:
    """Return the points that a chain of joined pairs connects to one of them."""
    reached = {start}
    pending = [start]
    while pending:
        new = set(np.flatnonzero(joined[pending.pop()]).tolist()) - reached
        reached |= new
        pending.extend(new)
    return reached


def components_of(joined: BoolArray) -> list[tuple[int, ...]]:
    """Return the points that chains of joined pairs connect, in the order of their first ones."""
    components: list[tuple[int, ...]] = []
    waiting = list(range(len(joined)))
    while waiting:
        together = connected_to(joined, waiting[0])
        components.append(tuple(sorted(together)))
        waiting = [point for point in waiting if point not in together]
    return components
