# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Interpolation of a ground truth, and errors of readings and answers against it.

Answers of a localizer are checked for whether they hold the truth, and for their errors.
"""

from collections.abc import Mapping, Sequence
from copy import copy
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.fleet import (
    FixedFrame,
    FleetConfig,
    FrameKind,
    OdometryErrorModel,
    Placement,
    Snapshot,
)
from dg_localization.fleet.rotations import level_rotations, rotation_of_quaternion
from dg_localization.fleet.vocabulary import OdometrySample

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

SAME_TIME_S = 1e-6
"""A time this near to a sample counts as its time: the same stamp may be rounded differently."""


class TrueTrack:
    """
    The true path of one robot, or the place of an anchor.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        In any order; of equal stamps the first counts.
    positions_m : array_like, shape (n, 3)
    orientations_xyzw : array_like, shape (n, 4), optional
        From body to world, scalar last; NaN or zero if unknown.

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
        # q and -q are the same rotation; neighbors of one sign can be interpolated.
        products = np.sum(quaternions[1:] * quaternions[:-1], axis=1)
        signs = np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))
        self._quaternions = quaternions * signs[:, None]
        # For an anchor, whose place is known at all times, and for a sensor on a robot.
        self._is_at_rest, self._dimension, self._arm_m = False, 0, np.zeros(3)

    @classmethod
    def at_rest(cls, position_m: ArrayLike) -> 'TrueTrack':
        """Return the track of an anchor; its orientation is unknown."""
        place = np.zeros(3)
        place[: np.size(position_m)] = position_m
        track = cls([0.0], [place])
        track._is_at_rest = True
        return track

    @property
    def span_s(self) -> tuple[float, ...]:
        """The first and the last stamp; empty for an anchor."""
        return () if self._is_at_rest else tuple(self._stamps_s[[0, -1]].tolist())

    def carrying(self, arm_m: ArrayLike) -> 'TrueTrack':
        """
        Return the track of a sensor on this robot, with the orientation of the robot.

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
        """Return the positions at times, shape (m, 3); NaN if unknown."""
        found = self._between(self._positions_m, np.asarray(times_s, dtype=float))
        if self._dimension:
            found = found + without_tilt(self.rotations_at(times_s), self._dimension) @ self._arm_m
        return found

    def rotations_at(self, times_s: ArrayLike) -> FloatArray:
        """Return the rotations from body to world, shape (m, 3, 3); NaN if unknown."""
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
        # Across a gap in which odometry would count as lost, nothing is interpolated. Before the
        # first sample there is no sample on the other side, and no gap.
        is_near = gaps_s <= OdometryErrorModel.max_gap_s
        between = (gaps_s > 0.0) & is_near & (until_s >= 0.0)
        share = np.divide(since_s, gaps_s, out=np.zeros_like(gaps_s), where=between)[:, None]
        found = (1.0 - share) * values[before] + share * values[after]
        found[~between] = np.nan
        # A time of a sample needs no neighbor.
        nearest = np.where(np.abs(since_s) < np.abs(until_s), before, after)
        same = np.abs(times_s - stamps[nearest]) <= SAME_TIME_S
        return np.where(same[:, None], values[nearest], found)


def without_heights(vectors_m: FloatArray, dimension: int) -> FloatArray:
    """Return positions or displacements, shape (m, 3), with zero heights in the plane."""
    if dimension == 3:
        return vectors_m
    # Not a product with zero: an unknown height (NaN) must not count either.
    return np.column_stack([vectors_m[:, :2], np.zeros(len(vectors_m))])


def without_tilt(rotations: FloatArray, dimension: int) -> FloatArray:
    """Return rotations, shape (m, 3, 3), without roll and pitch in the plane."""
    if dimension == 3:
        return rotations
    # Leveling an unknown rotation would give it a known vertical axis.
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
        NaN if the truth is unknown.

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
        In the plane positive to the left; in space not negative. NaN if the truth is unknown.

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


def angles_between(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between rotations, shape (k,), from the lengths of their differences."""
    lengths = np.linalg.norm(first - second, axis=(1, 2))
    return np.asarray(2.0 * np.arcsin(np.minimum(1.0, lengths / np.sqrt(8.0))))


ROUNDING = 1e-6
"""Tolerance in m and in rad: bounds along the axes of a frame have no width; truth is rounded."""


