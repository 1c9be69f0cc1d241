# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What a fleet is and how wrong its sensors may be: the validated settings of the fleet room.

Every dataclass here is frozen and checks itself when made. A wrong value raises `ConfigError`,
whose message names the field, the value, and what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
import math
from types import MappingProxyType

from dg_localization.fleet.checks import ConfigError, require_integer, require_number
from dg_localization.fleet.odometry import OdometryErrorModel
from dg_localization.solver.options import SolverOptions


@dataclass(frozen=True)
class RangeErrorModel:
    """
    Bounds of the error of a range, which is the reading minus the true distance.

    A reading r means a true distance in ``[r - high, r - low]`` with
    ``high = max_error_m + max_error_relative * r + sigma_factor * sigma`` and
    ``low = min_error_m + min_error_relative * r - sigma_factor * sigma``, where sigma is the
    standard deviation the measurement came with (zero when it came with none). Ultra-wideband
    reads too long far more often than too short, so `max_error_m` is usually the larger one. A
    reading in single precision, as in ``sensor_msgs/Range``, is off by another 6e-8 of it.

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

    Raises
    ------
    ConfigError
        If a number is not finite or a minimum exceeds its maximum.

    """

    min_error_m: float = 0.0
    max_error_m: float = 0.0
    min_error_relative: float = -0.03
    max_error_relative: float = 0.03
    sigma_factor: float = 0.0
    beyond_max_is_far: bool = False
    expected_error_m: float | None = None

    def __post_init__(self) -> None:
        for name in ('min_error_m', 'max_error_m', 'min_error_relative', 'max_error_relative'):
            require_number(f'range.{name}', getattr(self, name))
        require_number('range.sigma_factor', self.sigma_factor, at_least=0.0)
        if self.expected_error_m is not None:
            require_number('range.expected_error_m', self.expected_error_m)
        for low, high in (
            ('min_error_m', 'max_error_m'),
            ('min_error_relative', 'max_error_relative'),
        ):
            if getattr(self, low) > getattr(self, high):
                raise ConfigError(
                    f'range.{low}: {getattr(self, low)!r} is not allowed, it must be at most '
                    f'range.{high}, which is {getattr(self, high)!r}'
                )
        if self.max_error_relative >= 1.0:
            raise ConfigError(
                f'range.max_error_relative: {self.max_error_relative!r} is not allowed, it must '
                'be below 1: the error is a fraction of the reading'
            )


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
        name = f'links[{self.observer}->{self.target}]'
        for part, least in (('half_width', 0.0), ('expected_error', -math.pi)):
            value = getattr(self, f'bearing_{part}_rad')
            if value is not None:
                require_number(
                    f'{name}.bearing_{part}_rad', value, at_least=least, at_most=math.pi
                )


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
        If a coordinate is not finite or the bound is negative.

    """

    coordinates_m: tuple[float, ...]
    bound_m: float = 0.0

    def __post_init__(self) -> None:
        for value in self.coordinates_m:
            require_number('anchor.coordinates_m', value)
        object.__setattr__(self, 'coordinates_m', tuple(float(v) for v in self.coordinates_m))
        require_number('anchor.bound_m', self.bound_m, at_least=0.0)


@dataclass(frozen=True)
class FleetConfig:
    """
    Everything the fleet room needs to know before the first measurement.

    Parameters
    ----------
    robots : tuple of str
        Names of the robots; the order of all rows of an estimate.
    dimension : {2, 3}
        Dimension q of the space the robots move in.
    reference_robot : str
        The robot whose frame is the fixed frame when the anchors do not give one; empty means
        the first of `robots`.
    max_age_s : float
        Older measurements are not used.
    max_future_s : float
        How far a stamp may lie ahead of the clock.
    max_repeats : int
        How many of the newest readings of one link are kept and intersected.
    range_error : RangeErrorModel
        Error bounds of every range that no override names.
    bearing_half_width_rad : float
        Greatest angle between a measured ray and the true direction.
    bearing_expected_error_rad : float
        The likeliest error of a ray about the vertical axis, counterclockwise, for the best point.
    links : tuple of LinkOverride
        Links with error bounds of their own.
    anchors : mapping of str to Anchor
        Points of known coordinates. A name that is also in `robots` is a parked robot, any other
        is a landmark. Anchors do not move.
    max_speed_m_s : float
        No robot moves faster. It determines how much the bounds of an old measurement widen.
    robot_max_speed_m_s : mapping of str to float
        Speeds of the robots that differ from it.
    max_turn_rate_rad_s : float
        No robot turns faster. It determines how much the half width of an old bearing grows.
    min_separation_m : float
        No two robots come nearer than this, for example their size. Bearings between moving
        robots without a range need it: the direction to a very near point may turn at once.
    odometry_relative_error : float
        Greatest error of odometry between two of its stamps, as a fraction of the path and of the
        turn at full speed in that time.
    odometry_error : OdometryErrorModel
        Greatest errors of odometry along its path, which carry what is remembered to now.
    memory_s : float
        How long measurements between points with odometry, and with anchors, are remembered; 0
        remembers nothing.
    memory_max_seconds : float
        How long an estimate may spend on what is remembered; infinity sets no limit.
    window_outliers : int
        So many of the measurements of any two bodies in that time may be wrong.
    max_hypotheses : int
        How many placements an estimate lists.
    max_outliers : int
        How many contradicting links may be dropped to get an answer. The answer is the union over
        all minimal sets of links whose removal makes the rest agree.
    max_conflict_solves : int
        How many problems may be solved to explain one contradiction; 0 explains none.
    max_conflict_seconds : float
        How long the explanation may take in all; infinity sets no limit.
    solver : SolverOptions
        Resolution and budget of the solver.

    Raises
    ------
    ConfigError
        If a value is out of its range, or a name is unknown or repeated.

    """

    robots: tuple[str, ...]
    dimension: int = 2
    reference_robot: str = ''
    max_age_s: float = 1.0
    max_future_s: float = 0.1
    max_repeats: int = 8
    range_error: RangeErrorModel = RangeErrorModel()
    bearing_half_width_rad: float = 0.05
    bearing_expected_error_rad: float = 0.0
    links: tuple[LinkOverride, ...] = ()
    anchors: Mapping[str, Anchor] = field(default_factory=dict)
    max_speed_m_s: float = 1.0
    robot_max_speed_m_s: Mapping[str, float] = field(default_factory=dict)
    max_turn_rate_rad_s: float = 1.0
    min_separation_m: float = 0.0
    odometry_relative_error: float = 0.05
    odometry_error: OdometryErrorModel = OdometryErrorModel(
        translation_per_m=0.1,
        rotation_per_m=0.02,
        rotation_per_rad=0.1,
        constant_m=0.02,
        constant_rad=0.02,
    )
    memory_s: float = 30.0
    memory_max_seconds: float = 0.15
    window_outliers: int = 0
    max_hypotheses: int = 64
    max_outliers: int = 0
    max_conflict_solves: int = 200
    max_conflict_seconds: float = 2.0
    solver: SolverOptions = field(default_factory=SolverOptions)

    def __post_init__(self) -> None:
        object.__setattr__(self, 'robots', tuple(self.robots))
        object.__setattr__(self, 'links', tuple(self.links))
        object.__setattr__(self, 'anchors', MappingProxyType(dict(self.anchors)))
        object.__setattr__(
            self, 'robot_max_speed_m_s', MappingProxyType(dict(self.robot_max_speed_m_s))
        )
        self._check_names()
        self._check_numbers()
        self._check_anchors()

    def _check_names(self) -> None:
        """Raise `ConfigError` on a repeated, missing or unknown name."""
        if not self.robots:
            raise ConfigError('robots: () is not allowed, it must name at least one robot')
        for name in self.robots:
            if not isinstance(name, str) or not name:
                raise ConfigError(f'robots: {name!r} is not allowed, names must not be empty')
            if self.robots.count(name) > 1:
                raise ConfigError(f'robots: {name!r} is repeated, each robot must be named once')
        if not self.reference_robot:
            object.__setattr__(self, 'reference_robot', self.robots[0])
        if self.reference_robot not in self.robots:
            raise ConfigError(
                f'reference_robot: {self.reference_robot!r} is not allowed, it must be one of '
                f'{list(self.robots)}'
            )
        for name in self.robot_max_speed_m_s:
            if name not in self.robots:
                raise ConfigError(
                    f'robot_max_speed_m_s: {name!r} is not allowed, it must be one of '
                    f'{list(self.robots)}'
                )
        self._check_links()

    def _check_links(self) -> None:
        """Raise `ConfigError` on an override of an unknown or repeated link."""
        for link in self.links:
            for name in (link.observer, link.target):
                if name not in self.points:
                    raise ConfigError(
                        f'links: {name!r} is not allowed, it must be one of {list(self.points)}'
                    )
            if link.observer == link.target:
                raise ConfigError(
                    f'links: {link.observer}->{link.target} is not allowed, a link must join two '
                    'different points'
                )
        if len(self._overrides) < len(self.links):
            names = [f'{link.observer}->{link.target}' for link in self.links]
            raise ConfigError(f'links: {names} is not allowed, each link must be named once')

    def _check_numbers(self) -> None:
        """Raise `ConfigError` on a number out of its range."""
        if self.dimension not in (2, 3):
            raise ConfigError(f'dimension: {self.dimension!r} is not allowed, it must be 2 or 3')
        for name in ('max_age_s', 'max_future_s', 'max_turn_rate_rad_s', 'memory_s'):
            require_number(name, getattr(self, name), at_least=0.0)
        for name in ('max_conflict_seconds', 'memory_max_seconds'):
            require_number(name, getattr(self, name), at_least=0.0, finite=False)
        require_number('max_speed_m_s', self.max_speed_m_s, at_least=0.0)
        for robot, speed in self.robot_max_speed_m_s.items():
            require_number(f'robot_max_speed_m_s[{robot}]', speed, at_least=0.0)
        require_number(
            'bearing_half_width_rad', self.bearing_half_width_rad, at_least=0.0, at_most=math.pi
        )
        require_number('bearing_expected_error_rad', self.bearing_expected_error_rad)
        require_number('min_separation_m', self.min_separation_m, at_least=0.0)
        require_number('odometry_relative_error', self.odometry_relative_error, at_least=0.0)
        require_integer('max_repeats', self.max_repeats, 1)
        require_integer('max_hypotheses', self.max_hypotheses, 1)
        require_integer('max_outliers', self.max_outliers, 0)
        require_integer('window_outliers', self.window_outliers, 0)
        require_integer('max_conflict_solves', self.max_conflict_solves, 0)

    def _check_anchors(self) -> None:
        """Raise `ConfigError` on an anchor without a name or of another dimension."""
        for name, anchor in self.anchors.items():
            if not isinstance(name, str) or not name:
                raise ConfigError(f'anchors: {name!r} is not allowed, names must not be empty')
            if len(anchor.coordinates_m) != self.dimension:
                raise ConfigError(
                    f'anchors[{name}].coordinates_m: {anchor.coordinates_m!r} is not allowed, it '
                    f'must have {self.dimension} coordinates (dimension)'
                )

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Names of the anchors that are not robots, in their given order."""
        return tuple(name for name in self.anchors if name not in self.robots)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of all points of the problem: the robots, then the landmarks."""
        return self.robots + self.landmarks

    def speed_m_s(self, point: str) -> float:
        """Return the greatest speed of `point` in m/s; an anchor has none."""
        if point in self.anchors:
            return 0.0
        return float(self.robot_max_speed_m_s.get(point, self.max_speed_m_s))

    @cached_property
    def _overrides(self) -> dict[tuple[str, str], LinkOverride]:
        """Return the overrides by (observer, target)."""
        return {(link.observer, link.target): link for link in self.links}

    def range_error_of(self, observer: str, target: str) -> RangeErrorModel:
        """Return the error bounds of ranges from `observer` to `target`."""
        override = self._overrides.get((observer, target))
        return override.range_error if override and override.range_error else self.range_error

    def bearing_half_width_of(self, observer: str, target: str) -> float:
        """Return the greatest angle in rad between a ray of this link and the truth."""
        override = self._overrides.get((observer, target))
        if override is None or override.bearing_half_width_rad is None:
            return self.bearing_half_width_rad
        return override.bearing_half_width_rad

    def bearing_expected_error_of(self, observer: str, target: str) -> float:
        """Return the likeliest error in rad of a ray of this link."""
        override = self._overrides.get((observer, target))
        if override is None or override.bearing_expected_error_rad is None:
            return self.bearing_expected_error_rad
        return override.bearing_expected_error_rad
