# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The observations of a pair of bodies: one by one, and as arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.window.memory import Observation
from dg_localization.poses import NO_RAY_RAD

AHEAD = np.array([1.0, 0.0, 0.0])


class Row(NamedTuple):
    """An observation with a point of the first body and one of the second."""

    observation: Observation
    seen_by_second: bool
    points: tuple[int, int]


class Table(NamedTuple):
    """Observations of a pair as arrays, newest first."""

    stamps_s: NDArray[np.float64]
    seen_by_second: NDArray[np.bool_]
    points: NDArray[np.int64]
    lower_m: NDArray[np.float64]
    upper_m: NDArray[np.float64]
    rays: NDArray[np.float64]
    errors_rad: NDArray[np.float64]

    @classmethod
    def of(cls, rows: Sequence[Row], of_anchors: bool) -> Table:
        """Return a table of rows; how an anchor is turned is not known."""
        seen = [row.observation for row in rows]
        by_second = np.array([row.seen_by_second for row in rows])
        errors_rad = np.array(
            [NO_RAY_RAD if one.direction is None else one.half_width_rad for one in seen]
        )
        return cls(
            np.array([one.stamp_s for one in seen]),
            by_second,
            np.array([row.points for row in rows]),
            np.array([one.lower_m for one in seen]),
            np.array([one.upper_m for one in seen]),
            np.array([AHEAD if one.direction is None else one.direction for one in seen]),
            np.where(by_second, errors_rad, NO_RAY_RAD) if of_anchors else errors_rad,
        )

    def some(self, index: slice | NDArray[np.int64]) -> Table:
        """Return some of the rows."""
        return Table._make(column[index] for column in self)
