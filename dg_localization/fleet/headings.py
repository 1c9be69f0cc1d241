"""
Headings: how a robot is turned, from the rays it has measured and where its targets are.

Each ray says how the body is turned, up to its own error and up to what the enclosures of both
ends leave open of the direction between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints import Ray, angle_rad
from dg_localization.fleet.intervals import ROUNDING_RAD, Interval

FloatArray = NDArray[np.float64]


class NoHeadingError(ValueError):
    """The rays of a robot contradict each other, wherever in their enclosures the targets are."""


@dataclass(frozen=True)
class Heading:
    """
    How a robot is turned in the fixed frame.

    Parameters
    ----------
    orientation_xyzw : numpy.ndarray, shape (4,)
        Unit quaternion from body to fixed frame.
    half_width_rad : float
        Greatest angle to the true orientation.

    """

    orientation_xyzw: FloatArray
    half_width_rad: float


@dataclass(frozen=True)
class _Sight:
    """A ray, the direction it should have in the fixed frame, and the error of both together."""

    ray: FloatArray
    direction: FloatArray
    placed: FloatArray
    half_width_rad: float


def estimate_heading(
    observer: int, rays: list[Ray], positions: FloatArray, enclosure: Interval
) -> Heading | None:
    """
    Return how a robot is turned.

    Parameters
    ----------
    observer : int
        The row of the robot.
    rays : list of Ray
        What it sees; targets are rows.
    positions : numpy.ndarray, shape (n, q)
        One placement; the heading is made to fit it.
    enclosure : Interval, shape (n, q)
        Coordinates of all placements; the half width allows for every one of them.

    Returns
    -------
    Heading or None
        None when the rays do not fix it.

    Raises
    ------
    NoHeadingError
        If no heading agrees with all rays.

    """
    sights = [
        sight for ray in rays if (sight := _sight(observer, ray, positions, enclosure)) is not None
    ]
    sights.sort(key=lambda sight: sight.half_width_rad)
    _check_angles(sights)
    if positions.shape[1] == 2:
        return _planar_heading(sights)
    return _spatial_heading(sights)


def best_rotation(
    start: FloatArray, end: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """
    Return the rotation that takes vectors closest to others, by least squares.

    Parameters
    ----------
    start, end : numpy.ndarray, shape (m, q)
    weights : numpy.ndarray, shape (m,), optional

    Returns
    -------
    numpy.ndarray, shape (q, q)

    """
    scaled = end if weights is None else end * weights[:, None]
    left, _, right = np.linalg.svd(scaled.T @ start)
    signs = np.ones(start.shape[1])
    signs[-1] = np.linalg.det(left @ right)
    return np.asarray(left @ np.diag(signs) @ right)


def _sight(observer: int, ray: Ray, positions: FloatArray, enclosure: Interval) -> _Sight | None:
    """Return a ray with the direction of its target, or None when that may be any."""
    gap = enclosure[ray.target] - enclosure[observer]
    if not (np.isfinite(gap.lower).all() and np.isfinite(gap.upper).all()):
        return None
    middle = (gap.lower + gap.upper) / 2.0
    length = float(np.linalg.norm(middle))
    if length == 0.0:
        return None
    direction = middle / length
    corners = [np.array(corner) for corner in product(*zip(gap.lower, gap.upper, strict=True))]
    # A cone of less than a right angle is convex: it holds the box when it holds the corners.
    spread = max(_angle(direction, corner) for corner in corners) + ROUNDING_RAD
    if spread >= math.pi / 2:
        return None
    placed = positions[ray.target] - positions[observer]
    span = float(np.linalg.norm(placed))
    placed = placed / span if span > 0.0 and math.isfinite(span) else direction
    width = spread + ray.half_width_rad + ROUNDING_RAD
    return _Sight(ray.direction[: len(middle)], direction, placed, width)


def _angle(a: FloatArray, b: FloatArray) -> float:
    """Return the angle between two vectors of length 2 or 3, in [0, pi]; pi when one is zero."""
    if not a.any() or not b.any():
        return math.pi
    pad = (0, 3 - len(a))
    return angle_rad(np.pad(a, pad), np.pad(b, pad))


def _check_angles(sights: list[_Sight]) -> None:
    """Raise `NoHeadingError` when two targets are seen under an angle they cannot have."""
    for a, b in combinations(sights, 2):
        difference = abs(_angle(a.ray, b.ray) - _angle(a.direction, b.direction))
        if difference > a.half_width_rad + b.half_width_rad:
            raise NoHeadingError('two rays differ from the angle between their targets')


def _planar_heading(sights: list[_Sight]) -> Heading | None:
    """Return the common part of the arcs that the sights allow; the narrowest comes first."""
    arcs = [sight for sight in sights if sight.half_width_rad < math.pi]
    if not arcs:
        return None
    centre, width = _yaw(arcs[0].direction, arcs[0].ray), arcs[0].half_width_rad
    low, high = -width, width
    for sight in arcs[1:]:
        # Where two arcs together are wider than a circle they may meet twice: no common arc.
        if width + sight.half_width_rad >= math.pi:
            continue
        offset = math.remainder(_yaw(sight.direction, sight.ray) - centre, 2.0 * math.pi)
        low = max(low, offset - sight.half_width_rad - ROUNDING_RAD)
        high = min(high, offset + sight.half_width_rad + ROUNDING_RAD)
    if low > high:
        raise NoHeadingError('the rays leave no common heading')
    fitted = _fitted_yaw(arcs)
    yaw = min(max(math.remainder(fitted - centre, 2.0 * math.pi), low), high)
    half_width_rad = max(yaw - low, high - yaw) + ROUNDING_RAD
    half_yaw = (centre + yaw) / 2.0
    orientation = np.array([0.0, 0.0, math.sin(half_yaw), math.cos(half_yaw)])
    return Heading(orientation, half_width_rad)


def _yaw(direction: FloatArray, ray: FloatArray) -> float:
    """Return the heading under which a target in that direction is seen along that ray."""
    return math.atan2(direction[1], direction[0]) - math.atan2(ray[1], ray[0])


def _fitted_yaw(sights: list[_Sight]) -> float:
    """Return the heading that fits the placement best."""
    yaws = [_yaw(sight.placed, sight.ray) for sight in sights]
    weights = [1.0 / (sight.half_width_rad + 1e-6) for sight in sights]
    sine = sum(w * math.sin(yaw) for w, yaw in zip(weights, yaws, strict=True))
    cosine = sum(w * math.cos(yaw) for w, yaw in zip(weights, yaws, strict=True))
    return math.atan2(sine, cosine)


def _spatial_heading(sights: list[_Sight]) -> Heading | None:
    """
    Return the rotation that fits the placement best, and how wrong it may be.

    The true rotation differs from it by a rotation by psi, which moves each ray by at most eta.
    It moves a unit vector at the angle gamma from its axis by sin(half) = sin(psi/2) sin(gamma).
    For two rays at the angle alpha, one of the two sines is at least the smaller of sin(alpha/2)
    and cos(alpha/2), whatever the axis; so sin(psi/2) <= sin(eta/2) / that.
    """
    if len(sights) < 2:
        return None
    rays = np.array([sight.ray for sight in sights])
    placed = np.array([sight.placed for sight in sights])
    weights = np.array([1.0 / (sight.half_width_rad + 1e-6) for sight in sights])
    rotation = best_rotation(rays, placed, weights)
    errors = [
        min(math.pi, sight.half_width_rad + _angle(rotation @ sight.ray, sight.direction))
        for sight in sights
    ]
    least = 1.0
    for first, second in combinations(range(len(sights)), 2):
        alpha = _angle(rays[first], rays[second])
        lever = min(math.sin(alpha / 2.0), math.cos(alpha / 2.0))
        if lever > 0.0:
            least = min(least, math.sin(max(errors[first], errors[second]) / 2.0) / lever)
    if least >= 1.0:
        return None
    half_width_rad = 2.0 * math.asin(least) + 1e-9
    return Heading(_quaternion_of(rotation), half_width_rad)


def _quaternion_of(rotation: FloatArray) -> FloatArray:
    """Return the unit quaternion xyzw of a rotation matrix."""
    m = rotation
    squares = np.array(
        [
            1.0 + m[0, 0] - m[1, 1] - m[2, 2],
            1.0 - m[0, 0] + m[1, 1] - m[2, 2],
            1.0 - m[0, 0] - m[1, 1] + m[2, 2],
            1.0 + m[0, 0] + m[1, 1] + m[2, 2],
        ]
    )
    x, y, z = m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]
    columns = np.array(
        [
            [squares[0], m[0, 1] + m[1, 0], m[0, 2] + m[2, 0], x],
            [m[0, 1] + m[1, 0], squares[1], m[1, 2] + m[2, 1], y],
            [m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], squares[2], z],
            [x, y, z, squares[3]],
        ]
    )
    best = columns[int(np.argmax(squares))]
    quaternion = best / np.linalg.norm(best)
    return np.asarray(quaternion if quaternion[3] >= 0.0 else -quaternion)
