# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Readings between two bodies in a window, carried to now by their odometries."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import Interval, down, up
from dg_localization.poses import cuts
from dg_localization.poses.turns import principal, turned

NO_RAY_RAD = math.inf
"""The error of a ray that was not measured."""


@dataclass(frozen=True)
class PastPoses:
    """
    Past level frames of a body relative to its level frame now.

    The level frame of a body has its origin, its yaw, and a vertical z axis: roll and pitch of the
    odometry are included in the points and rays of `PairReadings`. In the plane z is zero.

    Parameters
    ----------
    position_m : Interval, shape (m, 3)
    yaw_rad : Interval, shape (m,)

    """

    position_m: Interval
    yaw_rad: Interval

    @classmethod
    def at_rest(cls, count: int) -> Self:
        """Return the poses of a body at rest, for example the world."""
        return cls(Interval.point(np.zeros((count, 3))), Interval.point(np.zeros(count)))

    def __len__(self) -> int:
        return self.yaw_rad.lower.shape[0]

    def points_now(self, points_m: Interval) -> Interval:
        """
        Return past points of the body in its level frame now.

        Parameters
        ----------
        points_m : Interval, shape (m, 3)
            In the level frame at each of the times: the place of a sensor with its bound.

        Returns
        -------
        Interval, shape (m, 3)

        """
        return self.position_m + turned(self.yaw_rad, points_m)

    def rays_now(
        self, directions: ArrayLike, errors_rad: ArrayLike
    ) -> tuple[np.ndarray, np.ndarray]:
        """
        Return past rays of the body in its level frame now.

        Parameters
        ----------
        directions : array_like, shape (m, 3)
            Of any length, in the level frame at each of the times.
        errors_rad : array_like, shape (m,)
            Greatest angle between the true and the measured ray; `NO_RAY_RAD` for none.

        Returns
        -------
        directions : numpy.ndarray, shape (m, 3)
        errors_rad : numpy.ndarray, shape (m,)

        """
        yaw, rays = principal(self.yaw_rad), np.asarray(directions, dtype=float)
        middle = 0.5 * yaw.lower + 0.5 * yaw.upper
        half = np.maximum(up(yaw.upper - middle), up(middle - yaw.lower))
        c, s = np.cos(middle), np.sin(middle)
        x, y, z = rays[:, 0], rays[:, 1], rays[:, 2]
        rotated = np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
        errors = angle_up(up(np.asarray(errors_rad, dtype=float) + half))
        return rotated, errors


