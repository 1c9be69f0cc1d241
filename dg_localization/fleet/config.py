# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What a fleet is: the validated settings of the fleet room.

The dataclass is frozen and checks itself when made. A wrong value raises `ConfigError`, whose
message names the field, the value, and what would be right.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
import math
from types import MappingProxyType

from dg_localization.fleet.checks import ConfigError, require_integer, require_number
from dg_localization.fleet.contradictions.suspects import SuspectKind
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.sensors import (
    Anchor,
    ElevationErrorModel,
    LinkOverride,
    Mount,
    RangeErrorModel,
    check_elevation_errors,
    check_elevations,
    check_mounts,
)
from dg_localization.interval.bounds import product_up, sum_up
from dg_localization.solver.options import SolverOptions

LEAST_MEMORY_S = 0.001
"""A shorter memory remembers nothing, and its time slots are shorter than a stamp resolves."""

OF_ROBOTS = ('robot_max_speed_m_s', 'robot_odometry_error')
"""Settings of single robots, by their names."""


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
    stamp_error_s : float
        How far any stamp may be from when it was true, by the clock that estimates are made at:
        clocks of robots differ. Equal stamps of one robot are one time.
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
    mounts : mapping of str to mapping of str to Mount
        The sensors of each robot by their names, a `Mount` or its position alone. The sensor
        ``left`` of ``r1`` is the point ``r1/left``; ``r1`` itself is the origin of its body frame.
    elevations_m : mapping of str to tuple of float
        Least and greatest elevation of points in the plane, whose ranges are then those between
        their projections. A sensor without one has that of its robot; what is not named is at 0.
    elevation_error : ElevationErrorModel
        Error bounds of every elevation that is read, at points that `elevations_m` names.
    point_elevation_error : mapping of str to ElevationErrorModel
        Those of the points that differ from it.
    max_speed_m_s : float
        No robot moves faster. It determines how much the bounds of an old measurement widen.
    robot_max_speed_m_s : mapping of str to float
        Speeds of the robots that differ from it.
    max_turn_rate_rad_s : float
        No robot turns faster. It determines how much the half width of an old bearing grows.
    min_separation_m : float
        No two robots come nearer than this, for example their size. Bearings between moving
        robots without a range need it: the direction to a very near point may turn at once.
    odometry_error : OdometryErrorModel
        Greatest errors of odometry along its path, which carry older measurements to now.
    robot_odometry_error : mapping of str to OdometryErrorModel
        Those of the robots that differ from it.
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
        How many contradicting observations may be dropped to get an answer. The answer is the
        union over all minimal sets of them whose removal makes the rest agree.
    outlier_unit : SuspectKind
        What counts as one of them: an observation, a whole sensor, or a whole robot.
    stuck_readings : int
        So many readings in a row that are equal to the last bit are called stuck, where the robots
        moved meanwhile; ten times as many where there is no odometry. 0 calls none so.
    drop_stuck : bool
        Whether they are dropped.
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
    stamp_error_s: float = 0.0
    max_future_s: float = 0.1
    max_repeats: int = 8
    range_error: RangeErrorModel = RangeErrorModel()
    bearing_half_width_rad: float = 0.05
    bearing_expected_error_rad: float = 0.0
    links: tuple[LinkOverride, ...] = ()
    anchors: Mapping[str, Anchor] = field(default_factory=dict)
    mounts: Mapping[str, Mapping[str, Mount | tuple[float, ...]]] = field(default_factory=dict)
    elevations_m: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    elevation_error: ElevationErrorModel = ElevationErrorModel()
    point_elevation_error: Mapping[str, ElevationErrorModel] = field(default_factory=dict)
    max_speed_m_s: float = 1.0
    robot_max_speed_m_s: Mapping[str, float] = field(default_factory=dict)
    max_turn_rate_rad_s: float = 1.0
    min_separation_m: float = 0.0
    odometry_error: OdometryErrorModel = OdometryErrorModel(
        translation_per_m=0.1,
        rotation_per_m=0.02,
        rotation_per_rad=0.1,
        constant_m=0.02,
        constant_rad=0.02,
    )
    robot_odometry_error: Mapping[str, OdometryErrorModel] = field(default_factory=dict)
    memory_s: float = 30.0
    memory_max_seconds: float = 0.15
    window_outliers: int = 0
    max_hypotheses: int = 64
    max_outliers: int = 0
    outlier_unit: SuspectKind = SuspectKind.OBSERVATION
    stuck_readings: int = 20
    drop_stuck: bool = False
    max_conflict_solves: int = 200
    max_conflict_seconds: float = 2.0
    solver: SolverOptions = field(default_factory=SolverOptions)

    def __post_init__(self) -> None:
        object.__setattr__(self, 'robots', tuple(self.robots))
        object.__setattr__(self, 'links', tuple(self.links))
        object.__setattr__(self, 'anchors', MappingProxyType(dict(self.anchors)))
        object.__setattr__(self, 'mounts', _frozen_mounts(self.mounts))
        elevations_m = {point: tuple(bounds_m) for point, bounds_m in self.elevations_m.items()}
        object.__setattr__(self, 'elevations_m', MappingProxyType(elevations_m))
        for name in (*OF_ROBOTS, 'point_elevation_error'):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))
        check_mounts(self.mounts, self.robots, self.dimension)
        self._check_names()
        self._check_numbers()
        self._check_anchors()
        check_elevations(self.elevations_m, self.points, self.dimension)
        check_elevation_errors(self.point_elevation_error, self.elevations_m)

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
        for name in self.points:
            if self.points.count(name) > 1:
                raise ConfigError(
                    f'points: {name!r} is not allowed twice, robots, anchors and sensors '
                    '(robot/sensor) must have different names'
                )
        for setting in OF_ROBOTS:
            for name in getattr(self, setting):
                if name not in self.robots:
                    raise ConfigError(
                        f'{setting}: {name!r} is not allowed, it must be one of '
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
            robot = self.robot_of(link.observer)
            if robot == self.robot_of(link.target):
                raise ConfigError(
                    f'links: {link.observer}->{link.target} is not allowed, both are on robot '
                    f'{robot!r}: a link must join points of two robots or anchors'
                )
        if len(self._overrides) < len(self.links):
            names = [f'{link.observer}->{link.target}' for link in self.links]
            raise ConfigError(f'links: {names} is not allowed, each link must be named once')

    def _check_numbers(self) -> None:
        """Raise `ConfigError` on a number out of its range."""
        if self.dimension not in (2, 3):
            raise ConfigError(f'dimension: {self.dimension!r} is not allowed, it must be 2 or 3')
        for name in ('max_age_s', 'max_future_s', 'stamp_error_s', 'memory_s'):
            require_number(name, getattr(self, name), at_least=0.0)
        require_number('max_turn_rate_rad_s', self.max_turn_rate_rad_s, at_least=0.0)
        for name in ('max_conflict_seconds', 'memory_max_seconds'):
            require_number(name, getattr(self, name), at_least=0.0, finite=False)
        if 0.0 < self.memory_s < LEAST_MEMORY_S:
            raise ConfigError(
                f'memory_s: {self.memory_s!r} is not allowed, it must be 0, which remembers '
                f'nothing, or >= {LEAST_MEMORY_S:g}'
            )
        require_number('max_speed_m_s', self.max_speed_m_s, at_least=0.0)
        for robot, speed in self.robot_max_speed_m_s.items():
            require_number(f'robot_max_speed_m_s[{robot}]', speed, at_least=0.0)
        for robot, error in self.robot_odometry_error.items():
            if not isinstance(error, OdometryErrorModel):
                raise ConfigError(
                    f'robot_odometry_error[{robot}]: {error!r} is not allowed, it must be an '
                    'OdometryErrorModel'
                )
        require_number(
            'bearing_half_width_rad', self.bearing_half_width_rad, at_least=0.0, at_most=math.pi
        )
        require_number('bearing_expected_error_rad', self.bearing_expected_error_rad)
        require_number('min_separation_m', self.min_separation_m, at_least=0.0)
        require_integer('max_repeats', self.max_repeats, 1)
        require_integer('max_hypotheses', self.max_hypotheses, 1)
        require_integer('max_outliers', self.max_outliers, 0)
        require_integer('window_outliers', self.window_outliers, 0)
        require_integer('stuck_readings', self.stuck_readings, 0)
        require_integer('max_conflict_solves', self.max_conflict_solves, 0)
        if self.outlier_unit not in set(SuspectKind):
            raise ConfigError(
                f'outlier_unit: {self.outlier_unit!r} is not allowed, it must be one of '
                f'{[str(kind) for kind in SuspectKind]}'
            )
        object.__setattr__(self, 'outlier_unit', SuspectKind(self.outlier_unit))

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

    @cached_property
    def points(self) -> tuple[str, ...]:
        """Names of all points of the problem: the robots, the landmarks, and the sensors."""
        return (*self.robots, *self.landmarks, *self.sensors)

    @cached_property
    def sensors(self) -> dict[str, Mount]:
        """The sensors of all robots by the names of their points."""
        return {
            f'{robot}/{name}': mount if isinstance(mount, Mount) else Mount(mount)
            for robot, mounts in self.mounts.items()
            for name, mount in mounts.items()
        }

    def robot_of(self, point: str) -> str:
        """Return the robot that a sensor is mounted on, and any other point itself."""
        return point.rpartition('/')[0] if point in self.sensors else point

    def points_on(self, body: str) -> tuple[str, ...]:
        """Return a robot or an anchor with its sensors."""
        return (body, *(f'{body}/{name}' for name in self.mounts.get(body, ())))

    def elevation_m(self, point: str) -> tuple[float, float]:
        """Return the least and the greatest elevation of a point in the plane."""
        low_m, high_m = self.elevations_m.get(self.elevated(point), (0.0, 0.0))
        return low_m, high_m

    def elevated(self, point: str) -> str:
        """Return whose elevation a point has: its own, or that of its robot."""
        return point if point in self.elevations_m else self.robot_of(point)

    def elevation_error_of(self, point: str) -> ElevationErrorModel:
        """Return the error bounds of the elevations that are read at a point."""
        return self.point_elevation_error.get(point, self.elevation_error)

    def speed_m_s(self, robot: str) -> float:
        """Return the greatest speed of a robot in m/s; an anchor has none."""
        if robot in self.anchors:
            return 0.0
        return float(self.robot_max_speed_m_s.get(robot, self.max_speed_m_s))

    def odometry_error_of(self, robot: str) -> OdometryErrorModel:
        """Return the greatest errors of the odometry of a robot."""
        return self._odometry_errors[robot]

    @cached_property
    def _odometry_errors(self) -> dict[str, OdometryErrorModel]:
        """The greatest errors of odometry by robot and landmark; clocks that differ delay it."""
        errors = {}
        for robot in (*self.robots, *self.landmarks):
            error = self.robot_odometry_error.get(robot, self.odometry_error)
            latency_s = sum_up(error.latency_s, self.between_stamps_s)
            errors[robot] = replace(error, latency_s=latency_s) if self.stamp_error_s else error
        return errors

    @property
    def between_stamps_s(self) -> float:
        """How much longer or shorter than between two stamps the time between them may be."""
        return product_up(2.0, self.stamp_error_s)

    def is_upright(self, robot: str) -> bool:
        """Return whether the odometry of a robot tells its level frames, as in the plane."""
        return self.dimension == 2 or self.odometry_error_of(robot).tilt_rad is not None

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


def _frozen_mounts(
    mounts: Mapping[str, Mapping[str, Mount | tuple[float, ...]]],
) -> Mapping[str, Mapping[str, Mount | tuple[float, ...]]]:
    """Return a copy of the sensors of each robot that nobody can change."""
    frozen = {}
    for robot, sensors in mounts.items():
        frozen[robot] = MappingProxyType(
            {
                name: mount if isinstance(mount, Mount) else tuple(mount)
                for name, mount in sensors.items()
            }
        )
    return MappingProxyType(frozen)
