# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Odometry that drifts, and never more than its stated bounds allow.

From one sample to the next a robot measures how far it went and turned, in its body frame. Each
step errs in proportion to the way and to the turn; the errors add up, and an error of the heading
bends the way that follows.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
import math

import numpy as np

from dg_localization.simulation.moving_fleet import (
    ROBOTS,
    ROUNDING_SHARE,
    FleetMotion,
    FleetState,
    rotation,
)

# The share of an error that is the same at every step, as that of a wrong wheel diameter.
CONSTANT_SHARE = 0.5


@dataclass(frozen=True)
class OdometryErrors:
    """
    Bounds of the errors of odometry, relative to the true step as well as to the measured one.

    Parameters
    ----------
    translation_per_m, translation_per_rad : float
        Error of a step, in m per m travelled and in m per rad turned.
    rotation_per_m, rotation_per_rad : float
        Error of a turn, in rad per m travelled and in rad per rad turned.
    latency_s : float
        A sample stamped t is of some time from this much before t until t.

    Raises
    ------
    ValueError
        If a bound is negative or not finite.

    """

    translation_per_m: float = 0.05
    translation_per_rad: float = 0.0
    rotation_per_m: float = 0.0
    rotation_per_rad: float = 0.05
    latency_s: float = 0.0

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not 0.0 <= value < math.inf:
                raise ValueError(f'{field.name} is {value}; it must be finite and not negative')

    def bounds(self, way_m: float, turn_rad: float) -> tuple[float, float]:
        """
        Return the bounds of the errors of one step.

        Parameters
        ----------
        way_m, turn_rad : float
            True length and true angle of the step, not negative.

        Returns
        -------
        tuple of float
            Of the translation in m and of the rotation in rad.

        """
        bound_m = self.translation_per_m * way_m + self.translation_per_rad * turn_rad
        bound_rad = self.rotation_per_m * way_m + self.rotation_per_rad * turn_rad
        # A measured step may be shorter than the true one by its error, and its own bounds are
        # smaller by this much.
        loss_m = self.translation_per_m * bound_m + self.translation_per_rad * bound_rad
        loss_rad = self.rotation_per_m * bound_m + self.rotation_per_rad * bound_rad
        share = min(_kept(bound_m, loss_m), _kept(bound_rad, loss_rad)) * (1.0 - ROUNDING_SHARE)
        return share * bound_m, share * bound_rad


def _kept(bound: float, loss: float) -> float:
    """Return the largest share with ``share * bound <= bound - share * loss``."""
    return bound / (bound + loss) if loss > 0.0 else 1.0


@dataclass(frozen=True)
class SimulatedOdometry:
    """The pose of a robot as it measured its way since the start, in its body frame there."""

    robot: str
    position_m: tuple[float, float]
    yaw_rad: float


class FleetOdometry:
    """
    The odometry of all robots.

    Parameters
    ----------
    motion : FleetMotion
        Where the robots truly are. The odometry begins at time zero.
    errors : OdometryErrors
        Half of each error is the same at every step, the other half is uniform in its bounds.
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
        """
        Measure the steps of all robots since the sample before.

        Parameters
        ----------
        time_s : float
            Stamp of the samples, since the start of the motion.

        Yields
        ------
        SimulatedOdometry
            One for each robot.

        """
        pose_s = time_s - self._rng.uniform(0.0, self._errors.latency_s)
        # Latency varies, and still no sample is of an earlier time than the one before; unless
        # the clock itself went back.
        if time_s >= self._asked_s:
            pose_s = max(pose_s, self._state.time_s)
        self._asked_s = time_s
        before, self._state = self._state, self._motion.state(pose_s)
        for robot in range(len(ROBOTS)):
            self._take_step(robot, before)
        yield from self.newest()

    def newest(self) -> Iterator[SimulatedOdometry]:
        """Yield the samples of all robots that were measured last."""
        for robot, name in enumerate(ROBOTS):
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
