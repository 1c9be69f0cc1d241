# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Where a robot truly was, between the samples of a ground truth."""

from copy import copy

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet.rotations import level_rotations, rotation_of_quaternion

FloatArray = NDArray[np.float64]

MOST_GAP_S = 1.0
"""Between samples that are farther apart nothing is taken as known."""

SAME_TIME_S = 1e-6
"""A time this near to a sample is that of the sample: the same stamp is rounded in two ways."""


class TrueTrack:
    """
    The true path of one robot, or the place of an anchor.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        In any order; of equal stamps the first counts.
    positions_m : array_like, shape (n, 3)
    orientations_xyzw : array_like, shape (n, 4), optional
        From body to world, scalar last; NaN or zero where not known.

    """

    def __init__(
        self,
        stamps_s: ArrayLike,
        positions_m: ArrayLike,
        orientations_xyzw: ArrayLike | None = None,
    ) -> None:
        self._stamps_s, order = np.unique(np.asarray(stamps_s, dtype=float), return_index=True)
        self._positions_m = np.reshape(np.asarray(positions_m, dtype=float), (-1, 3))[order]
        if orientations_xyzw is None:
            orientations_xyzw = np.full((np.size(stamps_s), 4), np.nan)
        quaternions = np.reshape(np.asarray(orientations_xyzw, dtype=float), (-1, 4))[order]
        with np.errstate(invalid='ignore'):
            quaternions = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
        # q and -q are the same turn; neighbors of one sign can be interpolated.
        products = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
        signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
        self._quaternions = quaternions * signs[:, None]
        # Of a place that is known at all times, and of a sensor that is carried.
        self._is_at_rest, self._dimension, self._arm_m = False, 0, np.zeros(3)

    @classmethod
    def at_rest(cls, position_m: ArrayLike) -> 'TrueTrack':
        """Return the track of an anchor; its orientation is not known."""
        place = np.zeros(3)
        place[: np.size(position_m)] = position_m
        track = cls([0.0], [place])
        track._is_at_rest = True
        return track

    @property
    def span_s(self) -> tuple[float, ...]:
        """The first and the last stamp; nothing for what is known at all times."""
        ends_s = self._stamps_s[[0, -1]].tolist()
        return () if self._is_at_rest else tuple(ends_s)

    def carrying(self, arm_m: ArrayLike) -> 'TrueTrack':
        """
        Return the track of a sensor on this robot, which is turned as the robot is.

        Parameters
        ----------
        arm_m : array_like, shape (q,)
            Its place in the body frame; in the plane roll and pitch do not move it.

        """
        track = copy(self)
        track._dimension = np.size(arm_m)
        track._arm_m = np.append(arm_m, np.zeros(3 - track._dimension))
        return track

    def positions_at(self, times_s: ArrayLike) -> FloatArray:
        """Return the positions at some times, shape (m, 3), NaN where not known."""
        found = self._between(self._positions_m, np.asarray(times_s, dtype=float))
        if self._dimension:
            found = found + without_tilt(self.rotations_at(times_s), self._dimension) @ self._arm_m
        return found

    def rotations_at(self, times_s: ArrayLike) -> FloatArray:
        """Return the rotations from body to world, shape (m, 3, 3), NaN where not known."""
        quaternions = self._between(self._quaternions, np.asarray(times_s, dtype=float))
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        return rotation_of_quaternion(quaternions / lengths)

    def _between(self, values: FloatArray, times_s: FloatArray) -> FloatArray:
        """Return the sample at each time, or interpolate between the two around it."""
        if self._is_at_rest:
            return np.repeat(values, len(times_s), axis=0)
        stamps = self._stamps_s
        after = np.minimum(np.searchsorted(stamps, times_s), len(stamps) - 1)
        before = np.maximum(after - 1, 0)
        since_s, until_s = times_s - stamps[before], stamps[after] - times_s
        gaps_s = stamps[after] - stamps[before]
        # Before the first sample there is none on the other side, and no gap between two.
        between = (gaps_s > 0.0) & (gaps_s <= MOST_GAP_S) & (until_s >= 0.0)
        share = np.divide(since_s, gaps_s, out=np.zeros_like(gaps_s), where=between)[:, None]
        found = (1.0 - share) * values[before] + share * values[after]
        found[~between] = np.nan
        # What is known of a sample needs no neighbor.
        nearest = np.where(np.abs(since_s) < np.abs(until_s), before, after)
        same = np.abs(times_s - stamps[nearest]) <= SAME_TIME_S
        return np.where(same[:, None], values[nearest], found)


def without_heights(vectors_m: FloatArray, dimension: int) -> FloatArray:
    """Return positions or ways, shape (m, 3), in the plane with heights of zero."""
    if dimension == 3:
        return vectors_m
    # Not a product with zero: a height that is not known must not count either.
    return np.column_stack([vectors_m[:, :2], np.zeros(len(vectors_m))])


def without_tilt(rotations: FloatArray, dimension: int) -> FloatArray:
    """Return rotations, shape (m, 3, 3), in the plane without roll and pitch."""
    if dimension == 3:
        return rotations
    # The upright axis of a heading that is not known would seem to be.
    known = np.isfinite(rotations).all(axis=(1, 2), keepdims=True)
    return np.where(known, level_rotations(rotations), np.nan)


def range_errors_m(
    observer: TrueTrack,
    target: TrueTrack,
    stamps_s: ArrayLike,
    ranges_m: ArrayLike,
    dimension: int,
) -> FloatArray:
    """
    Return the errors of ranges, the reading minus the true distance.

    Parameters
    ----------
    observer, target : TrueTrack
    stamps_s, ranges_m : array_like, shape (m,)
    dimension : {2, 3}
        In the plane heights do not count.

    Returns
    -------
    ndarray, shape (m,)
        NaN where the truth is not known.

    """
    way_m = target.positions_at(stamps_s) - observer.positions_at(stamps_s)
    return np.asarray(ranges_m) - np.linalg.norm(way_m[:, :dimension], axis=1)


def ray_errors_rad(
    observer: TrueTrack, target: TrueTrack, stamps_s: ArrayLike, rays: ArrayLike, dimension: int
) -> FloatArray:
    """
    Return the angles from the true to the measured rays.

    Parameters
    ----------
    observer, target : TrueTrack
    stamps_s : array_like, shape (m,)
    rays : array_like, shape (m, 3)
        In the body frame of the observer.
    dimension : {2, 3}
        In the plane heights, roll and pitch of the truth do not count.

    Returns
    -------
    ndarray, shape (m,)
        In the plane positive to the left; in space not negative. NaN where the truth is not known.

    """
    way_m = target.positions_at(stamps_s) - observer.positions_at(stamps_s)
    bodies = without_tilt(observer.rotations_at(stamps_s), dimension)
    true = np.einsum('mji,mj->mi', bodies, without_heights(way_m, dimension))
    seen = np.asarray(rays, dtype=float)
    if dimension == 2:
        across = true[:, 0] * seen[:, 1] - true[:, 1] * seen[:, 0]
        return np.arctan2(across, np.sum(true[:, :2] * seen[:, :2], axis=1))
    across = np.linalg.norm(np.cross(true, seen), axis=1)
    return np.arctan2(across, np.sum(true * seen, axis=1))
