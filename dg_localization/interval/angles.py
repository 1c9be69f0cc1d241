# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Angles and their sines and cosines, rounded outward, for numbers and numpy arrays.

IEEE 754 says nothing about the functions of the C library. Those of glibc and NumPy err by less
than four units in the last place, at most 1.8e-15 for an angle below 2 pi. `ANGLE_ROUNDING` is
added to a result of such a function, or to an angle that a few of them computed.
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.arrays import Interval
from dg_localization.interval.rounding import step_up

Number = TypeVar('Number', float, NDArray[np.float64])

ANGLE_ROUNDING = 1e-14
"""In rad for angles, dimensionless for sines and cosines."""

LARGEST_ANGLE_RAD = 4.0 * math.pi
"""For larger angles the double 2 pi is too far from a period: the sine is bounded by [-1, 1]."""


def angle_up(angle_rad: Number) -> Number:
    """
    Return an upper bound of a computed angle.

    Parameters
    ----------
    angle_rad : float or ndarray
        Sum of a few angles below 2 pi, computed by functions like `atan2` from unit vectors; or
        such a half width, to which the error of its center is to be added.

    Returns
    -------
    float or ndarray
        The angle plus `ANGLE_ROUNDING`.

    """
    return angle_rad + ANGLE_ROUNDING


def angle_down(angle_rad: Number) -> Number:
    """Return a lower bound of a computed angle; see `angle_up`."""
    return angle_rad - ANGLE_ROUNDING


def cosine(angle_rad: Interval) -> Interval:
    """
    Bound the cosines of angles.

    Parameters
    ----------
    angle_rad : Interval
        Of any shape; ends beyond `LARGEST_ANGLE_RAD` bound nothing.

    Returns
    -------
    Interval
        Within [-1, 1].

    """
    low_rad, high_rad = np.asarray(angle_rad.lower), np.asarray(angle_rad.upper)
    known = np.maximum(np.abs(low_rad), np.abs(high_rad)) <= LARGEST_ANGLE_RAD
    ends = np.cos(np.where(known, low_rad, 0.0)), np.cos(np.where(known, high_rad, 0.0))
    low = np.minimum(*ends) - ANGLE_ROUNDING
    high = np.maximum(*ends) + ANGLE_ROUNDING
    top = ~known | _holds_multiple(low_rad, high_rad, 0.0)
    bottom = ~known | _holds_multiple(low_rad, high_rad, math.pi)
    return Interval(
        np.where(bottom, -1.0, np.maximum(low, -1.0)), np.where(top, 1.0, np.minimum(high, 1.0))
    )


def _holds_multiple(
    low_rad: NDArray[np.float64], high_rad: NDArray[np.float64], offset_rad: float
) -> NDArray[np.bool_]:
    """Return where offset + 2 k pi may lie between two angles for some whole k."""
    turn = 2.0 * math.pi
    with np.errstate(invalid='ignore'):
        next_one = turn * np.ceil((low_rad - offset_rad - ANGLE_ROUNDING) / turn) + offset_rad
        return np.asarray(next_one <= high_rad + ANGLE_ROUNDING)


_QUARTER_TURN = Interval.around(0.5 * math.pi, ANGLE_ROUNDING)


def sine(angle_rad: Interval) -> Interval:
    """Bound the sines of angles; see `cosine`."""
    return cosine(angle_rad - _QUARTER_TURN)


def cosine_and_sine(angle_rad: Interval) -> Interval:
    """Bound the cosines and the sines of angles, in this order along a new first axis."""
    return cosine(Interval.stack([angle_rad, angle_rad - _QUARTER_TURN], axis=0))


def sine_bounds(low_rad: float, high_rad: float) -> tuple[float, float]:
    """Bound the sine of one angle between two others, as floats; see `cosine`."""
    result = sine(Interval.between(low_rad, high_rad))
    return float(result.lower), float(result.upper)


def arcsine_up(x: float) -> float:
    """Return an upper bound of asin(x) in rad for x >= 0; pi/2 and more where x exceeds 1."""
    return angle_up(math.asin(min(1.0, x)))


def chord_up(angle_rad: float) -> float:
    """Return an upper bound of the distance of two unit vectors at an angle in [0, pi]."""
    return step_up(2.0 * (math.sin(0.5 * angle_rad) + ANGLE_ROUNDING))


def rotation_2d(angle_rad: float, half_width_rad: float) -> Interval:
    """
    Return the matrices of all rotations by angles within the half width, shape (2, 2).

    Angles beyond `LARGEST_ANGLE_RAD` bound nothing.
    """
    angle = Interval.around(angle_rad, angle_up(half_width_rad))
    x, y = cosine(angle), sine(angle)
    return Interval.stack([Interval.stack([x, -y]), Interval.stack([y, x])], axis=0)
