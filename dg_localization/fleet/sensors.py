# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Settings of sensors and anchors: error bounds and places.

Every dataclass here is frozen and checks itself when made. A wrong value raises `ConfigError`,
whose message names the field, the value, and the allowed values.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from itertools import starmap
import math
from types import MappingProxyType
from typing import Any, ClassVar

from dg_localization.fleet.checks import (
    FARTHEST_M,
    keep,
    keep_numbers,
    not_allowed,
    require_coordinates,
    require_kind,
    require_mapping,
    require_members,
    require_name,
    require_number,
    require_one_of,
)

NOT_FAR = {'at_least': 0.0, 'at_most': FARTHEST_M}
HALF_TURN = {'at_least': 0.0, 'at_most': math.pi}


@dataclass(frozen=True)
class RangeErrorModel:
    """
    Bounds of the error of a range, which is the reading minus the true distance.

    A reading r means a true distance in ``[r - high, r - low]`` with
    ``high = max_error_m + max_error_relative * r + sigma_factor * sigma`` and
    ``low = min_error_m + min_error_relative * r - sigma_factor * sigma``, where sigma is the
    standard deviation the measurement came with (zero when it came with none). Ultra-wideband
    reads too long far more often than too short, so `max_error_m` is usually the larger one. A
    reading in single precision, as in ``sensor_msgs/Range``, errs by a further 6e-8 of itself. If
    ``low`` exceeds ``high``, they are swapped.

    Parameters
    ----------
    min_error_m, max_error_m : float
        Least and greatest error in m at any distance.
    min_error_relative, max_error_relative : float
        Least and greatest error as a fraction of the reading.
    sigma_factor : float
        Number of standard deviations to add on both sides; 0 ignores reported variances.
    beyond_max_is_far : bool
        Whether a reading of +inf (REP-117: nothing within ``max_range``) proves that the target
        is farther than ``max_range``. It does not if readings simply get lost.
    expected_error_m : float, optional
        The likeliest error in m, for the best point; None if it is not known.
    expected_error_relative : float
        A further likeliest error as a fraction of the reading.
    min_reading_m, max_reading_m : float
        Finite readings must lie strictly between these, or they are ignored: many radios report 0
        or their largest number if nothing was measured.

    Raises
    ------
    ConfigError
        If a number is not finite or a minimum exceeds its maximum; a relative minimum may do so
        if the constant bounds are apart.

    """

    min_error_m: float = 0.0
    max_error_m: float = 0.0
    min_error_relative: float = -0.03
    max_error_relative: float = 0.03
    sigma_factor: float = 0.0
    beyond_max_is_far: bool = False
    expected_error_m: float | None = None
    expected_error_relative: float = 0.0
    min_reading_m: float = 0.0
    max_reading_m: float = math.inf

    def __post_init__(self) -> None:
        limits = dict.fromkeys((one.name for one in fields(self)), dict[str, Any]())
        limits |= {'sigma_factor': {'at_least': 0.0}, 'max_reading_m': {'finite': False}}
        del limits['beyond_max_is_far']
        keep_numbers(self, 'range.', limits)
        require_kind('range.beyond_max_is_far', self.beyond_max_is_far, bool)
        if self.max_reading_m <= self.min_reading_m:
            least = f'range.min_reading_m, which is {self.min_reading_m!r}'
            raise not_allowed(
                'range.max_reading_m', self.max_reading_m, f'it must be above {least}'
            )
        _require_order('range', self, 'min_error_m', 'max_error_m')
        if self.min_error_m == self.max_error_m:
            _require_order('range', self, 'min_error_relative', 'max_error_relative')
        for name in ('min_error_relative', 'max_error_relative'):
            if getattr(self, name) >= 1.0:
                wanted = 'it must be below 1: the error is a fraction of the reading'
                raise not_allowed(f'range.{name}', getattr(self, name), wanted)


@dataclass(frozen=True)
class AbsoluteErrorModel:
    """
    Bounds of the error of a reading: the reading minus the true value.

    Parameters
    ----------
    min_error_m, max_error_m : float
        Least and greatest error in m.

    Raises
    ------
    ConfigError
        If a number is not finite or the minimum exceeds the maximum.

    """

    GROUP: ClassVar[str] = ''

    min_error_m: float = -0.5
    max_error_m: float = 0.5

    def __post_init__(self) -> None:
        keep_numbers(self, f'{self.GROUP}.', {'min_error_m': {}, 'max_error_m': {}})
        _require_order(self.GROUP, self, 'min_error_m', 'max_error_m')


