"""The first estimate of a process loads the kernels, the first on a machine compiles them."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.localizer import Localizer

STAMP_S = 1.0


def warm_up(dimension: int) -> None:
    """
    Estimate a small fleet that needs every kernel, so that later estimates wait for none.

    Of its two groups of robots, which do not measure each other, one has several placements and
    the other has cameras.

    Parameters
    ----------
    dimension : {2, 3}
        Dimension of the space.

    """
    positions_m = _two_simplices_m(dimension)
    groups = [tuple(f'{group}{i}' for i in range(len(positions_m))) for group in 'ab']
    localizer = Localizer(FleetConfig(robots=(*groups[0], *groups[1]), dimension=dimension))
    for robots in groups:
        for i, j in _measured_pairs(len(robots)):
            range_m = float(np.linalg.norm(positions_m[j] - positions_m[i]))
            localizer.add_range(robots[i], robots[j], range_m, STAMP_S, STAMP_S)
    for i, j in _measured_pairs(len(positions_m)):
        ray = np.zeros(3)
        ray[:dimension] = positions_m[j] - positions_m[i]
        localizer.add_bearing(groups[1][i], groups[1][j], ray, STAMP_S, STAMP_S)
    localizer.step(STAMP_S)


def _two_simplices_m(dimension: int) -> np.ndarray:
    """Return the corners of two simplices with a face in common, the lone corners at the ends."""
    # Of different lengths, so that no two corners are alike.
    face = np.diag(3.0 + np.arange(dimension))
    return np.vstack([np.zeros(dimension), face, np.full(dimension, 3.5)])


def _measured_pairs(n: int) -> list[tuple[int, int]]:
    """Return all pairs but that of the lone corners, which are on either side or on the same."""
    return [pair for pair in combinations(range(n), 2) if pair != (0, n - 1)]
