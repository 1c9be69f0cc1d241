# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The fleet of the paper as a simulation: six robots, nine ranges, cameras, slow motion.

Section 5.1 of the paper gives nine squared distances of a fleet at rest. Here the fleet starts at
that placement and moves: all robots follow a wide circle together, and each also circles about its
place in the fleet. The shape of the fleet changes all the time and keeps its eight solutions.
"""

from collections.abc import Iterator
from dataclasses import dataclass

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

# The common circle takes the larger share of the speed of a robot, so it never turns back.
COMMON_SHARE = 0.8
COMMON_RADIUS_M = 20.0
SWING_RADIUS_M = 0.3


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

    def rays(self, observer: int) -> np.ndarray:
        """
        Return the vectors from one robot to all, in its body frame.

        Parameters
        ----------
        observer : int
            Index of the robot that sees.

        Returns
        -------
        ndarray, shape (n, 2)
            In m; x forward, y left.

        """
        return (self.positions_m - self.positions_m[observer]) @ rotation(self.yaws_rad[observer])


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


@dataclass(frozen=True)
class SimulatedOdometry:
    """The pose of a robot relative to its pose at the start."""

    robot: str
    position_m: tuple[float, float]
    yaw_rad: float


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
        Decides how each robot swings.

    Raises
    ------
    ValueError
        If the speed is negative or not finite.

    """

    def __init__(self, speed_m_s: float = 0.1, seed: int = 0) -> None:
        if not 0.0 <= speed_m_s < np.inf:
            raise ValueError(f'speed is {speed_m_s} m/s; it must be finite and not negative')
        self._speed_m_s = speed_m_s
        rng = np.random.default_rng(seed)
        self._phases_rad = rng.uniform(-np.pi, np.pi, len(ROBOTS))
        self._turns = rng.choice([-1.0, 1.0], len(ROBOTS))

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
        swing_rad = (1.0 - COMMON_SHARE) / SWING_RADIUS_M * path_m * self._turns + self._phases_rad
        common_rad = COMMON_SHARE / COMMON_RADIUS_M * path_m
        swing = SWING_RADIUS_M * (_on_circle(swing_rad) - _on_circle(self._phases_rad))
        common = COMMON_RADIUS_M * (_on_circle(common_rad) - _on_circle(0.0))
        # The derivative with respect to the path: it gives a heading to a fleet at rest too.
        velocity = (1.0 - COMMON_SHARE) * self._turns[:, None] * _on_circle(
            swing_rad + np.pi / 2
        ) + COMMON_SHARE * _on_circle(common_rad + np.pi / 2)
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

    Of each pair of `EDGES` the first robot measures the range, and each sees the other.

    Parameters
    ----------
    range_error : float
        Bound of the error of a range, relative to the truth as well as to the reading; in [0, 1).
    bearing_error_rad : float
        Bound of the error of a bearing; in [0, pi).
    seed : int
        Seed of the errors, which are uniform within their bounds.

    Raises
    ------
    ValueError
        If a bound is outside its range.

    """

    def __init__(
        self, range_error: float = 0.03, bearing_error_rad: float = 0.02, seed: int = 0
    ) -> None:
        if not 0.0 <= range_error < 1.0:
            raise ValueError(f'range error is {range_error}; it must be in [0, 1)')
        if not 0.0 <= bearing_error_rad < np.pi:
            raise ValueError(f'bearing error is {bearing_error_rad} rad; it must be in [0, pi)')
        # |r - d| <= e d and |r - d| <= e r both hold where |r - d| <= e d / (1 + e).
        self._range_bound = range_error / (1.0 + range_error)
        self._bearing_bound_rad = bearing_error_rad
        self._rng = np.random.default_rng(seed)

    def ranges(self, state: FleetState) -> Iterator[SimulatedRange]:
        """
        Measure every pair of `EDGES` once.

        Parameters
        ----------
        state : FleetState
            The true state.

        Yields
        ------
        SimulatedRange
            One for each pair.

        """
        for observer, target in EDGES:
            distance_m = np.linalg.norm(state.positions_m[target] - state.positions_m[observer])
            error = self._rng.uniform(-self._range_bound, self._range_bound)
            yield SimulatedRange(
                ROBOTS[observer], ROBOTS[target], float(distance_m * (1.0 + error))
            )

    def bearings(self, state: FleetState) -> Iterator[SimulatedBearing]:
        """
        See every robot of `EDGES` from its partner.

        Parameters
        ----------
        state : FleetState
            The true state.

        Yields
        ------
        SimulatedBearing
            Two for each pair.

        """
        for pair in EDGES:
            for observer, target in (pair, pair[::-1]):
                x, y = state.rays(observer)[target]
                error_rad = self._rng.uniform(-self._bearing_bound_rad, self._bearing_bound_rad)
                bearing_rad = np.arctan2(y, x) + error_rad
                ray = (float(np.cos(bearing_rad)), float(np.sin(bearing_rad)), 0.0)
                yield SimulatedBearing(ROBOTS[observer], ROBOTS[target], ray)


def odometry(start: FleetState, state: FleetState) -> Iterator[SimulatedOdometry]:
    """
    Measure the pose of each robot relative to its pose in `start`, without error.

    Parameters
    ----------
    start, state : FleetState
        The states at the origin of the odometry frames and now.

    Yields
    ------
    SimulatedOdometry
        One for each robot, in its own body frame at the start.

    """
    for robot, name in enumerate(ROBOTS):
        travelled = state.positions_m[robot] - start.positions_m[robot]
        x, y = travelled @ rotation(start.yaws_rad[robot])
        yaw_rad = state.yaws_rad[robot] - start.yaws_rad[robot]
        yield SimulatedOdometry(name, (float(x), float(y)), float(yaw_rad))
