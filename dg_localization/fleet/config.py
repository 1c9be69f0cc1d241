# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The validated settings of the package `fleet`.

The dataclass is frozen and checks itself when made. A wrong value raises `ConfigError`, whose
message names the field, the value, and the allowed values.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from itertools import starmap
from types import MappingProxyType
from typing import Any

from dg_localization.fleet.checks import (
    ConfigError,
    keep,
    keep_numbers,
    not_allowed,
    require_kind,
    require_mapping,
    require_members,
    require_name,
    require_number,
    require_one_of,
    unlocked,
)
from dg_localization.fleet.contradictions.suspects import SuspectKind
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.sensors import (
    Anchor,
    DifferenceErrorModel,
    ElevationErrorModel,
    Mount,
    RangeErrorModel,
    SensorBounds,
    are_narrower,
    checked_anchors,
    checked_elevations,
    checked_mounts,
)
from dg_localization.interval.bounds import product_up, sum_up
from dg_localization.solver.checks import is_whole
from dg_localization.solver.options import SolverOptions

LEAST_MEMORY_S = 0.001
"""The time slots of a shorter memory would be shorter than stamps resolve."""

OF_ROBOTS = ('robot_max_speed_m_s', 'robot_odometry_error')
"""Settings of single robots, by their names."""

OF_SENSORS = frozenset(one.name for one in fields(SensorBounds))
"""Settings that hold for readings without bounds of their own."""

NOT_NEGATIVE = {'at_least': 0.0}
LIMITS: Mapping[str, Mapping[str, Any]] = {
    'max_conflict_seconds': {'at_least': 0.0, 'finite': False},
    'memory_max_seconds': {'at_least': 0.0, 'finite': False},
    'max_repeats': {'at_least': 1},
    'max_hypotheses': {'at_least': 1},
}
"""The limits of numbers that are not only finite and not negative."""


