# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The readings of a snapshot as terms of a fit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.best_point.terms import (
    AT_ORIGIN,
    PlaceTerm,
    RangeTerm,
    RayTerm,
    Term,
)
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.interval.arrays import Interval

FloatArray = NDArray[np.float64]


def terms_of(
    snapshot: Snapshot,
    solved: Constraints,
    dropped: frozenset[LinkKey],
    anchors: Mapping[int, Interval],
) -> Iterator[Term]:
    """
    Yield a term for each reading of a snapshot that counts.

    Parameters
    ----------
    snapshot : Snapshot
    solved : Constraints
        Of the points that are placed together; a body is one of them.
    dropped : frozenset of LinkKey
        Links that do not count.
    anchors : mapping of int to Interval
        Coordinates of the anchors, where these give the frame.

    Yields
    ------
    Term

    """
    rows = solved.rows
    config, arms_m = snapshot.config, snapshot.mounts.arms_m

    def end(point: str) -> tuple[int, Sequence[float] | FloatArray]:
        """Return the body of a point, and where on the body it is."""
        return rows[config.robot_of(point)], arms_m.get(point, AT_ORIGIN)

    for reading in snapshot.distances:
        key = reading.key
        counts = key not in dropped and math.isfinite(reading.likeliest_m)
        if counts and rows.keys() >= {key.observer, key.target}:
            (first, first_arm_m), (second, second_arm_m) = end(key.observer), end(key.target)
            if first != second:
                yield RangeTerm(
                    first,
                    second,
                    reading.likeliest_m,
                    0.5 * (reading.upper_m - reading.lower_m),
                    first_arm_m,
                    second_arm_m,
                )
    for observer, rays in solved.rays.items():
        for ray in rays:
            (row, arm_m), (target, target_arm_m) = end(observer), end(ray.key.target)
            # Who may look anywhere has seen nothing.
            if row != target and ray.half_width_rad < math.pi:
                error_rad = config.bearing_expected_error_of(observer, ray.key.target)
                direction = _turned_back(ray.direction, error_rad)
                yield RayTerm(row, target, direction, ray.half_width_rad, arm_m, target_arm_m)
    for row, box in anchors.items():
        if (box.lower < box.upper).any():
            position_m = np.zeros(3)
            position_m[: solved.dimension] = 0.5 * (box.lower + box.upper)
            yield PlaceTerm(row, position_m, 0.5 * float((box.upper - box.lower).max()))


def _turned_back(direction: np.ndarray, error_rad: float) -> np.ndarray:
    """Return a direction without an error about the vertical axis."""
    c, s = math.cos(error_rad), math.sin(error_rad)
    x, y, z = direction
    return np.array([c * x + s * y, c * y - s * x, z])