class ElevationErrorModel(AbsoluteErrorModel):
    """Bounds of the error of an elevation reading."""

    GROUP = 'elevation'


class DifferenceErrorModel(AbsoluteErrorModel):
    """Bounds of the error of a range difference."""

    GROUP = 'range_difference'


def _require_order(
    group: str, model: RangeErrorModel | AbsoluteErrorModel, least: str, greatest: str
) -> None:
    """Raise `ConfigError` if the least error exceeds the greatest."""
    low, high = getattr(model, least), getattr(model, greatest)
    if low > high:
        wanted = f'it must be at most {group}.{greatest}, which is {high!r}'
        raise not_allowed(f'{group}.{least}', low, wanted)


@dataclass(frozen=True)
class SensorBounds:
    """
    Error bounds of the measurements of one sensor, for all targets.

    Parameters
    ----------
    range_error : RangeErrorModel
        Bounds of its ranges.
    bearing_half_width_rad : float
        The greatest angle between its rays and the true directions.
    bearing_expected_error_rad : float
        The likeliest error of its rays about the vertical axis, counterclockwise.
    elevation_error : ElevationErrorModel
        Bounds of its elevations.
    range_difference_error : DifferenceErrorModel
        Bounds of the differences of its distances to two points.

    Raises
    ------
    ConfigError
        If the half width is negative, above pi or not finite, or another value is not
        finite or of a wrong type.

    """

    range_error: RangeErrorModel = RangeErrorModel()
    bearing_half_width_rad: float = 0.05
    bearing_expected_error_rad: float = 0.0
    elevation_error: ElevationErrorModel = ElevationErrorModel()
    range_difference_error: DifferenceErrorModel = DifferenceErrorModel()

    def __post_init__(self) -> None:
        require_kind('range_error', self.range_error, RangeErrorModel)
        require_kind('elevation_error', self.elevation_error, ElevationErrorModel)
        difference_error = self.range_difference_error
        require_kind('range_difference_error', difference_error, DifferenceErrorModel)
        limits = {'bearing_half_width_rad': HALF_TURN, 'bearing_expected_error_rad': {}}
        keep_numbers(self, '', limits)

    def are_within(self, other: SensorBounds) -> bool:
        """Return whether every reading has bounds within those that `other` gives it."""
        both = [(self, other), *zip(vars(self).values(), vars(other).values(), strict=True)]
        # Bounds that cross are swapped, which widens them.
        crossed = self.range_error.min_error_relative > self.range_error.max_error_relative
        return self == other or (all(starmap(are_narrower, both)) and not crossed)


def are_narrower(new: object, old: object) -> bool:
    """Return whether no bound of some settings is wider than that of others."""
    return all(
        sign * getattr(new, name) >= sign * getattr(old, name)
        for name, sign in NARROWER.items()
        if hasattr(new, name)
    )


NARROWER = {
    'min_error_m': 1,
    'max_error_m': -1,
    'min_error_relative': 1,
    'max_error_relative': -1,
    'min_reading_m': -1,
    'max_reading_m': 1,
    'beyond_max_is_far': 1,
    'sigma_factor': -1,
    'bearing_half_width_rad': -1,
    'translation_per_m': -1,
    'translation_per_rad': -1,
    'rotation_per_m': -1,
    'rotation_per_rad': -1,
    'constant_m': -1,
    'constant_rad': -1,
    'latency_s': -1,
    'max_gap_s': 1,
    'restart_gap_s': 1,
    'max_turn_rate_rad_s': -1,
    'stamp_error_s': -1,
    'min_separation_m': 1,
}
"""Whether bounds are narrower where a value is greater (1) or smaller (-1)."""


@dataclass(frozen=True)
class Anchor:
    """
    A point whose coordinates are known.

    Parameters
    ----------
    coordinates_m : tuple of float, length q
        Its coordinates in the fixed frame.
    bound_m : float
        Bound of the distance of the true point from there, in m.

    Raises
    ------
    ConfigError
        If a coordinate or the bound is beyond 1e9 m or not finite, or the bound is negative.

    """

    coordinates_m: tuple[float, ...]
    bound_m: float = 0.0

    def __post_init__(self) -> None:
        keep_numbers(self, 'anchor.', {'bound_m': NOT_FAR})
        coordinates_m = require_coordinates('anchor.coordinates_m', self.coordinates_m)
        keep(self, coordinates_m=coordinates_m)


