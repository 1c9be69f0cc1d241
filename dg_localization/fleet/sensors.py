# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What is known of sensors and anchors: error bounds, and where they are.

Every dataclass here is frozen and checks itself when made. A wrong value raises `ConfigError`,
whose message names the field, the value, and what would be right.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
import math
from types import MappingProxyType

from dg_localization.fleet.checks import (
    FARTHEST_M,
    ConfigError,
    keep,
    require_coordinate,
    require_kind,
    require_mapping,
    require_members,
    require_name,
    require_number,
)


@dataclass(frozen=True)
class RangeErrorModel:
    """
    Bounds of the error of a range, which is the reading minus the true distance.

    A reading r means a true distance in ``[r - high, r - low]`` with
    ``high = max_error_m + max_error_relative * r + sigma_factor * sigma`` and
    ``low = min_error_m + min_error_relative * r - sigma_factor * sigma``, where sigma is the
    standard deviation the measurement came with (zero when it came with none). Ultra-wideband
    reads too long far more often than too short, so `max_error_m` is usually the larger one. A
    reading in single precision, as in ``sensor_msgs/Range``, is off by another 6e-8 of it. Where
    ``low`` exceeds ``high`` they change places.

    Parameters
    ----------
    min_error_m, max_error_m : float
        Least and greatest error in m, whatever the distance.
    min_error_relative, max_error_relative : float
        Least and greatest error as a fraction of the reading.
    sigma_factor : float
        How many standard deviations to add on both sides; 0 ignores reported variances.
    beyond_max_is_far : bool
        Whether a reading of +inf (REP-117: nothing within ``max_range``) proves that the target
        is farther than ``max_range``. It does not when readings simply get lost.
    expected_error_m : float, optional
        The likeliest error in m, for the best point; None where it is not known.
    expected_error_relative : float
        What is added to it as a fraction of the reading.
    min_reading_m, max_reading_m : float
        A finite reading that is not between them says nothing, nor does one that is equal to
        either: many radios report 0 or the largest number they have where nothing was measured.

    Raises
    ------
    ConfigError
        If a number is not finite or a minimum exceeds its maximum; relative ones may do so where
        the constant ones are apart.

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
        for name in (
            *('min_error_m', 'max_error_m', 'min_error_relative', 'max_error_relative'),
            'expected_error_relative',
            'min_reading_m',
        ):
            keep(self, **{name: require_number(f'range.{name}', getattr(self, name))})
        sigma_factor = require_number('range.sigma_factor', self.sigma_factor, at_least=0.0)
        keep(self, sigma_factor=sigma_factor)
        require_kind('range.beyond_max_is_far', self.beyond_max_is_far, bool)
        if self.expected_error_m is not None:
            expected_error_m = require_number('range.expected_error_m', self.expected_error_m)
            keep(self, expected_error_m=expected_error_m)
        if self.max_reading_m != math.inf:
            most_m = require_number('range.max_reading_m', self.max_reading_m)
            keep(self, max_reading_m=most_m)
        if self.max_reading_m <= self.min_reading_m:
            raise ConfigError(
                f'range.max_reading_m: {self.max_reading_m!r} is not allowed, it must be above '
                f'range.min_reading_m, which is {self.min_reading_m!r}'
            )
        _require_order('range', self, 'min_error_m', 'max_error_m')
        if self.min_error_m == self.max_error_m:
            _require_order('range', self, 'min_error_relative', 'max_error_relative')
        for name in ('min_error_relative', 'max_error_relative'):
            if getattr(self, name) >= 1.0:
                raise ConfigError(
                    f'range.{name}: {getattr(self, name)!r} is not allowed, it must be below 1: '
                    'the error is a fraction of the reading'
                )


@dataclass(frozen=True)
class ElevationErrorModel:
    """
    Bounds of the error of an elevation that is read: the reading minus the true elevation.

    Parameters
    ----------
    min_error_m, max_error_m : float
        Least and greatest error in m.

    Raises
    ------
    ConfigError
        If a number is not finite or the minimum exceeds the maximum.

    """

    min_error_m: float = -0.5
    max_error_m: float = 0.5

    def __post_init__(self) -> None:
        for name in ('min_error_m', 'max_error_m'):
            keep(self, **{name: require_number(f'elevation.{name}', getattr(self, name))})
        _require_order('elevation', self, 'min_error_m', 'max_error_m')


def _require_order(
    group: str, model: RangeErrorModel | ElevationErrorModel, least: str, greatest: str
) -> None:
    """Raise `ConfigError` where the least of two errors exceeds the greatest."""
    low, high = getattr(model, least), getattr(model, greatest)
    if low > high:
        raise ConfigError(
            f'{group}.{least}: {low!r} is not allowed, it must be at most {group}.{greatest}, '
            f'which is {high!r}'
        )


@dataclass(frozen=True)
class SensorBounds:
    """
    Error bounds of what one sensor measures, whoever its targets are.

    Parameters
    ----------
    range_error : RangeErrorModel
        Of its ranges.
    bearing_half_width_rad : float
        The greatest angle between its rays and the truth.

    Raises
    ------
    ConfigError
        If the half width is negative, above pi or not finite.

    """

    range_error: RangeErrorModel
    bearing_half_width_rad: float

    def __post_init__(self) -> None:
        require_kind('bounds.range_error', self.range_error, RangeErrorModel)
        half_width_rad = require_number(
            'bounds.bearing_half_width_rad',
            self.bearing_half_width_rad,
            at_least=0.0,
            at_most=math.pi,
        )
        keep(self, bearing_half_width_rad=half_width_rad)


@dataclass(frozen=True)
class LinkOverride:
    """
    Error bounds of one link that differ from those of the fleet.

    Parameters
    ----------
    observer, target : str
        Who measures whom, as in the names of the measurements.
    range_error : RangeErrorModel, optional
        Replaces the model of the fleet for ranges of this link.
    bearing_half_width_rad : float, optional
        Replaces the half width of the fleet for bearings of this link.
    bearing_expected_error_rad : float, optional
        Replaces the likeliest error of the fleet for bearings of this link.

    Raises
    ------
    ConfigError
        If the half width is negative, above pi or not finite.

    """

    observer: str
    target: str
    range_error: RangeErrorModel | None = None
    bearing_half_width_rad: float | None = None
    bearing_expected_error_rad: float | None = None

    def __post_init__(self) -> None:
        link = f'links[{self.observer}->{self.target}]'
        if self.range_error is not None:
            require_kind(f'{link}.range_error', self.range_error, RangeErrorModel)
        for name, least in (
            ('bearing_half_width_rad', 0.0),
            ('bearing_expected_error_rad', -math.pi),
        ):
            value = getattr(self, name)
            if value is not None:
                bound = require_number(f'{link}.{name}', value, at_least=least, at_most=math.pi)
                keep(self, **{name: bound})


@dataclass(frozen=True)
class Anchor:
    """
    A point whose coordinates are known.

    Parameters
    ----------
    coordinates_m : tuple of float, length q
        Where it is, in the fixed frame.
    bound_m : float
        How far the true point may be from there, in m.

    Raises
    ------
    ConfigError
        If a coordinate or the bound is beyond 1e9 m or not finite, or the bound is negative.

    """

    coordinates_m: tuple[float, ...]
    bound_m: float = 0.0

    def __post_init__(self) -> None:
        bound_m = require_number('anchor.bound_m', self.bound_m, at_least=0.0, at_most=FARTHEST_M)
        keep(
            self,
            coordinates_m=_coordinates('anchor.coordinates_m', self.coordinates_m),
            bound_m=bound_m,
        )


@dataclass(frozen=True)
class Mount:
    """
    A sensor at a known place on a robot.

    Parameters
    ----------
    position_m : tuple of float, length q
        Where it is in the body frame of the robot.
    bound_m : float
        How far the sensor may be from there, in m.
    rotation_xyzw : tuple of float, length 4
        Unit quaternion from the frame of the sensor to that of the body: rays are given in the
        frame of the sensor that sees them.

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
        bound_m = require_number('mount.bound_m', self.bound_m, at_least=0.0, at_most=FARTHEST_M)
        if len(rotation_xyzw) != 4 or abs(math.hypot(*rotation_xyzw) - 1.0) >= 0.01:
            raise ConfigError(
                f'mount.rotation_xyzw: {rotation_xyzw!r} is not allowed, it must be a unit '
                'quaternion'
            )
        keep(
            self,
            position_m=_coordinates('mount.position_m', self.position_m),
            bound_m=bound_m,
            rotation_xyzw=rotation_xyzw,
        )


