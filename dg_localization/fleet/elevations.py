# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Elevations of points in the plane: they turn ranges in space into ranges in the plane.

Bounds of a distance in the plane follow from the bounds in space and the difference of elevations,
by Pythagoras. Elevations are stated in the settings and may also be read: a reading counts while
it is young, widened by the greatest motion of the point since.
"""

from __future__ import annotations

from bisect import insort
import math
from typing import NamedTuple, TypeAlias

from dg_localization.fleet.admission import is_young
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.motion import most_between
from dg_localization.fleet.sensors import ElevationErrorModel
from dg_localization.fleet.vocabulary import DistanceReading
from dg_localization.interval.bounds import (
    sqrt_down,
    sqrt_up,
    squared_distance,
    sum_down,
    sum_up,
)

Bounds: TypeAlias = tuple[float, float]


class _Reading(NamedTuple):
    """Bounds of the elevation of a point at one time."""

    stamp_s: float
    lower_m: float
    upper_m: float


class Elevations:
    """
    Bounds of the elevations of all points.

    Parameters
    ----------
    config : FleetConfig

    """

    def __init__(self, config: FleetConfig) -> None:
        self.config = config
        self._readings: dict[str, list[_Reading]] = {}

    def add(
        self,
        point: str,
        elevation_m: float,
        error: ElevationErrorModel,
        stamp_s: float,
        now_s: float,
    ) -> Bounds | None:
        """
        Add a reading, unless it contradicts the known bounds of the point.

        A contradiction does not show which of them is wrong, so no reading counts then.

        Returns
        -------
        tuple of float or None
            The bounds that the reading contradicts.

        """
        lower_m = sum_down(elevation_m, -error.max_error_m)
        upper_m = sum_up(elevation_m, -error.min_error_m)
        known_m = self.at_m(point, stamp_s, now_s)
        readings = self._readings.setdefault(point, [])
        if upper_m < known_m[0] or known_m[1] < lower_m:
            readings.clear()
            return known_m
        insort(readings, _Reading(stamp_s, lower_m, upper_m))
        del readings[: -self.config.max_repeats]
        return None

    def forget_until(self, stamp_s: float) -> None:
        """Forget the readings up to a time."""
        for readings in self._readings.values():
            readings[:] = [one for one in readings if one.stamp_s > stamp_s]

    def at_m(self, point: str, stamp_s: float, now_s: float) -> Bounds:
        """Return bounds of the elevation of a point at a time, by readings young at `now_s`."""
        config, stated_m = self.config, self.config.elevation_m(point)
        lower_m, upper_m = stated_m
        speed_m_s = config.speed_m_s(config.robot_of(point))
        for reading in self._readings.get(config.elevated(point), ()):
            if is_young(config, reading.stamp_s, now_s):
                times_s = reading.stamp_s, stamp_s, config.between_stamps_s
                climb_m = most_between(speed_m_s, *times_s)
                lower_m = max(lower_m, sum_down(reading.lower_m, -climb_m))
                upper_m = min(upper_m, sum_up(reading.upper_m, climb_m))
        return (lower_m, upper_m) if lower_m <= upper_m else stated_m

    def in_plane(self, reading: DistanceReading, now_s: float) -> DistanceReading:
        """Return a distance reading in space as one in the plane."""
        rise_m2 = self.squared_rise_m2(*reading.key.ends, reading.stamp_s, now_s)
        if rise_m2[1] == 0.0:
            return reading
        in_space_m = reading.lower_m, reading.upper_m
        lower_m, upper_m = distance_in_plane_m(in_space_m, rise_m2)
        likeliest_m = _likeliest_in_plane_m(reading.likeliest_m, rise_m2)
        return DistanceReading(
            reading.key, reading.stamp_s, lower_m, upper_m, likeliest_m, in_space_m
        )

    def squared_rise_m2(self, first: str, second: str, stamp_s: float, now_s: float) -> Bounds:
        """Return bounds of the squared difference of the elevations of two points at a time."""
        return squared_rise_m2(*(self.at_m(point, stamp_s, now_s) for point in (first, second)))


def squared_rise_m2(first_m: Bounds, second_m: Bounds) -> Bounds:
    """Return bounds of the squared difference of two elevations, in m^2."""
    if first_m == second_m and first_m[0] == first_m[1]:
        return 0.0, 0.0
    upper_m = max(sum_up(second_m[1], -first_m[0]), sum_up(first_m[1], -second_m[0]))
    lower_m = max(sum_down(second_m[0], -first_m[1]), sum_down(first_m[0], -second_m[1]))
    return squared_distance(lower_m, upper_m)


def distance_in_plane_m(distance_m: Bounds, rise_m2: Bounds) -> Bounds:
    """
    Return bounds of the distance between the projections of two points on the plane.

    Parameters
    ----------
    distance_m : tuple of float
        Bounds of the distance of the points; the upper one is below zero if there is none.
    rise_m2 : tuple of float
        Bounds of the squared difference of their elevations.

    Returns
    -------
    lower_m, upper_m : float
        The upper bound is below zero if no distance agrees.

    """
    if rise_m2[1] == 0.0 or distance_m[1] < 0.0:
        return distance_m
    s_lower_m2, s_upper_m2 = squared_distance(*distance_m)
    s_upper_m2 = sum_up(s_upper_m2, -rise_m2[0])
    upper_m = sqrt_up(s_upper_m2) if s_upper_m2 >= 0.0 else -sqrt_down(-s_upper_m2)
    return sqrt_down(sum_down(s_lower_m2, -rise_m2[1])), upper_m


def _likeliest_in_plane_m(likeliest_m: float, rise_m2: Bounds) -> float:
    """Return the likeliest distance in the plane for one in space; NaN for NaN."""
    if math.isnan(likeliest_m):
        return likeliest_m
    squared_m2 = likeliest_m * likeliest_m - 0.5 * (rise_m2[0] + rise_m2[1])
    return math.sqrt(max(0.0, squared_m2))