@dataclass(frozen=True)
class Mount:
    """
    A sensor at a known place on a robot.

    Parameters
    ----------
    position_m : tuple of float, length q
        Its position in the body frame of the robot.
    bound_m : float
        Bound of the distance of the true sensor from there, in m.
    rotation_xyzw : tuple of float, length 4
        Unit quaternion from the sensor frame to the body frame; rays are given in the sensor
        frame.

    Raises
    ------
    ConfigError
        If a coordinate or the bound is beyond 1e9 m or not finite, the bound is negative, or the
        quaternion is not a unit one.

    """

    position_m: tuple[float, ...]
    bound_m: float = 0.0
    rotation_xyzw: tuple[float, ...] = (0.0, 0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        rotation_xyzw = tuple(
            require_number('mount.rotation_xyzw', value)
            for value in require_members('mount.rotation_xyzw', self.rotation_xyzw, 'numbers')
        )
        if len(rotation_xyzw) != 4 or abs(math.hypot(*rotation_xyzw) - 1.0) >= 0.01:
            raise not_allowed('mount.rotation_xyzw', rotation_xyzw, 'it must be a unit quaternion')
        keep_numbers(self, 'mount.', {'bound_m': NOT_FAR})
        position_m = require_coordinates('mount.position_m', self.position_m)
        keep(self, position_m=position_m, rotation_xyzw=rotation_xyzw)


def checked_anchors(anchors: Mapping[str, Anchor], dimension: int) -> Mapping[str, Anchor]:
    """Return a read-only copy of anchors; raise `ConfigError` on a wrong one."""
    checked = require_mapping('anchors', anchors)
    for name, anchor in checked.items():
        require_name('anchors', name)
        require_kind(f'anchors[{name}]', anchor, Anchor)
        _require_dimension(f'anchors[{name}].coordinates_m', anchor.coordinates_m, dimension)
    return checked


def checked_mounts(
    mounts: Mapping[str, Mapping[str, Mount | tuple[float, ...]]],
    robots: Collection[str],
    dimension: int,
) -> Mapping[str, Mapping[str, Mount | tuple[float, ...]]]:
    """Return a read-only copy of the sensors of each robot; raise `ConfigError` on a wrong one."""
    checked = {}
    for robot, sensors in require_mapping('mounts', mounts).items():
        require_one_of('mounts', robot, robots)
        places: dict[str, Mount | tuple[float, ...]] = {}
        for name, mount in require_mapping(f'mounts[{robot}]', sensors).items():
            if not isinstance(name, str) or not name or '/' in name:
                raise not_allowed(
                    f'mounts[{robot}]', name, 'a sensor needs a name without a slash'
                )
            position_m = (mount if isinstance(mount, Mount) else Mount(mount)).position_m
            _require_dimension(f'mounts[{robot}][{name}].position_m', position_m, dimension)
            places[name] = mount if isinstance(mount, Mount) else position_m
        checked[robot] = MappingProxyType(places)
    return MappingProxyType(checked)


def _require_dimension(name: str, position_m: tuple[float, ...], dimension: int) -> None:
    """Raise `ConfigError` unless a position has as many coordinates as space."""
    if len(position_m) != dimension:
        raise not_allowed(name, position_m, f'it must have {dimension} coordinates (dimension)')


def checked_elevations(
    elevations_m: Mapping[str, tuple[float, ...]], points: Collection[str], dimension: int
) -> Mapping[str, tuple[float, ...]]:
    """Return a read-only copy of the elevation bounds; raise `ConfigError` on a wrong one."""
    checked = {}
    for point, bounds_m in require_mapping('elevations_m', elevations_m).items():
        if dimension != 2:
            wanted = 'it must be none in space, where points have coordinates of their own'
            raise not_allowed('elevations_m', point, wanted)
        require_one_of('elevations_m', point, points)
        name = f'elevations_m[{point}]'
        checked[point] = require_coordinates(name, bounds_m)
        if len(checked[point]) != 2 or checked[point][0] > checked[point][1]:
            raise not_allowed(name, bounds_m, 'it must be the least and the greatest elevation')
    return MappingProxyType(checked)