def _coordinates(name: str, values: object) -> tuple[float, ...]:
    """Return coordinates in m as floats; raise `ConfigError` where they are none."""
    listed = require_members(name, values, 'numbers')
    return tuple(require_coordinate(name, value) for value in listed)


def check_links(
    links: Collection[LinkOverride], points: Collection[str], robot_of: Callable[[str], str]
) -> None:
    """Raise `ConfigError` on an override of an unknown or repeated link."""
    names = set()
    for link in links:
        name = f'{link.observer}->{link.target}'
        if name in names:
            raise ConfigError(f'links: {name} is not allowed twice, each link must be named once')
        names.add(name)
        for point in (link.observer, link.target):
            if point not in points:
                raise ConfigError(
                    f'links: {point!r} is not allowed, it must be one of {list(points)}'
                )
        if link.observer == link.target:
            raise ConfigError(
                f'links: {name} is not allowed, a link must join two different points'
            )
        robot = robot_of(link.observer)
        if robot == robot_of(link.target):
            raise ConfigError(
                f'links: {name} is not allowed, both are on robot {robot!r}: a link must join '
                'points of two robots or anchors'
            )


def checked_anchors(anchors: Mapping[str, Anchor], dimension: int) -> Mapping[str, Anchor]:
    """
    Return anchors in a copy that nobody can change.

    Raises
    ------
    ConfigError
        Where one has no name, or is of another dimension.

    """
    checked = require_mapping('anchors', anchors)
    for name, anchor in checked.items():
        require_name('anchors', name)
        require_kind(f'anchors[{name}]', anchor, Anchor)
        if len(anchor.coordinates_m) != dimension:
            raise ConfigError(
                f'anchors[{name}].coordinates_m: {anchor.coordinates_m!r} is not allowed, it '
                f'must have {dimension} coordinates (dimension)'
            )
    return checked


