# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The readings of a bag by input, for learning error bounds, and their errors."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.bounds import Columns, residuals
from dg_localization.calibration.truth import TrueTrack, range_errors_m, ray_errors_rad
from dg_localization.fleet import (
    FleetConfig,
    LinkKey,
    LinkKind,
    Localizer,
    Rejection,
    SensorBounds,
)
from dg_localization.fleet.error_models import in_body_frame, interpret_ray
from dg_localization.fleet.vocabulary import OdometrySample

FloatArray: TypeAlias = NDArray[np.float64]


class Gatherer(Localizer):
    """
    A localizer that keeps all accepted readings of a recording, and does not localize.

    Readings that the node would reject are not used: its bounds are for accepted readings.

    Attributes
    ----------
    readings : dict of LinkKey to list of (float, float or ndarray)
        By input, stamps in s with ranges in m or unit vectors in the body frame, as they arrived.
    odometry : dict of str to list of list of OdometrySample
        By robot; each restart of the odometry that the localizer detects begins a new piece.
    stated : dict of LinkKey to set of SensorBounds
        The bounds that readings of an input came with, from all links that carry it.

    """

    def __init__(self, config: FleetConfig) -> None:
        super().__init__(config)
        self.readings: dict[LinkKey, list[tuple[float, Any]]] = defaultdict(list)
        self.odometry: dict[str, list[list[OdometrySample]]] = defaultdict(list)
        self.stated: dict[LinkKey, set[SensorBounds]] = defaultdict(set)

    def stamps_s(self) -> list[float]:
        """Return the stamps of all measurements."""
        found = [row[0] for rows in self.readings.values() for row in rows]
        pieces = (piece for pieces in self.odometry.values() for piece in pieces)
        return found + [sample.stamp_s for piece in pieces for sample in piece]

    def add_odometry(self, robot: str, *args: Any, **kwargs: Any) -> Rejection | None:
        """Keep an accepted pose as it was reported."""
        rejection = super().add_odometry(robot, *args, **kwargs)
        if rejection is None:
            newest, pieces = self._track(robot).newest, self.odometry[robot]
            if not pieces or newest.restarted_s > pieces[-1][-1].stamp_s:
                pieces.append([])
            pieces[-1].append(newest)
        return rejection

    def _take(
        self, key: LinkKey, value: Any, stamp_s: float, now_s: float, bounds: SensorBounds
    ) -> None:
        """Keep an accepted range or ray."""
        super()._take(key, value, stamp_s, now_s, bounds)
        if key.reference:
            # The bounds of range differences are not learned.
            return
        self.stated[key].add(bounds)
        if key.kind is LinkKind.BEARING:
            in_body = in_body_frame(self._config.sensors.get(key.observer), value)
            self.readings[key].append((stamp_s, interpret_ray(in_body, self._config.dimension)))
        # Infinity is accepted if it proves that the target is far; it has no error.
        elif math.isfinite(value.range_m):
            self.readings[key].append((stamp_s, value.range_m))


@dataclass(frozen=True, eq=False)
class Errors(Columns):
    """
    The errors of readings, oldest first, each array with shape (m,).

    Values are ranges in m, NaN for rays; errors are in m or in rad. Links are the inputs.
    """

    stamps_s: FloatArray
    values: FloatArray
    errors: FloatArray
    links: NDArray[np.str_]


def errors_of(
    gatherer: Gatherer,
    tracks: Mapping[str, TrueTrack] | None,
    offsets_s: Mapping[LinkKey, float] | None = None,
) -> dict[LinkKey, Errors]:
    """
    Return the errors of ranges and rays against the truth, where it is known.

    Without a truth they are the residuals of each reading against its neighbors in time; there are
    none for rays in space. The offsets are added to the stamps first.
    """
    dimension, found = gatherer.config.dimension, {}
    for key, rows in gatherer.readings.items():
        is_range = key.kind is LinkKind.RANGE
        order = sorted(rows, key=lambda row: row[0])
        stamps_s, read = (np.array(column) for column in zip(*order, strict=True))
        stamps_s = stamps_s + (offsets_s or {}).get(key, 0.0)
        if tracks is None:
            if not is_range and dimension == 3:
                continue
            seen = read if is_range else np.arctan2(read[:, 1], read[:, 0])
            errors = residuals(stamps_s, seen, angles=not is_range)
        elif {key.observer, key.target} <= tracks.keys():
            errors_beside = range_errors_m if is_range else ray_errors_rad
            ends = tracks[key.observer], tracks[key.target]
            errors = errors_beside(*ends, stamps_s, read, dimension)
        else:
            continue
        values = read if is_range else np.full(len(stamps_s), np.nan)
        links = np.full(len(errors), str(key))
        found[key] = Errors(stamps_s, values, errors, links).chosen(np.isfinite(errors))
    return found
