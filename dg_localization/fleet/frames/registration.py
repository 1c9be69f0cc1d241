# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Registration: from the frame of a core to the fixed frame.

The coordinates of anchors or the rays of the reference robot bound the rotation and translation
between the two.
"""

from __future__ import annotations

from collections.abc import Mapping
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind
from dg_localization.fleet.rotations import best_rotation, unit_vectors
from dg_localization.fleet.vocabulary import RayReading
from dg_localization.interval.angles import chord_up, rotation_2d
from dg_localization.interval.arrays import Interval, cross, normalized, rotate

FloatArray = NDArray[np.float64]


class CorePose(NamedTuple):
    """
    The axes and the origin of a core in the fixed frame.

    Parameters
    ----------
    axes : Interval, shape (q, q), or None
        Its columns are the axes; None if they are the axes of the fixed frame.
    origin : Interval, shape (q,), or None
        None if it is the origin of the fixed frame.

    """

    axes: Interval | None = None
    origin: Interval | None = None

    def to_fixed(self, local: Interval) -> Interval:
        """Return coordinates along the axes of the core as coordinates in the fixed frame."""
        turned = local if self.axes is None else rotate(self.axes, local)
        return turned if self.origin is None else turned + self.origin[None, :]


class Registration(NamedTuple):
    """
    The fixed frame relative to the solved points.

    Parameters
    ----------
    kind : FrameKind
    solved : Constraints
    cores : tuple of tuple of int
        Rows of the points that span the frame, best first.
    anchors : mapping of int to Interval
        The coordinates of the anchors by row.

    """

    kind: FrameKind
    solved: Constraints
    cores: tuple[tuple[int, ...], ...]
    anchors: Mapping[int, Interval]

    @property
    def _rays(self) -> dict[int, RayReading]:
        """The rays of the robot at the origin by row of their target: a heading needs them."""
        rays = self.solved.rays.get(self.solved.points[self.cores[0][0]], ())
        return {self.solved.rows[ray.key.target]: ray for ray in rays}

    def pose_of(self, core: tuple[int, ...]) -> CorePose:
        """Return the bounds of the pose of a core."""
        if self.kind == FrameKind.ANCHORS:
            origin, *others = (self.anchors[point] for point in core)
            return CorePose(_axes_along([place - origin for place in others]), origin)
        if self.kind == FrameKind.ROBOTS:
            return CorePose()
        chosen = [self._rays[point] for point in core[1:]]
        if self.solved.dimension == 2:
            x, y = chosen[0].direction[:2]
            return CorePose(rotation_2d(math.atan2(y, x), chosen[0].half_width_rad))
        edges = [Interval.around(ray.direction, chord_up(ray.half_width_rad)) for ray in chosen]
        return CorePose(_axes_along(edges))

    def moved(self, positions: FloatArray) -> FloatArray:
        """Return positions of the solved points in the fixed frame, by the best fit."""
        if self.kind == FrameKind.ANCHORS:
            points = list(self.anchors)
            targets = np.array([(box.lower + box.upper) / 2.0 for box in self.anchors.values()])
            center = positions[points].mean(axis=0)
            rotation = best_rotation(positions[points] - center, targets - targets.mean(axis=0))
            return (positions - center) @ rotation.T + targets.mean(axis=0)
        origin, *others = self.cores[0]
        local = positions - positions[origin]
        if self.kind != FrameKind.HEADING:
            return local @ _rotation_to_axes(local[others]).T
        rays = self._rays.values()
        weights = np.array([1.0 / (ray.half_width_rad + 1e-6) for ray in rays])
        seen = np.array([ray.direction[: self.solved.dimension] for ray in rays])
        return local @ best_rotation(unit_vectors(local[[*self._rays]]), seen, weights).T


def _axes_along(edges: list[Interval]) -> Interval:
    """Return bounds of the matrix of axes (columns) spanned by q - 1 edges from the origin."""
    first = normalized(edges[0])
    if len(edges) == 1:
        x, y = first[..., 0], first[..., 1]
        return Interval.stack([Interval.stack([x, -y]), Interval.stack([y, x])], axis=-2)
    third = normalized(cross(first, edges[1]))
    return Interval.stack([first, cross(third, first), third])


def _rotation_to_axes(edges: FloatArray) -> FloatArray:
    """Return the rotation that takes the first edge to +x, the second to the xy plane, y >= 0."""
    basis, triangle = np.linalg.qr(edges.T, mode='complete')
    basis[:, : len(edges)] *= np.where(np.diagonal(triangle) < 0.0, -1.0, 1.0)
    if np.linalg.det(basis) < 0.0:
        basis[:, -1] *= -1.0
    return np.asarray(basis.T)