def checked_mounts(
    mounts: Mapping[str, Mapping[str, Mount | tuple[float, ...]]],
    robots: Collection[str],
    dimension: int,
) -> Mapping[str, Mapping[str, Mount | tuple[float, ...]]]:
    """
    Return the sensors of each robot in a copy that nobody can change.

    Raises
    ------
    ConfigError
        Where a sensor has no name or no robot, or is of another dimension.

    """
    checked = {}
    for robot, sensors in require_mapping('mounts', mounts).items():
        if robot not in robots:
            raise ConfigError(
                f'mounts: {robot!r} is not allowed, it must be one of {list(robots)}'
            )
        places: dict[str, Mount | tuple[float, ...]] = {}
        for name, mount in require_mapping(f'mounts[{robot}]', sensors).items():
            if not isinstance(name, str) or not name or '/' in name:
                raise ConfigError(
                    f'mounts[{robot}]: {name!r} is not allowed, a sensor needs a name without a '
                    'slash'
                )
            position_m = (mount if isinstance(mount, Mount) else Mount(mount)).position_m
            if len(position_m) != dimension:
                raise ConfigError(
                    f'mounts[{robot}][{name}].position_m: {position_m!r} is not allowed, it must '
                    f'have {dimension} coordinates (dimension)'
                )
            places[name] = mount if isinstance(mount, Mount) else position_m
        checked[robot] = MappingProxyType(places)
    return MappingProxyType(checked)


def checked_elevations(
    elevations_m: Mapping[str, tuple[float, ...]], points: Collection[str], dimension: int
) -> Mapping[str, tuple[float, ...]]:
    """
    Return the least and the greatest elevation of points, in a copy that nobody can change.

    Raises
    ------
    ConfigError
        Where elevations are of unknown points, reversed, or in space.

    """
    checked = {}
    for point, bounds_m in require_mapping('elevations_m', elevations_m).items():
        if dimension != 2 or point not in points:
            wanted = 'none in space, where points have coordinates of their own'
            if dimension == 2:
                wanted = f'one of {list(points)}'
            raise ConfigError(f'elevations_m: {point!r} is not allowed, it must be {wanted}')
        name = f'elevations_m[{point}]'
        checked[point] = _coordinates(name, bounds_m)
        if len(checked[point]) != 2 or checked[point][0] > checked[point][1]:
            raise ConfigError(
                f'{name}: {bounds_m!r} is not allowed, it must be the least and the greatest '
                'elevation'
            )
    return MappingProxyType(checked)


def check_elevation_errors(
    errors: Mapping[str, ElevationErrorModel], elevations_m: Mapping[str, tuple[float, ...]]
) -> None:
    """Raise `ConfigError` on errors that are none, or of points without a stated elevation."""
    for point, error in errors.items():
        if point not in elevations_m:
            raise ConfigError(
                f'point_elevation_error: {point!r} is not allowed, it must be named in '
                'elevations_m, with the least and the greatest elevation that it can have'
            )
        require_kind(f'point_elevation_error[{point}]', error, ElevationErrorModel)
