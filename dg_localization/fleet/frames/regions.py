# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Regions: the parts of an enclosure that do not touch each other.

Distances to anchors that are nearly in line hold on either side of the line. The hypothesis of the
solver, which bounds distances, is connected; the coordinates are not. Set inversion covers each
part by contracted boxes, so no placement is lost.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.frames.enclosure import MAX_BOXES
from dg_localization.interval.arrays import Interval, determinant
from dg_localization.interval.pave import Examined, pave
from dg_localization.solver.box import component_hulls
from dg_localization.solver.contract.coordinates import contract_coordinate_boxes

FloatArray = NDArray[np.float64]


def regions_of(
    enclosure: Interval, lower: FloatArray, upper: FloatArray, rows: Sequence[int], most: int
) -> list[Interval]:
    """
    Return about `most` parts of an enclosure at most, which together hold all placements.

    `rows` are the points that may lie in several parts; `lower` and `upper` bound the squared
    distances in m^2.
    """
    regions = [enclosure]
    for row in rows:
        following: list[Interval] = []
        for number, region in enumerate(regions):
            parts = [region]
            if len(following) + len(regions) - number < most:
                parts = _parts_of_point(region, lower, upper, row)
            following += parts
        regions = following
    return regions


def _parts_of_point(
    region: Interval, lower: FloatArray, upper: FloatArray, row: int
) -> list[Interval]:
    """Return the parts of a region that differ in the place of one point."""
    others = np.flatnonzero(np.isfinite(upper[row]) & (np.arange(len(upper)) != row))
    bounded = np.isfinite(region.lower).all(axis=1) & np.isfinite(region.upper).all(axis=1)
    if not bounded[row] or _is_in_general_position(region, row, others[bounded[others]]):
        return [region]
    cells = _cells_of_point(region, lower, upper, row)
    hulls, _ = component_hulls(cells)
    if len(hulls) < 2:
        return [region]
    parts = []
    for hull in hulls:
        low, high = np.array(region.lower), np.array(region.upper)
        low[row], high[row] = hull
        if contract_coordinate_boxes(low, high, lower, upper):
            parts.append(Interval(low, high))
    return parts


def _is_in_general_position(region: Interval, row: int, others: NDArray[np.intp]) -> bool:
    """Return whether distances to q of the other points fix the place of a point in a region."""
    dimension = region.lower.shape[1]
    some = others[:: len(others) // MAX_BOXES + 1].tolist()
    bases = list(combinations(some, dimension))
    if not bases:
        return False
    volumes = determinant(region[np.array(bases)] - region[row])
    return bool(((volumes.lower > 0.0) | (volumes.upper < 0.0)).any())


def _cells_of_point(
    region: Interval, lower: FloatArray, upper: FloatArray, row: int
) -> FloatArray:
    """Return boxes, shape (k, 2, q), that cover all places of a point."""
    star_lower, star_upper = np.zeros_like(lower), np.full_like(upper, np.inf)
    star_lower[row], star_upper[row] = lower[row], upper[row]
    star_lower[:, row], star_upper[:, row] = lower[:, row], upper[:, row]

    def halves(cell: FloatArray) -> Examined[FloatArray]:
        axis = int(np.argmax(cell[1] - cell[0]))
        middle = 0.5 * (cell[0, axis] + cell[1, axis])
        if not cell[0, axis] < middle < cell[1, axis]:
            return Examined(kept=[cell])
        parts = []
        for side in (0, 1):
            low, high = np.array(region.lower), np.array(region.upper)
            low[row], high[row] = cell
            (high if side == 0 else low)[row, axis] = middle
            if contract_coordinate_boxes(low, high, star_lower, star_upper):
                parts.append(np.stack([low[row], high[row]]))
        return Examined(parts=parts)

    cells = pave(
        [np.stack([region.lower[row], region.upper[row]])],
        halves,
        lambda found, n_waiting: len(found.kept) + n_waiting < MAX_BOXES,
        lambda cell: -float(np.max(cell[1] - cell[0])),
    )
    found = np.array(cells.kept + cells.pending)
    return found.reshape(-1, 2, region.lower.shape[1])