class TruePlacement(NamedTuple):
    """
    The true poses of the robots at one time, as far as known.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        Positions in the frame of an answer; NaN if unknown.
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to that frame, in the plane about the vertical axis only; NaN if unknown.
    distances_m : numpy.ndarray, shape (n, n)
        Distances between the robots, which need no frame; NaN if unknown.

    """

    positions_m: FloatArray
    rotations: FloatArray
    distances_m: FloatArray

    @property
    def tells(self) -> bool:
        """Whether some known value can be compared with an answer."""
        apart = self.distances_m[np.triu_indices(len(self.distances_m), 1)]
        return bool(np.isfinite(self.positions_m).any() or np.isfinite(apart).any())

    def outside(self, placement: Placement) -> BoolArray:
        """
        Return which robots are outside the bounds of a placement.

        Returns
        -------
        ndarray of bool, shape (n,)
            True for a robot whose place or heading is outside its bounds; if there is none, for
            both ends of each distance outside its bounds.

        """
        low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
        beyond = (self.positions_m < low - ROUNDING) | (self.positions_m > high + ROUNDING)
        near, far = placement.lower_m - ROUNDING, placement.upper_m + ROUNDING
        apart = (self.distances_m < near) | (self.distances_m > far)
        off_rad = self._angles_rad(placement.orientations_xyzw)
        turned = off_rad > placement.heading_half_width_rad + ROUNDING
        alone = np.asarray(beyond.any(axis=1) | turned)
        return alone if alone.any() else np.asarray(apart.any(axis=1))

    def point_errors_m(self, placement: Placement) -> FloatArray:
        """Return the errors of the best points, shape (n,); NaN if unknown."""
        return np.asarray(np.linalg.norm(placement.positions_m - self.positions_m, axis=1))

    def heading_errors_rad(self, placement: Placement) -> FloatArray:
        """Return the errors of the best headings, shape (n,); NaN if unknown."""
        return self._angles_rad(placement.best_headings[0])

    def _angles_rad(self, orientations_xyzw: FloatArray) -> FloatArray:
        """Return the angles between orientations and the true ones; NaN if one is unknown."""
        return angles_between(rotation_of_quaternion(orientations_xyzw), self.rotations)


class FleetTruth(NamedTuple):
    """
    The ground truth of a fleet.

    Parameters
    ----------
    fleet : FleetConfig
    tracks : mapping of str to TrueTrack
        The tracks of robots and anchors by name.

    """

    fleet: FleetConfig
    tracks: Mapping[str, TrueTrack]

    def stamps_s(self) -> list[float]:
        """Return the first and the last stamps of all tracks."""
        return [stamp_s for track in self.tracks.values() for stamp_s in track.span_s]

    def beside(self, frame: FixedFrame, snapshot: Snapshot) -> TruePlacement:
        """Return the truth in the frame of an answer to a snapshot, at the time of both."""
        odometry = None
        if frame.kind is FrameKind.ODOMETRY:
            odometry = snapshot.motion.newest(frame.points[0], snapshot.stamp_s)
        return self.at(frame, snapshot.stamp_s, odometry)

    def at(
        self, frame: FixedFrame, stamp_s: float, odometry: OdometrySample | None = None
    ) -> TruePlacement:
        """
        Return the true poses of the robots at a time, in the frame of an answer.

        Parameters
        ----------
        frame : FixedFrame
            The frame of the answer. The truth is assumed in the coordinates of the anchors.
        stamp_s : float
            Time of the answer.
        odometry : OdometrySample, optional
            The newest odometry of the robot that owns an odometry frame, which is true in it.

        """
        dimension = self.fleet.dimension
        places, turns = self._poses(self.fleet.robots, stamp_s)
        origin_m, axes, offset_m = np.zeros(3), np.eye(3), np.zeros(3)
        if frame.kind is FrameKind.ODOMETRY:
            axes = np.full((3, 3), np.nan)
            if odometry is not None:
                (origin_m,), (body,) = self._poses(frame.points[:1], odometry.stamp_s)
                axes = body @ without_tilt(odometry.rotation[None], dimension)[0].T
                offset_m = odometry.position_in_frame_m
        elif frame.kind is not FrameKind.ANCHORS:
            ends_m, (axes, *_) = self._poses(frame.points, stamp_s)
            origin_m = ends_m[0]
            if frame.kind is FrameKind.ROBOTS:
                axes = _axes_along(ends_m[1:] - origin_m)
        positions_m = (places - origin_m) @ axes + offset_m
        between_m = places[:, None, :dimension] - places[None, :, :dimension]
        return TruePlacement(
            positions_m[:, :dimension], axes.T @ turns, np.linalg.norm(between_m, axis=-1)
        )

    def _poses(self, names: Sequence[str], stamp_s: float) -> tuple[FloatArray, FloatArray]:
        """Return positions (k, 3) and rotations (k, 3, 3) of points; NaN if unknown."""
        places, turns = np.full((len(names), 3), np.nan), np.full((len(names), 3, 3), np.nan)
        for row, name in enumerate(names):
            if name in self.tracks:
                places[row] = self.tracks[name].positions_at([stamp_s])[0]
                turns[row] = self.tracks[name].rotations_at([stamp_s])[0]
        dimension = self.fleet.dimension
        return without_heights(places, dimension), without_tilt(turns, dimension)


def _axes_along(edges_m: FloatArray) -> FloatArray:
    """
    Return axes as columns: x along the first edge, y on the side of the second.

    Without a second edge, y is any direction at right angles to x: in space, the points of such a
    frame are all on one line.
    """
    if len(edges_m) == 0:
        return np.eye(3)
    with np.errstate(invalid='ignore'):
        x = edges_m[0] / np.linalg.norm(edges_m[0])
        side = edges_m[1] if len(edges_m) > 1 else np.array([-x[1], x[0], 0.0])
        if not side.any():
            side = np.array([0.0, 1.0, 0.0])
        y = side - (side @ x) * x
        y = y / np.linalg.norm(y)
    return np.column_stack([x, y, np.cross(x, y)])