@dataclass(frozen=True)
class PairReadings:
    """
    Observations between a point of body A and a point of body B, carried to now.

    An observation is a distance, a ray, or both, of one target by one sensor at one time; both are
    wrong together or not at all. Or it is the distance to the target minus the distance to a
    reference on the body of the target.

    Parameters
    ----------
    points_a_m, points_b_m : Interval, shape (m, 3)
        The two points in the level frames of their bodies now (`PastPoses.points_now`).
    distance_m : Interval, shape (m,)
        [0, inf] if none was measured.
    rays : numpy.ndarray, shape (m, 3)
        Directions from the observer's point to the other, in the observer's level frame now.
    ray_errors_rad : numpy.ndarray, shape (m,)
        Greatest angles to the true direction; from pi/2 on they bound nothing.
    seen_by_b : numpy.ndarray of bool, shape (m,)
        Whether B measured the ray or the difference, not A.
    references_m : Interval, shape (m, 3)
        The references in the level frames of their bodies now.
    difference_m : Interval, shape (m,)
        [-inf, inf] if none was measured.

    """

    points_a_m: Interval
    points_b_m: Interval
    distance_m: Interval
    rays: np.ndarray
    ray_errors_rad: np.ndarray
    seen_by_b: np.ndarray
    references_m: Interval
    difference_m: Interval

    @classmethod
    def of(
        cls,
        points_a_m: Interval,
        points_b_m: Interval,
        distance_m: Interval | None = None,
        rays: ArrayLike | None = None,
        ray_errors_rad: ArrayLike | None = None,
        seen_by_b: ArrayLike = False,
        differences: tuple[Interval, Interval] | None = None,
    ) -> Self:
        """
        Return readings; omitted quantities were not measured.

        `differences` are `references_m` and `difference_m`.

        Raises
        ------
        ValueError
            If a bound is not a number, or reversed.

        """
        count = points_a_m.lower.shape[0]
        nothing = np.zeros(count), np.full(count, math.inf)
        if rays is None:
            rays = np.tile([1.0, 0.0, 0.0], (count, 1))
        readings = cls(
            points_a_m,
            points_b_m,
            Interval(*nothing) if distance_m is None else distance_m,
            np.asarray(rays, dtype=float),
            nothing[1] if ray_errors_rad is None else np.asarray(ray_errors_rad, dtype=float),
            np.broadcast_to(np.asarray(seen_by_b, dtype=bool), count),
            *(differences or (points_a_m, Interval(-nothing[1], nothing[1]))),
        )
        readings._check()
        return readings

    def _check(self) -> None:
        """Raise ValueError for bounds that are no interval."""
        names = ('points_a_m', 'points_b_m', 'distance_m', 'references_m', 'difference_m')
        for name in names:
            bounds = getattr(self, name)
            if not np.all(bounds.lower <= bounds.upper):
                raise ValueError(f'{name}: [{bounds.lower}, {bounds.upper}] m is no interval')

    def __len__(self) -> int:
        return self.points_a_m.lower.shape[0]

    def __getitem__(self, index: np.ndarray | slice) -> Self:
        return type(self)(
            self.points_a_m[index],
            self.points_b_m[index],
            self.distance_m[index],
            self.rays[index],
            self.ray_errors_rad[index],
            self.seen_by_b[index],
            self.references_m[index],
            self.difference_m[index],
        )

    @cached_property
    def table(self) -> np.ndarray:
        """The table of the readings for the kernels, (m, COLUMNS): B is body 0, A the frame."""
        table = np.zeros((len(self), cuts.COLUMNS))
        radii = []
        for points, middle, error in (
            (self.points_a_m, cuts.A, cuts.A_ERROR),
            (self.points_b_m, cuts.B, cuts.B_ERROR),
        ):
            center, half = center_and_half(points)
            table[:, middle : middle + 3], table[:, error : error + 3] = center, half
            table[:, cuts.TERMS] += (np.abs(center) + half).sum(axis=-1)
            radii.append(norm_up(half))
        table[:, cuts.ERROR_RADIUS] = up(radii[0] + radii[1])
        table[:, cuts.A_RADIUS] = norm_up(table[:, cuts.A : cuts.A + 2])
        table[:, cuts.B_RADIUS] = norm_up(table[:, cuts.B : cuts.B + 2])
        table[:, cuts.NEAREST] = np.maximum(self.distance_m.lower, 0.0)
        table[:, cuts.FARTHEST] = self.distance_m.upper
        table[:, cuts.A_BODY] = 1.0
        self._write_rays(table)
        self._write_differences(table)
        return table

    def _write_differences(self, table: np.ndarray) -> None:
        """Fill in the columns of the differences; others have `NO_RAY`."""
        told = np.flatnonzero(np.isfinite(self.difference_m.upper - self.difference_m.lower))
        by_b = self.seen_by_b[told]
        center, half = center_and_half(self.references_m[told])
        table[told, cuts.REFERENCE : cuts.REFERENCE + 3] = center
        table[told, cuts.REFERENCE_ERROR : cuts.REFERENCE_ERROR + 3] = half
        table[told, cuts.TERMS] += (np.abs(center) + half).sum(axis=-1)
        table[told, cuts.REFERENCE_RADIUS] = norm_up(center[:, :2])
        errors = [table[told, error : error + 3] for error in (cuts.A_ERROR, cuts.B_ERROR)]
        own = norm_up(np.where(by_b[:, None], *errors[::-1]))
        table[told, cuts.REFERENCE_ERROR_RADIUS] = up(own + norm_up(half))
        table[told, cuts.LEAST] = self.difference_m.lower[told]
        table[told, cuts.MOST] = self.difference_m.upper[told]
        table[told, cuts.HEARD_BY] = np.where(by_b, cuts.BY_B, cuts.BY_A)

    def _write_rays(self, table: np.ndarray) -> None:
        """Fill in the columns of the rays that say anything; the others have `NO_RAY`."""
        error = angle_up(angle_up(self.ray_errors_rad))
        longest = np.max(np.abs(self.rays), axis=-1)
        told = np.flatnonzero((error < 0.5 * math.pi) & (longest > 0.0) & (longest < math.inf))
        if not len(told):
            return
        error, rays = error[told], self.rays[told] / longest[told, None]
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        level = np.hypot(rays[:, 0], rays[:, 1])
        steep = level < cuts.STEEP
        across = np.stack([-rays[:, 1], rays[:, 0], np.zeros(len(told))], axis=-1)
        # Across a nearly vertical ray: the y axis, made perpendicular to it.
        sideways = np.array([0.0, 1.0, 0.0]) - rays[:, 1:2] * rays
        across = np.where(steep[:, None], sideways, across)
        across /= np.linalg.norm(across, axis=-1, keepdims=True)
        table[told, cuts.RAY : cuts.RAY + 3] = rays
        table[told, cuts.ACROSS : cuts.ACROSS + 3] = across
        table[told, cuts.UPRIGHT : cuts.UPRIGHT + 3] = np.cross(rays, across)
        table[told, cuts.RAY_SINE], table[told, cuts.RAY_COSINE] = np.sin(error), np.cos(error)
        table[told, cuts.OBSERVER] = np.where(self.seen_by_b[told], cuts.BY_B, cuts.BY_A)


