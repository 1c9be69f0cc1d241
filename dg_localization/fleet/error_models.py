# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds from readings: ranges (including REP-117) and rays; checks of reported poses.

Bounds are rounded outward. The reading itself counts as an exact number.
"""

from __future__ import annotations

import math
from typing import Any, SupportsFloat, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.fleet.odometry_error import OdometryErrorModel
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.fleet.sensors import Mount, RangeErrorModel
from dg_localization.fleet.vocabulary import RangeMessage, RefusedError, RejectionReason
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
    """Return `real_number` of a value; None if it is infinite or no number."""
    number = real_number(value)
    return number if number is not None and math.isfinite(number) else None


def is_single(value: object) -> bool:
    """Return whether a measurement is a single value, such as a range, not a ray."""
    try:
        return isinstance(value, float) or np.ndim(cast(ArrayLike, value)) == 0
    except ValueError:
        # Lists of different lengths are no array.
        return False


def real_numbers(values: ArrayLike) -> FloatArray | None:
    """Return numbers as a new array of one axis; None if some are no numbers."""
    try:
        array = np.asanyarray(values)
        return np.array(array, dtype=float).reshape(-1) if _are_real(array) else None
    except (TypeError, ValueError, OverflowError):
        return None


def _are_real(array: NDArray[Any]) -> bool:
    """
    Return whether all entries of an array are real numbers.

    NumPy would convert text and truth values to numbers, and drop imaginary parts and masks.
    """
    return array.dtype.kind not in 'bcSU' and not np.ma.is_masked(array)


def quoted(value: object) -> str:
    """Return the text of a malformed value, cut to a readable length."""
    try:
        text = repr(value)
    except ValueError:
        # Python writes no integer of more than 4,300 digits.
        text = f'of type {type(value).__name__}'
    return text if len(text) <= MOST_QUOTED else f'{text[:MOST_QUOTED]} ...'


def distance_bounds_m(
    model: RangeErrorModel, range_m: float, variance_m2: float = 0.0
) -> tuple[float, float]:
    """Return bounds of all true distances that a reading allows."""
    spread_m = 0.0
    if model.sigma_factor > 0.0:
        spread_m = product_up(model.sigma_factor, sqrt_up(variance_m2))
    least = model.min_error_m, model.min_error_relative
    most = model.max_error_m, model.max_error_relative
    # Beyond the reading at which the two lines cross, they swap.
    high_m = max(sum_up(m, product_up(share, range_m), spread_m) for m, share in (least, most))
    low_m = min(sum_down(m, product_down(share, range_m), -spread_m) for m, share in (least, most))
    return max(0.0, sum_down(range_m, -high_m)), sum_up(range_m, -low_m)


def likeliest_distance_m(model: RangeErrorModel, range_m: float) -> float:
    """
    Return the likeliest distance of a reading; NaN if it is infinite.

    Asymmetric bounds cover a tail, and most errors are far from its end. If the model does not
    state the likeliest error, it is taken midway between the smallest error in size and the middle
    of the bounds.
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


def interpret_range(model: RangeErrorModel, message: RangeMessage) -> tuple[float, float]:
    """
    Return lower and upper bounds of all true distances that a reading allows, by REP-117.

    NaN is no reading, +inf is nothing within the maximum of the sensor, -inf is closer than its
    minimum. Limits that are None or NaN, and a maximum of zero, count as not given.
    """
    range_m, limits = required_number(message.range_m, 'range'), []
    for name, limit_m in (('min_range', message.min_range_m), ('max_range', message.max_range_m)):
        limits.append(math.nan if limit_m is None else required_number(limit_m, name))
    minimum = 0.0 if math.isnan(limits[0]) else limits[0]
    maximum = math.inf if not limits[1] or math.isnan(limits[1]) else limits[1]
    variance = 0.0 if message.variance_m2 is None else real_number(message.variance_m2)
    if variance is None or (model.sigma_factor > 0.0 and not variance >= 0.0):
        text = (
            f'variance {quoted(message.variance_m2)} m^2 is not allowed, it must be a number >= 0'
        )
        raise RefusedError(RejectionReason.INVALID_VARIANCE, text)
    is_vague = math.isinf(variance) and model.sigma_factor > 0.0
    if is_vague:
        variance = 0.0
    if math.isinf(range_m):
        found = _interpret_infinite(model, range_m, minimum, maximum, variance)
    else:
        _check_reading(model, range_m, minimum, maximum)
        found = distance_bounds_m(model, range_m, variance)
    return (0.0, math.inf) if is_vague else found


def required_number(value: object, name: str) -> float:
    """Return a number of meters in double precision; refuse anything else."""
    number = real_number(value)
    if number is None:
        text = f'{name} {quoted(value)} is not allowed, it must be a number of meters'
        raise RefusedError(RejectionReason.INVALID_RANGE, text)
    return number


def _interpret_infinite(
    model: RangeErrorModel, range_m: float, minimum: float, maximum: float, variance: float
) -> tuple[float, float]:
    """Return the bounds of a reading of +inf or -inf."""
    if range_m > 0.0:
        if model.beyond_max_is_far and math.isfinite(maximum):
            return distance_bounds_m(model, maximum, variance)[0], math.inf
        text = 'range inf m is no reading: it says that nothing is within max_range'
        raise RefusedError(RejectionReason.NOTHING_IN_RANGE, text)
    if minimum > 0.0 and math.isfinite(minimum):
        return 0.0, distance_bounds_m(model, minimum, variance)[1]
    text = 'range -inf m says closer than min_range, but the sensor states no min_range'
    raise RefusedError(RejectionReason.TOO_CLOSE, text)


