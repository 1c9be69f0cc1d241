# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The fleet of the paper as a simulation: six robots, nine ranges, cameras, slow motion.

Section 5.1 of the paper gives nine squared distances of a fleet at rest. Here the fleet starts at
that placement and moves. In formation all robots follow a wide circle together, and each also
circles about its place in the fleet: the shape changes all the time and keeps its eight solutions.
In loops each drives a circle of its own, so that its odometry tells left from right.

Every reading keeps the bounds that are stated for it, also after its message is rounded.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType

import numpy as np
from numpy.typing import ArrayLike

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

# Landmarks that stand still. A range of more than the reach is not measured.
LANDMARKS_M = MappingProxyType(
    {'beacon_1': (-12.0, -9.0), 'beacon_2': (10.0, -9.0), 'beacon_3': (-2.0, 11.0)}
)
REACH_M = 30.0

# The common circle takes the larger share of the speed of a robot, so it never turns back.
COMMON_SHARE = 0.8
COMMON_RADIUS_M = 20.0
SWING_RADIUS_M = 0.3
LEAST_LOOP_RADIUS_M, GREATEST_LOOP_RADIUS_M = 0.6, 1.2

# This share of a bound is left to the rounding of messages: numbers in single precision, stamps
# in whole nanoseconds.
ROUNDING_SHARE = 1e-5
# Left besides by the sensors, whose bounds may be small: twice what single precision adds.
SINGLE_PRECISION = 2.0**-23


class Path(StrEnum):
    """How the robots drive."""

    FORMATION = 'formation'
    LOOPS = 'loops'


@dataclass(frozen=True)
class FleetState:
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

    def ray_m(self, observer: int, position_m: ArrayLike) -> np.ndarray:
        """
        Return the vector from one robot to a place, in its body frame.

        Parameters
        ----------
        observer : int
            Index of the robot that sees.
        position_m : array_like, shape (2,)
            The place, in the fixed frame.

        Returns
        -------
        ndarray, shape (2,)
            In m; x forward, y left.

        """
        way_m = np.asarray(position_m) - self.positions_m[observer]
        return way_m @ rotation(self.yaws_rad[observer])


@dataclass(frozen=True)
class SimulatedRange:
    """A measured distance from `observer` to `target`, in m."""

    observer: str
    target: str
    range_m: float


@dataclass(frozen=True)
class SimulatedBearing:
    """The measured unit vector from `observer` to `target` in the observer's body frame."""

    observer: str
    target: str
    ray: tuple[float, float, float]


def rotation(yaw_rad: float) -> np.ndarray:
    """
    Return the matrix that turns body vectors into the fixed frame.

    Parameters
    ----------
    yaw_rad : float
        Heading of the body.

    Returns
    -------
    ndarray, shape (2, 2)
        Its columns are the body's x and y axes in the fixed frame.

    """
    return np.array([[np.cos(yaw_rad), -np.sin(yaw_rad)], [np.sin(yaw_rad), np.cos(yaw_rad)]])


class FleetMotion:
    """
    The motion of the fleet, a function of time alone.

    Parameters
    ----------
    speed_m_s : float
        Bound of the speed of every robot; 0 is a fleet at rest.
    seed : int
        Decides where on its circle each robot begins, and which way it turns.
    path : Path
        In formation, or each in a loop of its own.

    Raises
    ------
    ValueError
        If the speed is negative or not finite.

    """

    def __init__(self, speed_m_s: float = 0.1, seed: int = 0, path: Path = Path.FORMATION) -> None:
        if not 0.0 <= speed_m_s < np.inf:
            raise ValueError(f'speed is {speed_m_s} m/s; it must be finite and not negative')
        self._speed_m_s = speed_m_s
        rng = np.random.default_rng(seed)
        self._phases_rad = rng.uniform(-np.pi, np.pi, len(ROBOTS))
        self._turns = rng.choice([-1.0, 1.0], len(ROBOTS))
        if path is Path.FORMATION:
            self._common_share = COMMON_SHARE
            self._radii_m = np.full(len(ROBOTS), SWING_RADIUS_M)
        else:
            self._common_share = 0.0
            self._radii_m = rng.uniform(LEAST_LOOP_RADIUS_M, GREATEST_LOOP_RADIUS_M, len(ROBOTS))

    def state(self, time_s: float) -> FleetState:
        """
        Return the true state at a time.

        Parameters
        ----------
        time_s : float
            Time since the start, when the fleet is at the paper's placement.

        Returns
        -------
        FleetState
            Positions and headings.

        """
        path_m = self._speed_m_s * time_s
        share, turns = self._common_share, self._turns
        swing_rad = (1.0 - share) / self._radii_m * path_m * turns + self._phases_rad
        common_rad = share / COMMON_RADIUS_M * path_m
        swing = self._radii_m[:, None] * (_on_circle(swing_rad) - _on_circle(self._phases_rad))
        common = COMMON_RADIUS_M * (_on_circle(common_rad) - _on_circle(0.0))
        # The derivative with respect to the path: it gives a heading to a fleet at rest too.
        velocity = (1.0 - share) * turns[:, None] * _on_circle(
            swing_rad + np.pi / 2
        ) + share * _on_circle(common_rad + np.pi / 2)
        return FleetState(
            time_s=time_s,
            positions_m=START_POSITIONS_M + swing + common,
            yaws_rad=np.arctan2(velocity[:, 1], velocity[:, 0]),
        )


