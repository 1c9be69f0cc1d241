# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Rays of one observer in common body frames, and their angles and chiralities.

Rays of one image are compared directly. Rays of different times are first rotated by the motion of
the observer between them, and widened by its uncertainty.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.motion import Motion
from dg_localization.fleet.rotations import angles_rad
from dg_localization.fleet.vocabulary import RayReading
from dg_localization.interval.angles import angle_up, arcsine_up, cosine
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import quotient_up, sqrt_down, sum_up
from dg_localization.solver.problem import Chirality

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SHORTEST_PROJECTION = 1e-6
"""A unit vector whose horizontal part is shorter than this has no direction in the plane."""


class Angles(NamedTuple):
    """
    Angles under which observers see pairs of points.

    Parameters
    ----------
    corners : numpy.ndarray of int, shape (m, 3)
        The rows of the observer, the first target and the second target.
    angles_rad : numpy.ndarray, shape (m,)
        Angles from the first ray to the second: in the plane counterclockwise, in (-pi, pi]; in
        space in [0, pi].
    half_widths_rad : numpy.ndarray, shape (m,)
        Greatest error of each angle.

    """

    corners: IntArray
    angles_rad: FloatArray
    half_widths_rad: FloatArray

    def bounds_rad(self) -> tuple[FloatArray, FloatArray]:
        """Return bounds of the sizes of the angles, in [0, pi]."""
        sizes, widths = np.abs(self.angles_rad), self.half_widths_rad
        return np.maximum(sizes - widths, 0.0), np.minimum(sizes + widths, math.pi)

    def cosines(self) -> FloatArray:
        """Return bounds of the cosines, shape (m, 2)."""
        bounds = cosine(Interval(*self.bounds_rad()))
        return np.stack([bounds.lower, bounds.upper], axis=1)

    def of(self, points: Sequence[int], n_points: int) -> Angles:
        """Return the angles between some of the `n_points` points, renumbered as listed."""
        row_of = np.full(n_points, -1)
        row_of[list(points)] = np.arange(len(points))
        corners = row_of[self.corners]
        kept = (corners >= 0).all(axis=1)
        return Angles(corners[kept], self.angles_rad[kept], self.half_widths_rad[kept])

    @classmethod
    def joined(cls, parts: Iterable[Angles]) -> Angles:
        """Return the angles of all observers, without angles that bound nothing."""
        nothing = cls(np.empty((0, 3), dtype=np.int64), np.empty(0), np.empty(0))
        whole = cls._make(map(np.concatenate, zip(nothing, *parts, strict=True)))
        known = whole.half_widths_rad < math.pi
        return cls._make(column[known] for column in whole)

    def chiralities(self) -> Iterator[Chirality]:
        """Yield the chirality of an observer in the plane with two targets, where certain."""
        low, high = np.abs(self.angles_rad), np.abs(self.angles_rad) + self.half_widths_rad
        for row in np.flatnonzero((self.half_widths_rad < low) & (high < math.pi)):
            sign = 1 if self.angles_rad[row] > 0.0 else -1
            yield Chirality(tuple(self.corners[row].tolist()), sign)


def include_displacement(ray: RayReading, s_lower_m2: float) -> RayReading:
    """
    Return a ray that holds for the line between its ends at the time of the snapshot.

    A vector of length d whose tip moves by D < d turns by at most asin(D / d). The same holds for
    the new vector, so the distance of either time may be used.
    """
    turn_rad = _turn_by_displacement_rad(ray.displacement_m, s_lower_m2)
    half_width_rad = angle_up(sum_up(ray.half_width_rad, turn_rad))
    return replace(ray, half_width_rad=half_width_rad, displacement_m=0.0)


def _turn_by_displacement_rad(displacement_m: float, s_lower_m2: float) -> float:
    """Return the greatest angle by which a displacement can turn the line between two points."""
    if displacement_m == 0.0:
        return 0.0
    d_lower_m = sqrt_down(s_lower_m2)
    if displacement_m >= d_lower_m:
        return math.pi
    return arcsine_up(quotient_up(displacement_m, d_lower_m))


