# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Rays of one observer, brought into common body frames.

Rays of one image need no motion to be compared. Rays of different times do: the rotation of the
observer between them turns them, and what is not known of it widens them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.directions import angles_rad
from dg_localization.fleet.motion import Motion
from dg_localization.fleet.vocabulary import RayReading
from dg_localization.interval.angles import angle_up, arcsine_up
from dg_localization.interval.bounds import quotient_up, sqrt_down, sum_up

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SHORTEST_PROJECTION = 1e-6
"""A unit vector whose horizontal part is shorter than this has no direction in the plane."""


@dataclass(frozen=True)
class RayPairs:
    """
    All pairs of rays of one observer.

    Parameters
    ----------
    corners : numpy.ndarray of int, shape (m, 3)
        The rows of the observer, of the first target and of the second.
    angles_rad : numpy.ndarray, shape (m,)
        From the first ray to the second: in the plane counterclockwise, in (-pi, pi]; in space
        in [0, pi].
    half_widths_rad : numpy.ndarray, shape (m,)
        Greatest error of each angle.

    """

    corners: IntArray
    angles_rad: FloatArray
    half_widths_rad: FloatArray


def include_displacement(ray: RayReading, s_lower_m2: float) -> RayReading:
    """
    Return a ray that holds for the line between its ends at the time of the snapshot.

    A vector of length d whose tip moves by D < d turns by at most asin(D / d), and the same
    holds looking back from the new vector: the distance may be that of either time.

    Parameters
    ----------
    ray : RayReading
    s_lower_m2 : float
        Lower bound of the squared distance of its ends.

    Returns
    -------
    RayReading
        In the same body frame, with the displacement in its half width.

    """
    turn_rad = _turn_by_displacement_rad(ray.displacement_m, s_lower_m2)
    half_width_rad = angle_up(sum_up(ray.half_width_rad, turn_rad))
    return replace(ray, half_width_rad=half_width_rad, displacement_m=0.0)


def _turn_by_displacement_rad(displacement_m: float, s_lower_m2: float) -> float:
    """Return by how much a displacement can turn the line between two points."""
    if displacement_m == 0.0:
        return 0.0
    d_lower_m = sqrt_down(s_lower_m2)
    if displacement_m >= d_lower_m:
        return math.pi
    return arcsine_up(quotient_up(displacement_m, d_lower_m))


class RayBundle:
    """
    The newest rays of one observer.

    Parameters
    ----------
    rays : sequence of RayReading
        All of one observer, at least one; their displacement is included.
    measured : int
        How many of them were: the others, which come last, are known from mounts at any time.
    rows : mapping of str to int
        The row of each point.
    motion : Motion
        How the observer turned between the times of the rays.
    dimension : {2, 3}

    """

    def __init__(
        self,
        rays: Sequence[RayReading],
        measured: int,
        rows: Mapping[str, int],
        motion: Motion,
        dimension: int,
    ) -> None:
        self._rays = rays
        self._measured = measured
        self._rows = rows
        self._motion = motion
        self._dimension = dimension

    def now(self, now_s: float) -> tuple[RayReading, ...]:
        """
        Return all rays in the body frame of the observer at the time of an estimate.

        Its own clock may show that time earlier or later: a ray with the same stamp is of another
        time then.
        """
        rays = self.at(now_s)
        if self._motion.between_stamps_s == 0.0:
            return rays
        _, error_rad = self._motion.turn(self._rays[0].key.observer, now_s, now_s)
        return tuple(
            replace(ray, half_width_rad=sum_up(ray.half_width_rad, error_rad))
            if before.stamp_s == now_s and row < self._measured
            else ray
            for row, (before, ray) in enumerate(zip(self._rays, rays, strict=True))
        )

    def at(self, stamp_s: float) -> tuple[RayReading, ...]:
        """Return all rays in the body frame of the observer at another time by its clock."""
        observer = self._rays[0].key.observer
        stamps_s = {ray.stamp_s for ray in self._rays}
        turns = {s: self._motion.turn(observer, s, stamp_s) for s in stamps_s}
        return tuple(self._turned(ray, stamp_s, *turns[ray.stamp_s]) for ray in self._rays)

    def pairs(self) -> RayPairs:
        """Return all pairs of rays, each in the body frame of the ray that is listed later."""
        views = self._views
        chosen = [(views[j][i], views[j][j]) for i, j in combinations(range(len(self._rays)), 2)]
        corners = [self.corner(pair) for pair in chosen]
        first = np.array([a.direction for a, _ in chosen]).reshape(-1, 3)
        second = np.array([b.direction for _, b in chosen]).reshape(-1, 3)
        widths = np.array([a.half_width_rad + b.half_width_rad for a, b in chosen])
        angles = angles_rad(first, second)
        if self._dimension == 2:
            turns_left = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
            angles = np.where(turns_left < 0.0, -angles, angles)
        corner_rows = np.array(corners, dtype=np.int64).reshape(-1, 3)
        return RayPairs(corner_rows, angles, angle_up(widths))

    def triples(self) -> Iterator[tuple[RayReading, ...]]:
        """Yield all triples of rays, each in one body frame."""
        for chosen in combinations(range(len(self._rays)), 3):
            view = self._views[chosen[-1]]
            yield tuple(view[i] for i in chosen)

    def corner(self, rays: Sequence[RayReading]) -> tuple[int, ...]:
        """Return the row of the observer and the rows of the targets of some rays."""
        return (self._rows[rays[0].key.observer], *(self._rows[ray.key.target] for ray in rays))

    @cached_property
    def _views(self) -> list[tuple[RayReading, ...]]:
        """
        Return all rays in the body frame at the time of each of them.

        Those known from mounts are of the time of the estimate, not of any stamp.
        """
        measured = self._rays[: self._measured]
        known = self._rays[self._measured :]
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
        if self._dimension == 2:
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