@dataclass(frozen=True)
class FleetConfig:
    """
    All settings of the package `fleet`.

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
        Bound of the error of any stamp against the clock of the estimates: clocks of robots
        differ. Equal stamps of one robot are one time.
    max_future_s : float
        Greatest time by which a stamp may be ahead of the clock.
    max_repeats : int
        The number of newest readings of one link that are kept and intersected.
    range_error : RangeErrorModel
        Error bounds of ranges that come without bounds of their own, like those below.
    bearing_half_width_rad : float
        Greatest angle between a measured ray and the true direction.
    bearing_expected_error_rad : float
        The likeliest error of a ray about the vertical axis, counterclockwise, for the best point.
    anchors : mapping of str to Anchor
        Points of known coordinates. A name that is also in `robots` is a parked robot, any other
        is a landmark. Anchors do not move.
    mounts : mapping of str to mapping of str to Mount
        The sensors of each robot by name, each a `Mount` or its position alone. The sensor
        ``left`` of ``r1`` is the point ``r1/left``; ``r1`` itself is the origin of its body frame.
    elevations_m : mapping of str to tuple of float
        Least and greatest elevation of points in the plane; their ranges are projected to it. A
        sensor without an entry has the elevation of its robot; other points are at 0.
    elevation_error : ElevationErrorModel
        Error bounds of every elevation reading, for points that `elevations_m` names.
    range_difference_error : DifferenceErrorModel
        Error bounds of every range difference.
    max_speed_m_s : float
        No robot moves faster. It determines how much the bounds of an old measurement widen.
    robot_max_speed_m_s : mapping of str to float
        Greatest speeds of robots for which `max_speed_m_s` does not hold.
    max_turn_rate_rad_s : float
        No robot turns faster. It determines how much the half width of an old bearing grows.
    min_separation_m : float
        No two robots come nearer than this, for example their size. Bearings between moving
        robots without a range need it: the direction to a very near point may turn at once.
    odometry_error : OdometryErrorModel
        Greatest errors of odometry along its path, which carries older measurements to now.
    robot_odometry_error : mapping of str to OdometryErrorModel
        Greatest errors of robots for which `odometry_error` does not hold.
    memory_s : float
        Time for which measurements between points with odometry, or anchors, are remembered; 0
        remembers nothing.
    memory_max_seconds : float
        Longest time that an estimate spends on remembered readings; infinity sets no limit.
    window_outliers : int
        The number of measurements of any two bodies in `memory_s` that may be wrong.
    max_hypotheses : int
        Most placements that an estimate lists.
    max_outliers : int
        Most contradicting observations that are dropped to get an answer. The answer is the union
        over all minimal sets of observations whose removal makes the rest agree.
    outlier_unit : SuspectKind
        The unit of an outlier: an observation, a whole sensor, or a whole robot.
    stuck_readings : int
        A sensor is stuck if this many readings in a row are equal to the last bit while robots
        moved; ten times as many without odometry. 0 switches the check off.
    drop_stuck : bool
        Whether stuck readings are dropped.
    max_conflict_solves : int
        Most problems that are solved in one search for an explanation; 0 explains none.
    max_conflict_seconds : float
        Longest time of a search for the explanation; infinity sets no limit.
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
    anchors: Mapping[str, Anchor] = field(default_factory=dict)
    mounts: Mapping[str, Mapping[str, Mount | tuple[float, ...]]] = field(default_factory=dict)
    elevations_m: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    elevation_error: ElevationErrorModel = ElevationErrorModel()
    range_difference_error: DifferenceErrorModel = DifferenceErrorModel()
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
        keep(self, robots=require_members('robots', self.robots, 'names'))
        for name in OF_ROBOTS:
            keep(self, **{name: require_mapping(name, getattr(self, name))})
        self._check_kinds()
        self._check_numbers()
        keep(
            self,
            anchors=checked_anchors(self.anchors, self.dimension),
            mounts=checked_mounts(self.mounts, self.robots, self.dimension),
        )
        self._check_names()
        elevations_m = checked_elevations(self.elevations_m, self.points, self.dimension)
        keep(self, elevations_m=elevations_m)

    def __reduce__(self) -> tuple[Any, ...]:
        # Read-only mappings cannot be pickled or copied.
        settings = {one.name: unlocked(getattr(self, one.name)) for one in fields(self)}
        return partial(type(self), **settings), ()

    def _check_kinds(self) -> None:
        """Raise `ConfigError` on a setting of a wrong type."""
        require_kind('odometry_error', self.odometry_error, OdometryErrorModel)
        require_kind('drop_stuck', self.drop_stuck, bool)
        require_kind('solver', self.solver, SolverOptions)
        for robot, error in self.robot_odometry_error.items():
            require_kind(f'robot_odometry_error[{robot}]', error, OdometryErrorModel)

    def _check_names(self) -> None:
        """Raise `ConfigError` on a repeated, missing or unknown name."""
        if not self.robots:
            raise not_allowed('robots', (), 'it must name at least one robot')
        for name in self.robots:
            require_name('robots', name)
            if self.robots.count(name) > 1:
                raise ConfigError(f'robots: {name!r} is repeated, each robot must be named once')
        if not self.reference_robot:
            keep(self, reference_robot=self.robots[0])
        require_one_of('reference_robot', self.reference_robot, self.robots)
        for name in self.points:
            if self.points.count(name) > 1:
                raise ConfigError(
                    f'points: {name!r} is not allowed twice, robots, anchors and sensors '
                    '(robot/sensor) must have different names'
                )
        for setting in OF_ROBOTS:
            for name in getattr(self, setting):
                require_one_of(setting, name, self.robots)

    def _check_numbers(self) -> None:
        """Convert numbers to Python numbers; raise `ConfigError` on one out of its range."""
        if not is_whole(self.dimension) or self.dimension not in (2, 3):
            raise not_allowed('dimension', self.dimension, 'it must be 2 or 3')
        keep(self, dimension=int(self.dimension))
        numbers = {one.name for one in fields(self) if type(one.default) in (int, float)}
        limits = {name: LIMITS.get(name, NOT_NEGATIVE) for name in sorted(numbers - OF_SENSORS)}
        keep_numbers(self, '', limits)
        keep(self, **vars(self.sensor_bounds))
        if 0.0 < self.memory_s < LEAST_MEMORY_S:
            wanted = f'it must be 0, which remembers nothing, or >= {LEAST_MEMORY_S:g}'
            raise not_allowed('memory_s', self.memory_s, wanted)
        speeds_m_s = {
            robot: require_number(f'robot_max_speed_m_s[{robot}]', speed, at_least=0.0)
            for robot, speed in self.robot_max_speed_m_s.items()
        }
        keep(self, robot_max_speed_m_s=MappingProxyType(speeds_m_s))
        require_one_of('outlier_unit', self.outlier_unit, [str(kind) for kind in SuspectKind])
        keep(self, outlier_unit=SuspectKind(self.outlier_unit))

    def is_within(self, other: FleetConfig) -> bool:
        """Return whether what was measured with the settings `other` holds with these, too."""
        errors = [(self.odometry_error_of(r), other.odometry_error_of(r)) for r in self.robots]
        return (
            (self.memory_s > 0.0) == (other.memory_s > 0.0)
            and self.sensor_bounds.are_within(other.sensor_bounds)
            and all(starmap(are_narrower, [(self, other), *errors]))
            and all(self.speed_m_s(robot) <= other.speed_m_s(robot) for robot in self.robots)
            and all(
                (new.translation_scale, new.tilt_rad) == (old.translation_scale, old.tilt_rad)
                for new, old in errors
            )
        )

    @cached_property
    def sensor_bounds(self) -> SensorBounds:
        """The error bounds of every sensor whose readings come without bounds."""
        return SensorBounds(*(getattr(self, one.name) for one in fields(SensorBounds)))

    @property
    def landmarks(self) -> tuple[str, ...]:
        """Names of the anchors that are not robots, in their given order."""
        return tuple(name for name in self.anchors if name not in self.robots)

    @cached_property
    def points(self) -> tuple[str, ...]:
        """Names of all points of the problem: the robots, the landmarks, and the sensors."""
        return (*self.robots, *self.landmarks, *self.sensors)

    @cached_property
    def rows(self) -> dict[str, int]:
        """The index of each point into `points`."""
        return {point: row for row, point in enumerate(self.points)}

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
        """Return the point whose elevation applies: the point itself, or its robot."""
        return point if point in self.elevations_m else self.robot_of(point)

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
        """The greatest errors of odometry by robot and landmark, with clock errors as latency."""
        errors = {}
        for robot in (*self.robots, *self.landmarks):
            error = self.robot_odometry_error.get(robot, self.odometry_error)
            latency_s = sum_up(error.latency_s, self.between_stamps_s)
            errors[robot] = replace(error, latency_s=latency_s) if self.stamp_error_s else error
        return errors

    @property
    def between_stamps_s(self) -> float:
        """Bound of the difference between a true time span and the span of its two stamps."""
        return product_up(2.0, self.stamp_error_s)

    def is_upright(self, robot: str) -> bool:
        """Return whether the odometry of a robot gives its level frames, as in the plane."""
        return self.dimension == 2 or self.odometry_error_of(robot).tilt_rad is not None