@dataclass(frozen=True)
class RayBundle:
    """
    The newest rays of one observer.

    Parameters
    ----------
    rays : sequence of RayReading
        All rays of one observer, at least one; their displacement is included.
    measured : int
        The number of measured rays. The others come last and follow from mounts at any time.
    motion : Motion
        The motion of the observer between the times of the rays.

    """

    rays: Sequence[RayReading]
    measured: int
    motion: Motion

    def now(self, now_s: float) -> tuple[RayReading, ...]:
        """
        Return all rays in the body frame of the observer at the time of an estimate.

        The clock of the observer may be fast or slow: a ray with the same stamp was then taken at
        another time.
        """
        rays = self.at(now_s)
        if self.motion.config.between_stamps_s == 0.0:
            return rays
        _, error_rad = self.motion.turn(self.rays[0].key.observer, now_s, now_s)
        return tuple(
            replace(ray, half_width_rad=sum_up(ray.half_width_rad, error_rad))
            if before.stamp_s == now_s and row < self.measured
            else ray
            for row, (before, ray) in enumerate(zip(self.rays, rays, strict=True))
        )

    def at(self, stamp_s: float) -> tuple[RayReading, ...]:
        """Return all rays in the body frame of the observer at another time by its clock."""
        observer = self.rays[0].key.observer
        stamps_s = {ray.stamp_s for ray in self.rays}
        turns = {s: self.motion.turn(observer, s, stamp_s) for s in stamps_s}
        return tuple(self._turned(ray, stamp_s, *turns[ray.stamp_s]) for ray in self.rays)

    def angles(self) -> Angles:
        """Return all pairs of rays, each in the body frame of the ray that is listed later."""
        views = self._views
        chosen = [(views[j][i], views[j][j]) for i, j in combinations(range(len(self.rays)), 2)]
        first = np.array([a.direction for a, _ in chosen]).reshape(-1, 3)
        second = np.array([b.direction for _, b in chosen]).reshape(-1, 3)
        widths = np.array([a.half_width_rad + b.half_width_rad for a, b in chosen])
        angles = angles_rad(first, second)
        if self.motion.config.dimension == 2:
            turns_left = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
            angles = np.where(turns_left < 0.0, -angles, angles)
        corners = np.array([self._corner(pair) for pair in chosen], dtype=np.int64)
        return Angles(corners.reshape(-1, 3), angles, angle_up(widths))

    def chiralities(self) -> Iterator[Chirality]:
        """Yield each certain chirality of the observer in space with three targets."""
        for chosen in combinations(range(len(self.rays)), 3):
            rays = [self._views[chosen[-1]][i] for i in chosen]
            sign = spatial_sign(rays)
            if sign != 0:
                yield Chirality(self._corner(rays), sign)

    def _corner(self, rays: Sequence[RayReading]) -> tuple[int, ...]:
        """Return the row of the observer and the rows of the targets of some rays."""
        rows = self.motion.config.rows
        return (rows[rays[0].key.observer], *(rows[ray.key.target] for ray in rays))

    @cached_property
    def _views(self) -> list[tuple[RayReading, ...]]:
        """
        Return all rays in the body frame at the time of each of them.

        Rays from mounts belong to the time of the estimate, not to a stamp.
        """
        measured = self.rays[: self.measured]
        known = self.rays[self.measured :]
        at = {stamp_s: self.at(stamp_s) for stamp_s in {ray.stamp_s for ray in measured}}
        now = {stamp_s: self.now(stamp_s) for stamp_s in {ray.stamp_s for ray in known}}
        return [*(at[ray.stamp_s] for ray in measured), *(now[ray.stamp_s] for ray in known)]

    def _turned(
        self, ray: RayReading, stamp_s: float, rotation: FloatArray, error_rad: float
    ) -> RayReading:
        """Return a ray after a rotation into the body frame at another time."""
        if ray.stamp_s == stamp_s:
            return ray
        direction = rotation @ ray.direction
        if self.motion.config.dimension == 2:
            direction = direction * (1.0, 1.0, 0.0)
        length = math.sqrt(direction @ direction)
        if length < SHORTEST_PROJECTION:
            return replace(ray, stamp_s=stamp_s, half_width_rad=math.pi)
        return replace(
            ray,
            stamp_s=stamp_s,
            direction=direction / length,
            half_width_rad=sum_up(ray.half_width_rad, error_rad),
        )


def spatial_sign(rays: Sequence[RayReading]) -> int:
    """
    Return the sign of the determinant of three rays, or 0 if it is not certain.

    With unit vectors u', v', w' within the half widths of u, v, w, the determinant changes by
    det(u'-u, v, w) + det(u', v'-v, w) + det(u', v', w'-w). A difference is at most
    2 sin(half width / 2) long, and the vector product it meets at most the sine of an angle.
    """
    u, v, w = (ray.direction for ray in rays)
    e_u, e_v, e_w = (ray.half_width_rad for ray in rays)
    if max(e_u, e_v, e_w) >= math.pi / 2:
        return 0
    vw, uw, uv = angles_rad(np.array([v, u, u]), np.array([w, w, v])).tolist()
    change = (
        2.0 * math.sin(e_u / 2.0) * _greatest_sine(vw, 0.0)
        + 2.0 * math.sin(e_v / 2.0) * _greatest_sine(uw, e_u)
        + 2.0 * math.sin(e_w / 2.0) * _greatest_sine(uv, e_u + e_v)
    )
    volume = float(np.linalg.det(np.stack([u, v, w])))
    # The determinant of unit vectors is as exact as an angle.
    if abs(volume) <= angle_up(change):
        return 0
    return 1 if volume > 0.0 else -1


def _greatest_sine(angle_rad: float, half_width_rad: float) -> float:
    """Return the greatest sine of an angle in [0, pi] within the half width."""
    if abs(angle_rad - math.pi / 2) <= half_width_rad:
        return 1.0
    return max(math.sin(angle_rad - half_width_rad), math.sin(angle_rad + half_width_rad))
