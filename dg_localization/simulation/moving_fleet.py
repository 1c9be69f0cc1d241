# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The fleet of the paper as a simulation: six robots, nine ranges, cameras, slow motion.

Section 5.1 of the paper gives nine squared distances of a fleet at rest. Here the fleet starts at
that placement and moves. In formation all robots follow a wide circle together, and each also
circles about its place in the fleet: the shape changes all the time and keeps its eight solutions.
In loops each drives a circle of its own, so that its odometry tells left from right.

Every reading keeps its stated bounds, even after its message is rounded. Odometry drifts within
its bounds: from one sample to the next a robot measures its motion and turn in its body frame.
Each step errs in proportion to its length and turn; the errors accumulate, and an error of the
heading bends the path after it.
"""

from collections.abc import Iterable, Iterator, Mapping
from enum import StrEnum
import math
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

ROBOTS = tuple(f'robot_{number}' for number in range(1, 7))

# The solution inside the paper's D3, with P2 at the origin and P1 on the x axis.
START_POSITIONS_M = np.array(
    [
        [7.615773105863909, 0.0],
        [0.0, 0.0],
        [3.0200479557736193, 5.64617661296807],
        [-4.595725150090289, 5.64617661296807],
        [-3.939192985791676, -6.040095911547238],
        [-7.221853807284741, -0.9191450300180559],
    ]
)

# The measured pairs of the paper, by index into ROBOTS.
EDGES = ((0, 1), (0, 2), (1, 2), (1, 3), (1, 4), (1, 5), (2, 3), (3, 5), (4, 5))

# Landmarks at rest. Ranges beyond the reach are not measured.
LANDMARKS_M = MappingProxyType(
    {'beacon_1': (-12.0, -9.0), 'beacon_2': (10.0, -9.0), 'beacon_3': (-2.0, 11.0)}
)
REACH_M = 30.0

# The common circle takes the larger share of the speed of a robot, so it never turns back.
COMMON_SHARE = 0.8
COMMON_RADIUS_M = 20.0
SWING_RADIUS_M = 0.3

# The share of a bound reserved for the rounding of messages: numbers in single precision, stamps
# in whole nanoseconds.
ROUNDING_SHARE = 1e-5
# Further margin of the sensors, whose bounds may be small: twice the error of single precision.
SINGLE_PRECISION = 2.0**-23
# The share of an error that is equal at every step, like that of a wrong wheel diameter.
CONSTANT_SHARE = 0.5

Pair = tuple[str, str]
"""Observer and target."""


class Path(StrEnum):
    """The paths of the robots."""

    FORMATION = 'formation'
    LOOPS = 'loops'


class FleetState(NamedTuple):
    """
    The true poses of the robots at one time.

    Attributes
    ----------
    time_s : float
        Time since the start of the simulation.
    positions_m : ndarray, shape (n, 2)
        Positions in the fixed frame.
    yaws_rad : ndarray, shape (n,)
        Headings: the direction of the body's x axis in the fixed frame.

    """

    time_s: float
    positions_m: np.ndarray
    yaws_rad: np.ndarray


def rotation(yaw_rad: float) -> np.ndarray:
    """Return the matrix, shape (2, 2), that turns body vectors into the fixed frame."""
    return np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])


class FleetMotion:
    """
    The motion of the fleet, a function of time alone.

    Parameters
    ----------
    speed_m_s : float
        Bound of the speed of every robot; 0 is a fleet at rest.
    seed : int
        Decides the start of each robot on its circle, and its sense of rotation.
    path : Path
        In formation, or each in a loop of its own.

    """

    def __init__(self, speed_m_s: float = 0.1, seed: int = 0, path: Path = Path.FORMATION) -> None:
        self._speed_m_s = speed_m_s
        rng = np.random.default_rng(seed)
        self._phases_rad = rng.uniform(-np.pi, np.pi, len(ROBOTS))
        self._turns = rng.choice([-1.0, 1.0], len(ROBOTS))
        if path is Path.FORMATION:
            self._common_share = COMMON_SHARE
            self._radii_m = np.full(len(ROBOTS), SWING_RADIUS_M)
        else:
            self._common_share = 0.0
            # A loop is two to four times as wide.
            self._radii_m = rng.uniform(2 * SWING_RADIUS_M, 4 * SWING_RADIUS_M, len(ROBOTS))

    def state(self, time_s: float) -> FleetState:
        """Return the true state at a time after the start, which is the placement of the paper."""
        path_m = self._speed_m_s * time_s
        share, turns = self._common_share, self._turns
        swing_rad = (1.0 - share) / self._radii_m * path_m * turns + self._phases_rad
        common_rad = share / COMMON_RADIUS_M * path_m
        swing = self._radii_m[:, None] * (_on_circle(swing_rad) - _on_circle(self._phases_rad))
        common = COMMON_RADIUS_M * (_on_circle(common_rad) - _on_circle(0.0))
        # The derivative along the path, which gives a heading to a fleet at rest too.
        velocity = (1.0 - share) * turns[:, None] * _on_circle(
            swing_rad + np.pi / 2
        ) + share * _on_circle(common_rad + np.pi / 2)
        return FleetState(
            time_s=time_s,
            positions_m=START_POSITIONS_M + swing + common,
            yaws_rad=np.arctan2(velocity[:, 1], velocity[:, 0]),
        )


def _on_circle(angle_rad: np.ndarray | float) -> np.ndarray:
    """Return the points of the unit circle at angles, one per row."""
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


class FleetSensors:
    """
    Sensors with bounded errors.

    The first robot of each pair of `EDGES` measures the range, and each robot sees the other.
    Every robot ranges and sees every landmark.

    Parameters
    ----------
    range_error : float
        Bound of the error of a range, relative to the truth as well as to the reading; in [0, 1).
    bearing_error_rad : float
        Bound of the error of a bearing; in [0, pi). Bounds below 1e-7 do not hold for messages,
        which have single precision.
    seed : int
        Seed of the errors, which are uniform within their bounds.
    landmarks_m : mapping of str to tuple of float
        The places of the landmarks in the fixed frame by name.

    """

    def __init__(
        self,
        range_error: float = 0.03,
        bearing_error_rad: float = 0.02,
        seed: int = 0,
        landmarks_m: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        # |r - d| <= e d and |r - d| <= e r both hold where |r - d| <= e d / (1 + e).
        self._range_bound = _before_rounding(range_error / (1.0 + range_error))
        self._bearing_bound_rad = _before_rounding(bearing_error_rad)
        self._rng = np.random.default_rng(seed)
        self.landmarks_m = landmarks_m

    def ranges(self, state: FleetState) -> dict[Pair, float]:
        """Measure every pair within reach once, in m."""
        found = {}
        for observer, target, position_m in self._targets(state, EDGES):
            distance_m = np.linalg.norm(position_m - state.positions_m[observer])
            error = self._rng.uniform(-self._range_bound, self._range_bound)
            range_m = float(distance_m * (1.0 + error))
            if range_m <= REACH_M:
                found[ROBOTS[observer], target] = range_m
        return found

    def bearings(self, state: FleetState) -> dict[Pair, tuple[float, float, float]]:
        """Measure rays of the pairs of `EDGES`, both ways, and to landmarks, in body frames."""
        found = {}
        both_ways = [pair for edge in EDGES for pair in (edge, edge[::-1])]
        for observer, target, position_m in self._targets(state, both_ways):
            way_m = position_m - state.positions_m[observer]
            x, y = way_m @ rotation(state.yaws_rad[observer])
            error_rad = self._rng.uniform(-self._bearing_bound_rad, self._bearing_bound_rad)
            bearing_rad = np.arctan2(y, x) + error_rad
            ray = (float(np.cos(bearing_rad)), float(np.sin(bearing_rad)), 0.0)
            found[ROBOTS[observer], target] = ray
        return found

    def _targets(
        self, state: FleetState, pairs: Iterable[tuple[int, int]]
    ) -> Iterator[tuple[int, str, np.ndarray]]:
        """Yield observer, target name and target place."""
        for observer, target in pairs:
            yield observer, ROBOTS[target], state.positions_m[target]
        for observer in range(len(ROBOTS)):
            for name, position_m in self.landmarks_m.items():
                yield observer, name, np.array(position_m)


def _before_rounding(bound: float) -> float:
    return max(0.0, (1.0 - ROUNDING_SHARE) * bound - SINGLE_PRECISION)


class OdometryErrors(NamedTuple):
    """
    Bounds of the errors of odometry, relative to the true step as well as to the measured one.

    Parameters
    ----------
    translation_per_m, translation_per_rad : float
        Error of a step, in m per m travelled and in m per rad turned.
    rotation_per_m, rotation_per_rad : float
        Error of a turn, in rad per m travelled and in rad per rad turned.
    latency_s : float
        A sample stamped t was taken at most this time before t.

    """

    translation_per_m: float = 0.05
    translation_per_rad: float = 0.0
    rotation_per_m: float = 0.0
    rotation_per_rad: float = 0.05
    latency_s: float = 0.0

    def bounds(self, way_m: float, turn_rad: float) -> tuple[float, float]:
        """Return the bounds of the errors of a step, in m and rad, by its length and its turn."""
        bound_m = self.translation_per_m * way_m + self.translation_per_rad * turn_rad
        bound_rad = self.rotation_per_m * way_m + self.rotation_per_rad * turn_rad
        # A measured step may be shorter than the true one by its error, so its own bounds are
        # smaller by this loss.
        loss_m = self.translation_per_m * bound_m + self.translation_per_rad * bound_rad
        loss_rad = self.rotation_per_m * bound_m + self.rotation_per_rad * bound_rad
        share = min(_kept(bound_m, loss_m), _kept(bound_rad, loss_rad)) * (1.0 - ROUNDING_SHARE)
        return share * bound_m, share * bound_rad


def _kept(bound: float, loss: float) -> float:
    """Return the largest share with ``share * bound <= bound - share * loss``."""
    return bound / (bound + loss) if loss > 0.0 else 1.0


class SimulatedOdometry(NamedTuple):
    """The measured pose of a robot relative to its body frame at the start."""

    robot: str
    position_m: tuple[float, float]
    yaw_rad: float


class FleetOdometry:
    """
    The odometry of all robots.

    Parameters
    ----------
    motion : FleetMotion
        The true motion. The odometry begins at time zero.
    errors : OdometryErrors
        Half of each error is equal at every step, the other half is uniform in its bounds.
    seed : int
        Seed of the errors.

    """

    def __init__(self, motion: FleetMotion, errors: OdometryErrors, seed: int = 0) -> None:
        self._motion = motion
        self._errors = errors
        self._rng = np.random.default_rng(seed)
        self._constant = self._rng.uniform(-CONSTANT_SHARE, CONSTANT_SHARE, (len(ROBOTS), 2))
        self._asked_s = 0.0
        self._state = motion.state(0.0)
        self._positions_m = np.zeros((len(ROBOTS), 2))
        self._yaws_rad = np.zeros(len(ROBOTS))

    def samples(self, time_s: float) -> Iterator[SimulatedOdometry]:
        """Measure the steps of all robots since the sample before, for a time of the motion."""
        pose_s = time_s - self._rng.uniform(0.0, self._errors.latency_s)
        # Latency varies, but no sample is of an earlier time than the one before, unless the clock
        # itself went back.
        if time_s >= self._asked_s:
            pose_s = max(pose_s, self._state.time_s)
        self._asked_s = time_s
        before, self._state = self._state, self._motion.state(pose_s)
        for robot, name in enumerate(ROBOTS):
            self._take_step(robot, before)
            x, y = self._positions_m[robot]
            yield SimulatedOdometry(name, (float(x), float(y)), float(self._yaws_rad[robot]))

    def _take_step(self, robot: int, before: FleetState) -> None:
        """Add one step, with its errors, to the pose of a robot."""
        way_m = self._state.positions_m[robot] - before.positions_m[robot]
        step_m = way_m @ rotation(before.yaws_rad[robot])
        turn_rad = math.remainder(
            self._state.yaws_rad[robot] - before.yaws_rad[robot], 2.0 * math.pi
        )
        length_m = float(np.linalg.norm(step_m))
        bound_m, bound_rad = self._errors.bounds(length_m, abs(turn_rad))
        random = 1.0 - CONSTANT_SHARE
        along = step_m / length_m if length_m > 0.0 else np.array([1.0, 0.0])
        angle_rad = self._rng.uniform(-math.pi, math.pi)
        anywhere = self._rng.uniform(0.0, random) * np.array(
            [math.cos(angle_rad), math.sin(angle_rad)]
        )
        step_m = step_m + bound_m * (self._constant[robot, 0] * along + anywhere)
        turn_rad += bound_rad * (self._constant[robot, 1] + self._rng.uniform(-random, random))
        self._positions_m[robot] += rotation(self._yaws_rad[robot]) @ step_m
        self._yaws_rad[robot] += turn_rad
