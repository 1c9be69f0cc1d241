# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Observations of a window as arrays, pair by pair."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.window.memory import Observation
from dg_localization.poses import NO_RAY_RAD

WORLD = -1
"""The body of the anchors."""

Pair = tuple[int, int]
"""Two bodies, the smaller index first: the world before any robot."""

Row = tuple[Observation, bool, tuple[int, int], tuple[int, int]]
"""An observation, whether the second body made it, and its points without and with a reference."""

AHEAD = np.array([1.0, 0.0, 0.0])


class Table(NamedTuple):
    """
    Observations of a pair as arrays, newest first; points are those of its two bodies.

    The references are the same, but with that of a range difference in place of the target.
    """

    observations: NDArray[Any]
    stamps_s: NDArray[np.float64]
    seen_by_second: NDArray[np.bool_]
    points: NDArray[np.int64]
    references: NDArray[np.int64]
    lower_m: NDArray[np.float64]
    upper_m: NDArray[np.float64]
    rays: NDArray[np.float64]
    errors_rad: NDArray[np.float64]
    least_m: NDArray[np.float64]
    most_m: NDArray[np.float64]
    likeliest_m: NDArray[np.float64]
    expected_errors_rad: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Sequence[Row], pair: Pair) -> Table:
        """Return a table of observations; how an anchor is turned is not known."""
        observations = np.empty(len(rows), object)
        observations[:] = [row[0] for row in rows]
        by_second = np.array([row[1] for row in rows])
        stamps_s, lower_m, upper_m, errors_rad, *others = np.array(
            [
                (
                    one.stamp_s,
                    one.lower_m,
                    one.upper_m,
                    NO_RAY_RAD if one.direction is None else one.half_width_rad,
                    one.least_m,
                    one.most_m,
                    one.likeliest_m,
                    one.expected_error_rad,
                )
                for one in observations
            ]
        ).T.copy()
        if pair[0] == WORLD:
            errors_rad[~by_second] = NO_RAY_RAD
        rays = np.array(
            [AHEAD if one.direction is None else one.direction for one in observations]
        )
        points, references = (np.array([row[k] for row in rows]) for k in (2, 3))
        columns = observations, stamps_s, by_second, points, references, lower_m, upper_m, rays
        return cls(*columns, errors_rad, *others).some(np.argsort(-stamps_s, kind='stable'))

    @property
    def ends(self) -> NDArray[np.int64]:
        """The observer and the target of each row, shape (m, 2)."""
        return np.where(self.seen_by_second[:, None], self.points[:, ::-1], self.points)

    @property
    def differences(self) -> NDArray[np.intp]:
        """The rows that are range differences."""
        return np.flatnonzero(np.isfinite(self.most_m))

    def some(self, index: slice | NDArray[np.int64]) -> Table:
        """Return some of the rows."""
        return Table._make(column[index] for column in self)
