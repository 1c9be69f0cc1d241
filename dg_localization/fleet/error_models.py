# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From a reading to bounds: ranges (REP-117 included) and rays.

Bounds are rounded outward. The reading itself counts as an exact number.
"""

from __future__ import annotations

import math
from typing import Any, SupportsFloat, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.fleet.sensors import Mount, RangeErrorModel
from dg_localization.fleet.vocabulary import Rejection, RejectionReason
from dg_localization.interval.angles import angle_down, angle_up, arcsine_up
from dg_localization.interval.bounds import (
    product_down,
    product_up,
    quotient_up,
    sqrt_up,
    sum_down,
    sum_up,
)

FloatArray = NDArray[np.float64]


SINGLE = 6e-8
"""Relative rounding error of single precision, as in ``sensor_msgs/Range``."""

MOST_QUOTED = 100
"""Characters of a malformed value that a message quotes."""


def real_number(value: object) -> float | None:
    """Return a number of Python or NumPy, or an array without axes, in double precision."""
    if isinstance(value, float):
        return float(value)
    if not is_single(value) or not _are_real(np.asanyarray(value)):
        return None
    try:
        return float(cast(SupportsFloat, value))
    except (TypeError, ValueError, OverflowError):
        return None


def finite_number(value: object) -> float | None:
    """Return what `real_number` does; None where it is infinite or no number."""
    number = real_number(value)
    return number if number is not None and math.isfinite(number) else None


def is_single(value: object) -> bool:
    """Return whether a measurement is one value, such as a range, and no ray."""
    try:
        return isinstance(value, float) or np.ndim(cast(ArrayLike, value)) == 0
    except ValueError:
        # Lists of different lengths are no array.
        return False


def real_numbers(values: ArrayLike) -> FloatArray | None:
    """Return numbers as a new array of one axis; None where some are none."""
    try:
        array = np.asanyarray(values)
        return np.array(array, dtype=float).reshape(-1) if _are_real(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def _are_real(array: NDArray[Any]) -> bool:
    """
    Return whether all entries of an array are real numbers.

    NumPy would make numbers of text and truth values, and leave imaginary parts and masks out.
    """
    return array.dtype.kind not in 'bcSU' and not np.ma.is_masked(array)


def quoted(value: object) -> str:
    """Return a malformed value as it is written, cut to a length that people read."""
    try:
        text = repr(value)
    except ValueError:
        # Python writes no integer of more than 4,300 digits.
        text = f'of type {type(value).__name__}'
    return text if len(text) <= MOST_QUOTED else f'{text[:MOST_QUOTED]} ...'


def distance_bounds_m(
    model: RangeErrorModel, range_m: float, variance_m2: float = 0.0
) -> tuple[float, float]:
    """
    Return all true distances a reading allows.

    Parameters
    ----------
    model : RangeErrorModel
    range_m : float
        Finite and not negative.
    variance_m2 : float
        Variance of the reading; counts only where the model has a `sigma_factor`.

    Returns
    -------
    lower, upper : float
        In m. The upper one is below zero when no distance could give the reading.

    """
    spread_m = 0.0
    if model.sigma_factor > 0.0:
        spread_m = product_up(model.sigma_factor, sqrt_up(variance_m2))
    least = model.min_error_m, model.min_error_relative
    most = model.max_error_m, model.max_error_relative
    # Beyond a reading at which the two lines cross, they change places.
    high_m = max(sum_up(m, product_up(share, range_m), spread_m) for m, share in (least, most))
    low_m = min(sum_down(m, product_down(share, range_m), -spread_m) for m, share in (least, most))
    return max(0.0, sum_down(range_m, -high_m)), sum_up(range_m, -low_m)


def likeliest_distance_m(model: RangeErrorModel, range_m: float) -> float:
    """
    Return the likeliest distance of a reading; NaN when it is infinite.

    Bounds that are not symmetric have to hold a tail, and most errors are far from its end. Where
    the model does not state the likeliest error, it is taken to be in the middle between the
    least one in size and the middle of the bounds.
    """
    if math.isinf(range_m):
        return math.nan
    if model.expected_error_m is None and model.expected_error_relative == 0.0:
        low_m, high_m = sorted(
            (
                model.min_error_m + model.min_error_relative * range_m,
                model.max_error_m + model.max_error_relative * range_m,
            )
        )
        error_m = 0.5 * (min(max(0.0, low_m), high_m) + 0.5 * (low_m + high_m))
    else:
        error_m = (model.expected_error_m or 0.0) + model.expected_error_relative * range_m
    return max(0.0, range_m - error_m)


def interpret_range(
    model: RangeErrorModel,
    range_m: float,
    min_range_m: float | None = None,
    max_range_m: float | None = None,
    variance_m2: float | None = None,
) -> tuple[float, float] | Rejection:
    """
    Return all true distances a reading allows, following REP-117, or why it says nothing.

    Parameters
    ----------
    model : RangeErrorModel
    range_m : float
        NaN is no reading, +inf is nothing within `max_range_m`, -inf is closer than
        `min_range_m`.
    min_range_m, max_range_m : float, optional
        Limits of the sensor. None and NaN mean not given, and so does a maximum of zero.
    variance_m2 : float, optional
        Variance of the reading.

    Returns
    -------
    tuple of float or Rejection
        Lower and upper distance in m.

    """
    limits = []
    for name, limit_m in (('min_range', min_range_m), ('max_range', max_range_m)):
        limit = math.nan if limit_m is None else real_number(limit_m)
        if limit is None:
            text = f'{name} {quoted(limit_m)} is not allowed, it must be a number of meters'
            return Rejection(RejectionReason.INVALID_RANGE, text)
        limits.append(limit)
    minimum = 0.0 if math.isnan(limits[0]) else limits[0]
    maximum = math.inf if not limits[1] or math.isnan(limits[1]) else limits[1]
    variance = 0.0 if variance_m2 is None else real_number(variance_m2)
    if variance is None or (model.sigma_factor > 0.0 and not variance >= 0.0):
        text = f'variance {quoted(variance_m2)} m^2 is not allowed, it must be a number >= 0'
        return Rejection(RejectionReason.INVALID_VARIANCE, text)
    is_vague = math.isinf(variance) and model.sigma_factor > 0.0
    if is_vague:
        variance = 0.0
    if math.isinf(range_m):
        found = _interpret_infinite(model, range_m, minimum, maximum, variance)
    else:
        rejection = _reject_reading(model, range_m, minimum, maximum)
        found = rejection or distance_bounds_m(model, range_m, variance)
    return (0.0, math.inf) if is_vague and not isinstance(found, Rejection) else found


def _interpret_infinite(
    model: RangeErrorModel, range_m: float, minimum: float, maximum: float, variance: float
) -> tuple[float, float] | Rejection:
    """Return what a reading of +inf or -inf says."""
    if range_m > 0.0:
        if model.beyond_max_is_far and math.isfinite(maximum):
            return distance_bounds_m(model, maximum, variance)[0], math.inf
        text = 'range inf m is no reading: it says that nothing is within max_range'
        return Rejection(RejectionReason.NOTHING_IN_RANGE, text)
    if minimum > 0.0 and math.isfinite(minimum):
        return 0.0, distance_bounds_m(model, minimum, variance)[1]
    text = 'range -inf m says closer than min_range, but the sensor states no min_range'
    return Rejection(RejectionReason.TOO_CLOSE, text)


def _reject_reading(
    model: RangeErrorModel, range_m: float, minimum: float, maximum: float
) -> Rejection | None:
    """Return why a reading that is not infinite is none, if so."""
    if math.isnan(range_m):
        return Rejection(RejectionReason.NAN, 'range nan m is no reading')
    if range_m < 0.0:
        text = f'range {_short(range_m)} m is negative, it must be >= 0'
        return Rejection(RejectionReason.NEGATIVE, text)
    for name, limit_m, is_past in (
        (
            'at or below min_reading',
            model.min_reading_m,
            range_m <= model.min_reading_m * (1.0 + SINGLE),
        ),
        (
            'at or above max_reading',
            model.max_reading_m,
            range_m >= model.max_reading_m * (1.0 - SINGLE),
        ),
    ):
        if is_past:
            text = f'range {_short(range_m)} m is no reading: it is {name}, {_short(limit_m)} m'
            return Rejection(RejectionReason.NO_READING, text)
    if range_m > maximum:
        text = f'range {_short(range_m)} m is above max_range of the sensor, {_short(maximum)} m'
        return Rejection(RejectionReason.ABOVE_MAX, text)
    if range_m < minimum:
        text = f'range {_short(range_m)} m is below min_range of the sensor, {_short(minimum)} m'
        return Rejection(RejectionReason.BELOW_MIN, text)
    return None


def _short(value_m: float) -> float:
    """Return a number for people, who are shown no more digits than single precision has."""
    return float(f'{value_m:.9g}')


def interpret_ray(ray_xyz: ArrayLike, dimension: int) -> np.ndarray | Rejection:
    """
    Return the unit vector of a measured ray, or why there is none.

    Parameters
    ----------
    ray_xyz : array_like, shape (3,)
        In the body frame, of any length above zero.
    dimension : {2, 3}
        In the plane only the horizontal part counts.

    Returns
    -------
    numpy.ndarray, shape (3,), or Rejection

    """
    components = real_numbers(ray_xyz)
    # Plain numbers: arrays of three cost several times as much, and every ray comes through here.
    ray = [] if components is None else components.tolist()
    if len(ray) != 3 or not all(map(math.isfinite, ray)):
        text = f'ray {quoted(ray or ray_xyz)} is not allowed, it must have three finite components'
        return Rejection(RejectionReason.INVALID_RAY, text)
    # Scaled first: the squares of tiny and of huge components would leave the number range.
    largest = max(map(abs, ray)) or 1.0
    x, y, z = (component / largest for component in ray)
    if dimension == 2:
        z = 0.0
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1e-6:
        part = ' in the horizontal plane' if dimension == 2 else ''
        text = f'ray {ray} has no direction{part}'
        return Rejection(RejectionReason.ZERO_RAY, text)
    return np.array([x / length, y / length, z / length])


def in_body_frame(mount: Mount | None, ray_xyz: ArrayLike) -> ArrayLike | Rejection:
    """
    Return a measured ray in the frame of the robot, or why there is none.

    Parameters
    ----------
    mount : Mount or None
        Of the sensor; None where it is that of the robot itself.
    ray_xyz : array_like, shape (3,)
        In the frame of the sensor, of any length above zero.

    """
    if mount is None:
        return ray_xyz
    ray = interpret_ray(ray_xyz, 3)
    if isinstance(ray, Rejection):
        return ray
    quaternion = np.array(mount.rotation_xyzw)
    return rotation_of_quaternion(quaternion / np.linalg.norm(quaternion)) @ ray


def leaves_plane(ray_xyz: ArrayLike, half_width_rad: float) -> bool:
    """Return whether a ray points up or down by more than its error allows in the plane."""
    x, y, z = ray = np.asarray(ray_xyz, dtype=float)
    scale = np.abs(ray).max()
    pitch_rad = math.atan2(abs(z / scale), math.hypot(x / scale, y / scale))
    return angle_down(pitch_rad) > half_width_rad


def projected_half_width_rad(ray_xyz: ArrayLike, half_width_rad: float) -> float:
    """
    Return how far the projection of a ray on the plane may be from that of the true direction.

    By the sine rule of a spherical triangle, the sine of an azimuth error is at most that of the
    angle between the two over the horizontal part of the ray.

    Parameters
    ----------
    ray_xyz : array_like, shape (3,)
        Of any length above zero.
    half_width_rad : float
        Greatest angle between the ray and the true direction.

    """
    ray = np.asarray(ray_xyz, dtype=float)
    x, y, z = ray / np.abs(ray).max()
    horizontal = angle_down(math.hypot(x, y) / math.hypot(x, y, z))
    if half_width_rad >= 0.5 * math.pi or horizontal <= 0.0:
        return math.pi
    ratio = quotient_up(angle_up(math.sin(half_width_rad)), horizontal)
    return arcsine_up(ratio) if ratio < 1.0 else math.pi
