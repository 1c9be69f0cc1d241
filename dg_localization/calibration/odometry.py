# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of the errors of odometry, from its path beside the true one.

The turn and the way of many windows, short and long, are compared with the truth. The way is that
of the measured steps along the true headings, so that an error of the heading does not count again
as one of the way.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.calibration.bounds import DECIMALS, Choice, n_kept
from dg_localization.calibration.truth import TrueTrack

FloatArray = NDArray[np.float64]

WINDOWS_S = (0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 40.0)
EVERY_S = 0.5
STEEPEST = 1.0
SLOPES = 401


@dataclass(frozen=True)
class OdometryWindows:
    """
    Windows of odometry, and how wrong it was over each; all arrays of shape (k,).

    Attributes
    ----------
    seconds : ndarray
        Their lengths in time.
    way_m, turn_rad : ndarray
        How far the robot went and turned along the samples.
    error_m, error_rad : ndarray
        Of the way along true headings, and of the turn about the vertical axis.

    """

    seconds: FloatArray
    way_m: FloatArray
    turn_rad: FloatArray
    error_m: FloatArray
    error_rad: FloatArray


@dataclass(frozen=True)
class OdometryFit:
    """
    Bounds of odometry, in the terms of `OdometryErrorModel`.

    Attributes
    ----------
    constant_m, translation_per_m, constant_rad, rotation_per_rad : float
        The bounds.
    windows, excluded : int
        How many windows there were, and how many of them exceed the bounds.

    """

    constant_m: float
    translation_per_m: float
    constant_rad: float
    rotation_per_rad: float
    windows: int
    excluded: int


def odometry_windows(
    stamps_s: ArrayLike, positions_m: ArrayLike, rotations: ArrayLike, truth: TrueTrack
) -> OdometryWindows:
    """
    Compare odometry with the truth over windows of 0.5 to 40 s.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        Increasing.
    positions_m : array_like, shape (n, 3)
    rotations : array_like, shape (n, 3, 3)
        From body to odometry frame.
    truth : TrueTrack

    """
    stamps = np.asarray(stamps_s, dtype=float)
    turns = np.asarray(rotations, dtype=float)
    true_m, true = truth.positions_at(stamps), truth.rotations_at(stamps)
    steps_m = np.diff(np.asarray(positions_m, dtype=float), axis=0)
    in_body = np.einsum('mji,mj->mi', turns[:-1], steps_m)
    along_m = np.einsum('mij,mj->mi', true[:-1], in_body)
    yaws, true_yaws = (np.arctan2(r[:, 1, 0], r[:, 0, 0]) for r in (turns, true))
    way_m = _cumulative(np.linalg.norm(steps_m, axis=1))
    turned_rad = _cumulative(np.abs(_remainder(np.diff(yaws))))
    # As many of each length: the short ones must not decide alone.
    begins = np.searchsorted(stamps, np.arange(stamps[0], stamps[-1], EVERY_S))
    columns = []
    for seconds in WINDOWS_S:
        ends = np.searchsorted(stamps, stamps[begins] + seconds)
        first, last = begins[ends < len(stamps)], ends[ends < len(stamps)]
        whole_m = np.array(
            [along_m[a:b].sum(axis=0) for a, b in zip(first, last, strict=True)]
        ).reshape(-1, 3)
        error_m = np.linalg.norm(whole_m - (true_m[last] - true_m[first]), axis=1)
        error_rad = _remainder((yaws[last] - yaws[first]) - (true_yaws[last] - true_yaws[first]))
        columns.append(
            (
                stamps[last] - stamps[first],
                way_m[last] - way_m[first],
                turned_rad[last] - turned_rad[first],
                error_m,
                np.abs(error_rad),
            )
        )
    joined = np.concatenate([np.array(column) for column in columns], axis=1)
    return OdometryWindows(*joined[:, np.all(np.isfinite(joined), axis=0)])


def fit_odometry(windows: OdometryWindows, choice: Choice) -> OdometryFit:
    """
    Return bounds, a constant and a slope for the way and for the turn.

    Parameters
    ----------
    windows : OdometryWindows
        At least one.
    choice : Choice

    """
    constant_m, per_m = _fit_line(windows.way_m, windows.error_m, choice)
    constant_rad, per_rad = _fit_line(windows.turn_rad, windows.error_rad, choice)
    beyond = (windows.error_m > constant_m + per_m * windows.way_m) | (
        windows.error_rad > constant_rad + per_rad * windows.turn_rad
    )
    return OdometryFit(
        constant_m, per_m, constant_rad, per_rad, len(beyond), int(np.count_nonzero(beyond))
    )


def _fit_line(way: FloatArray, error: FloatArray, choice: Choice) -> tuple[float, float]:
    """Return the constant and the slope that hold the errors and are least in the mean."""
    kept = n_kept(len(way), choice.keep)
    slopes = np.linspace(0.0, STEEPEST, SLOPES)
    constants = [max(0.0, np.partition(error - s * way, kept - 1)[kept - 1]) for s in slopes]
    best = int(np.argmin(np.array(constants) + slopes * np.mean(way)))
    widened = 1.0 + choice.margin
    scale = 10.0**DECIMALS
    constant, slope = np.ceil(np.array([constants[best], slopes[best]]) * widened * scale) / scale
    return float(constant), float(slope)


def _cumulative(steps: FloatArray) -> FloatArray:
    return np.concatenate([[0.0], np.cumsum(steps)])


def _remainder(angles_rad: FloatArray) -> FloatArray:
    return np.remainder(angles_rad + np.pi, 2.0 * np.pi) - np.pi