def center_and_half(bounds: Interval) -> tuple[np.ndarray, np.ndarray]:
    """Return middles, and half-widths rounded up; both are exact for single numbers."""
    exact = bounds.lower == bounds.upper
    with np.errstate(invalid='ignore'):
        center = np.where(exact, bounds.lower, 0.5 * bounds.lower + 0.5 * bounds.upper)
        half = np.maximum(up(bounds.upper - center), up(center - bounds.lower))
    return center, np.where(exact, 0.0, half)


def norm_up(vectors: np.ndarray) -> np.ndarray:
    """Return upper bounds of the lengths along the last axis."""
    with np.errstate(over='ignore'):
        squares = up(vectors * vectors)
        total = squares[..., 0]
        for k in range(1, squares.shape[-1]):
            total = up(total + squares[..., k])
    return up(np.sqrt(total))


def start_bounds(table: np.ndarray, max_outliers: int) -> tuple[np.ndarray, np.ndarray]:
    """
    Bound the position of B, for any yaw: within the reach of all but `max_outliers` readings.

    Parameters
    ----------
    table : numpy.ndarray, shape (m, COLUMNS)
    max_outliers : int

    Returns
    -------
    lower, upper : numpy.ndarray, shape (3,)
        In m; infinite if too few readings have a distance.

    """
    if len(table) <= max_outliers:
        return np.full(3, -math.inf), np.full(3, math.inf)
    points_a = table[:, cuts.A : cuts.A + 3]
    lever = norm_up(table[:, cuts.B : cuts.B + 3])
    reach = up(up(table[:, cuts.FARTHEST] + lever) + table[:, cuts.ERROR_RADIUS])[:, None]
    lower, upper = down(points_a - reach), up(points_a + reach)
    unknown = ~np.isfinite(lower) | ~np.isfinite(upper)
    lower[unknown], upper[unknown] = -math.inf, math.inf
    return np.sort(lower, axis=0)[-1 - max_outliers], np.sort(upper, axis=0)[max_outliers]