def _on_circle(angle_rad: np.ndarray | float) -> np.ndarray:
    """Return the points of the unit circle at the angles, one a row."""
    return np.stack([np.cos(angle_rad), np.sin(angle_rad)], axis=-1)


class FleetSensors:
    """
    Sensors with bounded errors.

    Of each pair of `EDGES` the first robot measures the range, and each sees the other. Every
    robot ranges and sees every landmark.

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
        By name, the places of the landmarks in the fixed frame.

    Raises
    ------
    ValueError
        If a bound is outside its range.

    """

    def __init__(
        self,
        range_error: float = 0.03,
        bearing_error_rad: float = 0.02,
        seed: int = 0,
        landmarks_m: Mapping[str, tuple[float, float]] = MappingProxyType({}),
    ) -> None:
        if not 0.0 <= range_error < 1.0:
            raise ValueError(f'range error is {range_error}; it must be in [0, 1)')
        if not 0.0 <= bearing_error_rad < np.pi:
            raise ValueError(f'bearing error is {bearing_error_rad} rad; it must be in [0, pi)')
        # |r - d| <= e d and |r - d| <= e r both hold where |r - d| <= e d / (1 + e).
        self._range_bound = _before_rounding(range_error / (1.0 + range_error))
        self._bearing_bound_rad = _before_rounding(bearing_error_rad)
        self._rng = np.random.default_rng(seed)
        self.landmarks_m = landmarks_m

    def ranges(self, state: FleetState) -> Iterator[SimulatedRange]:
        """
        Measure every pair once.

        Parameters
        ----------
        state : FleetState
            The true state.

        Yields
        ------
        SimulatedRange
            One for each pair within reach.

        """
        for observer, target, position_m in self._targets(state, EDGES):
            distance_m = np.linalg.norm(position_m - state.positions_m[observer])
            error = self._rng.uniform(-self._range_bound, self._range_bound)
            range_m = float(distance_m * (1.0 + error))
            if range_m <= REACH_M:
                yield SimulatedRange(ROBOTS[observer], target, range_m)

    def bearings(self, state: FleetState) -> Iterator[SimulatedBearing]:
        """
        See every robot of `EDGES` from its partner, and every landmark.

        Parameters
        ----------
        state : FleetState
            The true state.

        Yields
        ------
        SimulatedBearing
            Two for each pair of robots, one for each robot and landmark.

        """
        both_ways = [pair for edge in EDGES for pair in (edge, edge[::-1])]
        for observer, target, position_m in self._targets(state, both_ways):
            x, y = state.ray_m(observer, position_m)
            error_rad = self._rng.uniform(-self._bearing_bound_rad, self._bearing_bound_rad)
            bearing_rad = np.arctan2(y, x) + error_rad
            ray = (float(np.cos(bearing_rad)), float(np.sin(bearing_rad)), 0.0)
            yield SimulatedBearing(ROBOTS[observer], target, ray)

    def _targets(
        self, state: FleetState, pairs: Iterable[tuple[int, int]]
    ) -> Iterator[tuple[int, str, np.ndarray]]:
        """Yield who measures, and name and place of whom."""
        for observer, target in pairs:
            yield observer, ROBOTS[target], state.positions_m[target]
        for observer in range(len(ROBOTS)):
            for name, position_m in self.landmarks_m.items():
                yield observer, name, np.array(position_m)


def _before_rounding(bound: float) -> float:
    return max(0.0, (1.0 - ROUNDING_SHARE) * bound - SINGLE_PRECISION)
