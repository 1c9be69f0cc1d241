# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The scale of odometry, and bounds of its errors.

The terms follow Thrun, Burgard, Fox, Probabilistic Robotics, 2005, Section 5.4, as bounds instead
of standard deviations.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
import math

import numpy as np

from dg_localization.fleet.checks import keep_numbers
from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import up
from dg_localization.interval.rounding import step_up

MOST_SCALE = 100.0
"""Scales beyond this, or below one over it, which no unit of length explains, are mistakes."""

HALF_TURN_RAD = angle_up(math.pi)

CENTERED = 0.613
"""Points at mutual distances of at most 1 lie within sqrt(3 / 8) of one point (Jung 1901)."""


@dataclass(frozen=True)
class OdometryErrorModel:
    """
    Greatest errors of scaled odometry.

    Parameters
    ----------
    translation_per_m, translation_per_rad : float
        Error of a step, in m per m travelled and in m per rad turned.
    rotation_per_m, rotation_per_rad : float
        Error of a turn, in rad per m travelled and in rad per rad turned. Lengths and turns are
        those of the stated poses.
    constant_m, constant_rad : float
        Errors that do not accumulate along the path. The stated poses are the poses of a track
        with the other errors only, plus one constant error each. Any two of these differ by at
        most `constant_m` in position and `constant_rad` in heading; no heading errs by more.
    latency_s : float
        The pose stamped t was the true pose at some time within this of t.
    tilt_rad : float, optional
        Error of roll and pitch together, as an angle, if the z axis of the odometry frame is
        upright. Without it nothing is remembered in space.
    max_gap_s : float
        If stamps are farther apart, messages count as lost, and only the limits of the robot bound
        its motion in between. With infinity none count as lost.
    restart_gap_s : float
        If stamps are farther apart, the odometry counts as restarted and does not bound the motion
        in between. With infinity only other signs show a restart.
    translation_scale : float
        True distance over reported distance, up to the errors, which count per m of the scaled
        distance.

    Raises
    ------
    ConfigError
        If a bound is negative, one other than the gaps is not finite, or the scale is beyond
        0.01 and 100.

    """

    translation_per_m: float = 0.0
    translation_per_rad: float = 0.0
    rotation_per_m: float = 0.0
    rotation_per_rad: float = 0.0
    constant_m: float = 0.0
    constant_rad: float = 0.0
    latency_s: float = 0.0
    tilt_rad: float | None = None
    max_gap_s: float = 1.0
    restart_gap_s: float = math.inf
    translation_scale: float = 1.0

    def __post_init__(self) -> None:
        gaps = dict.fromkeys(('max_gap_s', 'restart_gap_s'), {'at_least': 0.0, 'finite': False})
        scale = {'translation_scale': {'at_least': 1.0 / MOST_SCALE, 'at_most': MOST_SCALE}}
        others = {field.name: {'at_least': 0.0} for field in fields(self)}
        keep_numbers(self, 'odometry_error.', {**others, **gaps, **scale})

    def scaled(self, position_m: np.ndarray) -> np.ndarray:
        """
        Return the position on the track for a reported position.

        The rounded product is the track by definition, so its rounding widens nothing.
        """
        return np.asarray(self.translation_scale * position_m)

    @property
    def centered_m(self) -> float:
        """Bound of the distance of stated positions from some track, which may be shifted."""
        return step_up(CENTERED * self.constant_m)

    @property
    def least_tilt_rad(self) -> float:
        """The error of roll and pitch; zero if none is stated."""
        return 0.0 if self.tilt_rad is None else self.tilt_rad


def most_up(rate: float | np.ndarray, amounts: np.ndarray) -> np.ndarray:
    """Return upper bounds of products; zero if the rate or the amount is zero."""
    there = (amounts > 0.0) & (rate > 0.0)
    return np.where(there, up(rate * np.where(there, amounts, 1.0)), 0.0)


def step_errors(
    error: OdometryErrorModel, lengths_m: np.ndarray, angles_rad: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """
    Return the greatest errors of steps.

    Parameters
    ----------
    error : OdometryErrorModel
    lengths_m, angles_rad : numpy.ndarray, shape (n,)
        The lengths and turns of the steps; infinite if unbounded.

    Returns
    -------
    errors_m, errors_rad : numpy.ndarray, shape (n,)

    """
    of_way_m = most_up(error.translation_per_m, lengths_m)
    of_way_rad = most_up(error.rotation_per_m, lengths_m)
    way_m = up(of_way_m + most_up(error.translation_per_rad, angles_rad))
    turn_rad = up(of_way_rad + most_up(error.rotation_per_rad, angles_rad))
    # No rotation is off by more than half a turn.
    turn_rad = np.minimum(turn_rad, HALF_TURN_RAD)
    # The constant error of a pose turns with the track.
    return up(way_m + most_up(error.centered_m, turn_rad)), turn_rad