def _check_reading(model: RangeErrorModel, range_m: float, minimum: float, maximum: float) -> None:
    """Refuse a finite or NaN reading that carries no information."""
    if math.isnan(range_m):
        raise RefusedError(RejectionReason.NAN, 'range nan m is no reading')
    least_m, most_m = model.min_reading_m, model.max_reading_m
    reasons = (
        (range_m < 0.0, RejectionReason.NEGATIVE, 'is negative, it must be >= 0'),
        (
            range_m <= least_m * (1.0 + SINGLE),
            RejectionReason.NO_READING,
            f'is no reading: it is at or below min_reading, {_short(least_m)} m',
        ),
        (
            range_m >= most_m * (1.0 - SINGLE),
            RejectionReason.NO_READING,
            f'is no reading: it is at or above max_reading, {_short(most_m)} m',
        ),
        (
            range_m > maximum,
            RejectionReason.ABOVE_MAX,
            f'is above max_range of the sensor, {_short(maximum)} m',
        ),
        (
            range_m < minimum,
            RejectionReason.BELOW_MIN,
            f'is below min_range of the sensor, {_short(minimum)} m',
        ),
    )
    for is_so, reason, text in reasons:
        if is_so:
            raise RefusedError(reason, f'range {_short(range_m)} m {text}')


def _short(value_m: float) -> float:
    """Return a number for messages, rounded to the digits of single precision."""
    return float(f'{value_m:.9g}')


def interpret_ray(ray_xyz: ArrayLike, dimension: int) -> np.ndarray:
    """Return the unit vector of a ray in the body frame; in the plane, of its projection."""
    components = real_numbers(ray_xyz)
    # Plain numbers: arrays of three take several times as long, and this runs for every ray.
    ray = [] if components is None else components.tolist()
    if len(ray) != 3 or not all(map(math.isfinite, ray)):
        text = f'ray {quoted(ray or ray_xyz)} is not allowed, it must have three finite components'
        raise RefusedError(RejectionReason.INVALID_RAY, text)
    # Scaled first: squares of tiny and of huge components would leave the number range.
    largest = max(map(abs, ray)) or 1.0
    x, y, z = (component / largest for component in ray)
    if dimension == 2:
        z = 0.0
    length = math.sqrt(x * x + y * y + z * z)
    if not length > 1e-6:
        part = ' in the horizontal plane' if dimension == 2 else ''
        text = f'ray {ray} has no direction{part}'
        raise RefusedError(RejectionReason.ZERO_RAY, text)
    return np.array([x / length, y / length, z / length])


def in_body_frame(mount: Mount | None, ray_xyz: ArrayLike) -> ArrayLike:
    """Return a measured ray in the frame of the robot."""
    if mount is None:
        return ray_xyz
    ray = interpret_ray(ray_xyz, 3)
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
    Return the greatest azimuth error of the projection of a ray on the plane.

    By the sine rule of a spherical triangle, the sine of an azimuth error is at most the sine of
    the angle between ray and truth, divided by the horizontal part of the ray.
    """
    ray = np.asarray(ray_xyz, dtype=float)
    x, y, z = ray / np.abs(ray).max()
    horizontal = angle_down(math.hypot(x, y) / math.hypot(x, y, z))
    if half_width_rad >= 0.5 * math.pi or horizontal <= 0.0:
        return math.pi
    ratio = quotient_up(angle_up(math.sin(half_width_rad)), horizontal)
    return arcsine_up(ratio) if ratio < 1.0 else math.pi


def interpret_pose(
    position_xyz: ArrayLike, orientation_xyzw: ArrayLike, error: OdometryErrorModel
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """
    Return a position as reported, the position on the track, and the rotation.

    They are new arrays, so the caller may reuse its own.
    """
    position, quaternion = real_numbers(position_xyz), real_numbers(orientation_xyzw)
    if position is not None and quaternion is not None:
        if _is_pose(position, quaternion):
            rotation = rotation_of_quaternion(quaternion / math.sqrt(quaternion @ quaternion))
            return position, error.scaled(position), rotation
    text = (
        f'position {_written(position, position_xyz)}, orientation '
        f'{_written(quaternion, orientation_xyzw)}: it must be three numbers up to '
        f'{FARTHEST_M:g} m and a unit quaternion'
    )
    raise RefusedError(RejectionReason.INVALID_ODOMETRY, text)


def _is_pose(position: np.ndarray, quaternion: np.ndarray) -> bool:
    """Return whether numbers are a position that is not too far and a unit quaternion."""
    if position.shape != (3,) or quaternion.shape != (4,):
        return False
    is_near = all(abs(x) <= FARTHEST_M for x in position.tolist())
    return is_near and abs(math.hypot(*quaternion.tolist()) - 1.0) < 0.01


def _written(numbers: np.ndarray | None, given: ArrayLike) -> str:
    """Return the text of a malformed position or orientation, for a message."""
    return quoted(given if numbers is None else numbers.tolist())
