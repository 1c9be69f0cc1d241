# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a piece that was solved says of pairs of its points which nobody measured."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
import math

from dg_localization.solver.assemble.subproblem import Ranges
from dg_localization.solver.decompose.graph import Pair
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.result import Hypothesis


def ranges_of(
    points: Points, hypotheses: Sequence[Hypothesis], pairs: Sequence[Pair]
) -> list[Ranges]:
    """Return what the hypotheses of a piece say of some pairs, in ranges that do not touch."""
    found: list[Ranges] = []
    for hypothesis in hypotheses:
        new: Ranges = {
            pair: hypothesis.bounds_of_pair(*(points.index(point) for point in pair))
            for pair in pairs
        }
        while touching := [ranges for ranges in found if _touch(ranges, new)]:
            found = [ranges for ranges in found if ranges not in touching]
            new = hull_of_ranges([new, *touching])
        found.append(new)
    return found


def _touch(first: Ranges, second: Ranges) -> bool:
    """Tell whether two sets of ranges of the same pairs have a point in common."""
    return all(
        low <= second[pair][1] and second[pair][0] <= high for pair, (low, high) in first.items()
    )


def common_ranges(ranges: Iterable[Ranges]) -> Ranges:
    """Return what several ranges, each of some pairs, have in common."""
    common: dict[Pair, tuple[float, float]] = {}
    for pair, (low, high) in (item for given in ranges for item in given.items()):
        least, most = common.get(pair, (0.0, math.inf))
        common[pair] = max(low, least), min(high, most)
    return common


def hull_of_ranges(ranges: list[Ranges]) -> Ranges:
    """Return the smallest ranges that hold several."""
    return {
        pair: (min(r[pair][0] for r in ranges), max(r[pair][1] for r in ranges))
        for pair in ranges[0]
    }
