# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Coordinates in the frame of some points of the fleet itself: a core of q, and one more.

Such a frame needs nothing but distances. The first point of the core is the origin; the last
coordinate of the additional point, the apex, is not negative.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.arrays import Interval
from dg_localization.solver.contract.coordinates import enclose_coordinates
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]

MAX_APEXES = 4
"""How many apexes are tried for each core."""

MAX_HEIGHTS = 2 * MAX_APEXES
"""Of how many apexes the height is bounded, where a placement tells which are likely far."""


def enclose_locally(
    lower: FloatArray, upper: FloatArray, frame: Sequence[int], dimension: int
) -> Interval | None:
    """
    Return coordinates in the frame of some points, or None when there is no placement.

    A frame of fewer than q + 1 points is padded with unmeasured points: they take the free places
    in the frame and bound nothing.

    Parameters
    ----------
    lower, upper : numpy.ndarray, shape (n, n)
        Bounds of the squared distances in m^2.
    frame : sequence of int
        The points that make the frame.
    dimension : {2, 3}

    Returns
    -------
    Interval, shape (n, q), or None

    """
    n_points, n_pads = len(lower), dimension + 1 - len(frame)
    padded_lower = np.zeros((n_points + n_pads, n_points + n_pads))
    padded_upper = np.full(padded_lower.shape, np.inf)
    np.fill_diagonal(padded_upper, 0.0)
    padded_lower[:n_points, :n_points] = lower
    padded_upper[:n_points, :n_points] = upper
    pads = range(n_points, n_points + n_pads)
    enclosure = enclose_coordinates(padded_lower, padded_upper, (*frame, *pads))
    if enclosure is None:
        return None
    # By definition of the frame, whether or not a pad hides it from the solver.
    for place, point in enumerate(frame):
        enclosure[point, :, place:] = 0.0
    return Interval(enclosure[:n_points, 0], enclosure[:n_points, 1])


def mirrored(local: Interval, sign: int) -> Interval:
    """Return the coordinates, the last one negated when the sign is -1."""
    if sign > 0:
        return local
    low, high = np.array(local.lower), np.array(local.upper)
    low[:, -1], high[:, -1] = -local.upper[:, -1], -local.lower[:, -1]
    return Interval(low, high)


def best_apexes(
    hypothesis: Hypothesis, core: tuple[int, ...], candidates: Sequence[int]
) -> list[int]:
    """Return the candidates that are farthest from the hyperplane of the core, best first."""
    if len(candidates) < 2:
        return list(candidates)
    spans = dict.fromkeys(candidates, 0.0)
    if hypothesis.positions is not None:
        edges = hypothesis.positions - hypothesis.positions[core[0]]
        corners = edges[[(*core[1:], apex) for apex in candidates]]
        volumes = np.abs(np.linalg.det(corners)).tolist()
        by_span = sorted(zip(candidates, volumes, strict=True), key=lambda pair: -pair[1])
        spans = dict(by_span[:MAX_HEIGHTS])
    heights = {}
    for apex, span in spans.items():
        # The height of the apex depends on nothing else.
        frame = (*core, apex)
        among = np.ix_(frame, frame)
        lower, upper = hypothesis.lower[among], hypothesis.upper[among]
        local = enclose_locally(lower, upper, range(len(frame)), len(core))
        if local is not None:
            # Certainly far ones first; those that may lie in the hyperplane by the placement.
            heights[apex] = (local.lower[-1, -1], span)
    ranked = sorted(heights, key=lambda apex: heights[apex], reverse=True)
    return ranked[:MAX_APEXES] or list(candidates[:1])
