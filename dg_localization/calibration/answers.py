# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers of a localizer beside a ground truth: whether they hold it, and how far off they are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.calibration.odometry import angles_between
from dg_localization.calibration.truth import FloatArray, TrueTrack, without_heights, without_tilt
from dg_localization.fleet import FixedFrame, FleetConfig, FrameKind, Placement
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.fleet.snapshot import Snapshot

BoolArray = NDArray[np.bool_]

ROUNDING = 1e-6
"""In m and in rad: bounds of what defines an axis have no width, and the truth is rounded."""


@dataclass(frozen=True)
class TruePlacement:
    """
    Where the robots truly are at one time, as far as that is known.

    Parameters
    ----------
    positions_m : numpy.ndarray, shape (n, q)
        In the frame of an answer; NaN where not known.
    rotations : numpy.ndarray, shape (n, 3, 3)
        From body to that frame, in the plane about the vertical axis alone; NaN where not known.
    distances_m : numpy.ndarray, shape (n, n)
        Between the robots, which need no frame; NaN where not known.

    """

    positions_m: FloatArray
    rotations: FloatArray
    distances_m: FloatArray

    @property
    def tells(self) -> bool:
        """Whether anything is known that an answer could be compared with."""
        apart = self.distances_m[np.triu_indices(len(self.distances_m), 1)]
        return bool(np.isfinite(self.positions_m).any() or np.isfinite(apart).any())

    def outside(self, placement: Placement) -> BoolArray:
        """
        Return which robots a placement of the same robots does not hold.

        Returns
        -------
        ndarray of bool, shape (n,)
            True for a robot whose place or heading is outside its bounds; where there is none, for
            both ends of a distance that is.

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
        """Return how far the best points are off, shape (n,); NaN where that is not known."""
        return np.asarray(np.linalg.norm(placement.positions_m - self.positions_m, axis=1))

    def heading_errors_rad(self, placement: Placement) -> FloatArray:
        """Return how far the best headings are off, shape (n,); NaN where that is not known."""
        return self._angles_rad(placement.best_headings[0])

    def _angles_rad(self, orientations_xyzw: FloatArray) -> FloatArray:
        """Return the angles between orientations and the true ones, NaN where one is not known."""
        return angles_between(rotation_of_quaternion(orientations_xyzw), self.rotations)


@dataclass(frozen=True)
class FleetTruth:
    """
    Where the robots of a fleet truly were.

    Parameters
    ----------
    fleet : FleetConfig
    tracks : mapping of str to TrueTrack
        Those of robots and anchors, by name.

    """

    fleet: FleetConfig
    tracks: Mapping[str, TrueTrack]

    def stamps_s(self) -> list[float]:
        """Return the first and the last stamps of all tracks."""
        return [stamp_s for track in self.tracks.values() for stamp_s in track.span_s]

    def beside(self, frame: FixedFrame, snapshot: Snapshot) -> TruePlacement:
        """
        Return where the robots truly were, in the frame of an answer to a snapshot.

        The truth is taken to be in the coordinates of the anchors. The newest odometry of a robot
        is true in its odometry frame.
        """
        dimension, stamp_s = self.fleet.dimension, snapshot.stamp_s
        places, turns = self._poses(self.fleet.robots, stamp_s)
        origin_m, axes, offset_m = np.zeros(3), np.eye(3), np.zeros(3)
        if frame.kind is FrameKind.ODOMETRY:
            odometry = snapshot.motion.newest(frame.points[0], stamp_s)
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
        """Return positions (k, 3) and rotations (k, 3, 3) of points, NaN where not known."""
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

    Where there is no second one, y is any direction in the plane that is at right angles to x: the
    points of a frame in space that have none are all on one line.
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
