# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Enclosures: the coordinates in the fixed frame that the boxes of a hypothesis allow.

Coordinates are first enclosed in the frame of some points of the fleet: a core of q points, the
first of them the origin, and an apex, whose last coordinate is not negative. Such a frame needs
distances only. The pose of the core then moves them into the fixed frame. All bounds are rounded
outward: the true placement cannot get lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind
from dg_localization.fleet.frames.registration import Registration
from dg_localization.interval.arrays import Interval, determinant
from dg_localization.solver.contract.coordinates import (
    contract_coordinate_boxes,
    enclose_coordinates,
)
from dg_localization.solver.contract.triangles import contract_by_angles
from dg_localization.solver.decompose.decomposition import pieces_of
from dg_localization.solver.result import Hypothesis, JointKind

FloatArray = NDArray[np.float64]
Core = tuple[int, ...]

MAX_APEXES = 4
"""Most apexes tried for each core."""

MAX_BOXES = 16
"""
Hypotheses with more boxes are enclosed by the hull of their boxes, not box by box; no more boxes
cover the places of one point. With 128, five robots among 15 landmarks take twice as long; the
tests of anchors in line and of ceilings hold with either.
"""


class MirrorImage(NamedTuple):
    """One of two mirror images: the sign of the last coordinate of an apex in a core's frame."""

    core: Core
    apex: int
    sign: int


Placed = tuple[MirrorImage | None, Interval]
"""A mirror image, None if there is only one, and its coordinates, shape (n, q), in m."""


class Encloser:
    """
    Encloses the solved points in the fixed frame.

    Attributes
    ----------
    most_images : int
        The greatest number of mirror images of a hypothesis.

    """

    def __init__(self, solved: Constraints, registration: Registration) -> None:
        self._solved = solved
        self._cosines = solved.angles.cosines()
        self._registration = registration
        self._poses = {core: registration.pose_of(core) for core in registration.cores}
        self._core = registration.cores[0]
        self._rigid = _rigid_with(self._core, solved)
        short = len(self._core) < solved.dimension
        self.most_images = 1 if solved.chiralities or short or not self._rigid else 2

    def enclose(self, hypothesis: Hypothesis) -> list[Placed]:
        """Return the mirror images of a hypothesis that differ, with their coordinates."""
        boxes = hypothesis.boxes
        if len(boxes) > MAX_BOXES:
            boxes = np.stack([hypothesis.lower, hypothesis.upper])[None]

        @cache
        def apexes_of(core: Core) -> list[int]:
            others = [row for row in range(len(self._solved.points)) if row not in core]
            return _best_apexes(hypothesis, core, others)

        contracted = [self._contracted_by_angles(lower, upper) for lower, upper in boxes]
        found: list[Placed] = []
        for image in self._images(hypothesis):
            parts = [
                self._enclose_box(box, image, apexes_of) for box in contracted if box is not None
            ]
            enclosures = [part for part in parts if part is not None]
            if enclosures:
                found.append((image, reduce(Interval.hull, enclosures)))
        if len(found) < 2:
            return found
        (_, first), (_, second) = found
        if self._solved.chiralities:
            # The true image depends on the position of the truth in the hypothesis.
            return [(None, first.hull(second))]
        equal = np.array_equal(first.lower, second.lower) and np.array_equal(
            first.upper, second.upper
        )
        return found[:1] if equal else found

    def _images(self, hypothesis: Hypothesis) -> list[MirrorImage | None]:
        """
        Return the mirror images that the known chiralities allow.

        A single None means that there is no choice: every point can flip to its mirror image or
        lies in the hyperplane of the core.
        """
        core, known = self._core, {}
        if len(core) < self._solved.dimension:
            return [None]
        for chirality in self._solved.chiralities:
            apexes = set(chirality.points) - set(core)
            if len(apexes) == 1 and set(core) < set(chirality.points):
                apex = apexes.pop()
                known[apex] = chirality.sign_of((*core, apex))
        if not (known or self._rigid):
            return [None]
        apex = _best_apexes(hypothesis, core, list(known) or sorted(self._rigid))[0]
        signs = [known[apex]] if known else [1, -1]
        return [MirrorImage(core, apex, sign) for sign in signs]

    def _contracted_by_angles(self, lower: FloatArray, upper: FloatArray) -> _Box | None:
        """Return a box of squared distances contracted by the angles; None if it is empty."""
        lower, upper = np.array(lower), np.array(upper)
        corners = self._solved.angles.corners
        contract_by_angles(lower, upper, corners, self._cosines)
        if (lower > upper).any():
            return None
        return _Box(lower, upper, self._solved.dimension)

    def _enclose_box(
        self, box: _Box, image: MirrorImage | None, apexes_of: Callable[[Core], list[int]]
    ) -> Interval | None:
        """Return the coordinates that one box of squared distances allows."""
        frame, sign = (self._core, 1) if image is None else ((*image.core, image.apex), image.sign)
        local = box.locally(frame)
        if local is None:
            return None
        fixed = self._contract(self._poses[self._core].to_fixed(_mirrored(local, sign)), box)
        if fixed is None or image is None:
            return fixed
        for core, pose in self._poses.items():
            for apex in apexes_of(core):
                corner = fixed[[*core, apex]]
                sign = determinant(corner[1:] - corner[:1]).sign()
                if sign == 0 or (core, apex) == (image.core, image.apex):
                    continue
                local = box.locally((*core, apex))
                if local is None:
                    return None
                fixed = fixed.intersect(pose.to_fixed(_mirrored(local, sign)))
                if fixed.empty():
                    return None
        fixed = self._contract(fixed, box)
        return None if fixed is None or self._contradicts_chirality(fixed) else fixed

    def _contract(self, fixed: Interval, box: _Box) -> Interval | None:
        """Return the part that the distances and the coordinates of the anchors allow."""
        low, high = np.array(fixed.lower), np.array(fixed.upper)
        if self._registration.kind == FrameKind.ANCHORS:
            for point, place in self._registration.anchors.items():
                low[point] = np.maximum(low[point], place.lower)
                high[point] = np.minimum(high[point], place.upper)
        if (low > high).any():
            return None
        if not contract_coordinate_boxes(low, high, box.lower, box.upper):
            return None
        return Interval(low, high)

    def _contradicts_chirality(self, fixed: Interval) -> bool:
        """Return whether the sign of a known chirality is certainly wrong in an enclosure."""
        chiralities = self._solved.chiralities
        if not chiralities:
            return False
        corners = fixed[np.array([chirality.points for chirality in chiralities])]
        volumes = determinant(corners[:, 1:] - corners[:, :1])
        signs = np.array([chirality.sign for chirality in chiralities])
        return bool(np.where(signs > 0, volumes.upper < 0.0, volumes.lower > 0.0).any())


class _Box:
    """One box of squared distances; `locally` caches coordinates for its mirror image."""

    def __init__(self, lower: FloatArray, upper: FloatArray, dimension: int) -> None:
        self.lower, self.upper = lower, upper
        self.locally = cache(lambda frame: _enclose_locally(lower, upper, frame, dimension))


def _rigid_with(core: Core, solved: Constraints) -> frozenset[int]:
    """
    Return the points that have a chirality with a core: they cannot rotate against it.

    They are the points of all pieces that reflections join to the piece of the core. There are
    none if the core is not in one piece.
    """
    measured = np.argwhere(np.triu(np.isfinite(solved.upper), 1))
    parts = pieces_of(len(solved.upper), measured, solved.dimension)
    clusters = [set(points) for points in parts.pieces]
    for joint in parts.joints:
        if joint.kind is JointKind.REFLECTION:
            joined = set.union(*(clusters[number] for number in joint.pieces))
            clusters = [joined if cluster & joined == cluster else cluster for cluster in clusters]
    found = next((cluster for cluster in clusters if cluster.issuperset(core)), core)
    return frozenset(found) - set(core)


def _enclose_locally(
    lower: FloatArray, upper: FloatArray, frame: Sequence[int], dimension: int
) -> Interval | None:
    """
    Return coordinates (n, q) in the frame of some points, or None if there is no placement.

    A frame of fewer than q + 1 points is padded with unmeasured points, which bound nothing.
    """
    n_points, n_pads = len(lower), dimension + 1 - len(frame)
    padded_lower = np.zeros((n_points + n_pads, n_points + n_pads))
    padded_upper = np.full(padded_lower.shape, np.inf)
    np.fill_diagonal(padded_upper, 0.0)
    padded_lower[:n_points, :n_points] = lower
    padded_upper[:n_points, :n_points] = upper
    pads = range(n_points, n_points + n_pads)
    enclosure = enclose_coordinates(padded_lower, padded_upper, (*frame, *pads))
    if enclosure is None:
        return None
    # These coordinates are zero by definition; padding may hide that from the solver.
    for place, point in enumerate(frame):
        enclosure[point, :, place:] = 0.0
    return Interval(enclosure[:n_points, 0], enclosure[:n_points, 1])


def _mirrored(local: Interval, sign: int) -> Interval:
    """Return the coordinates, the last one negated when the sign is -1."""
    if sign > 0:
        return local
    low, high = np.array(local.lower), np.array(local.upper)
    low[:, -1], high[:, -1] = -local.upper[:, -1], -local.lower[:, -1]
    return Interval(low, high)


def _best_apexes(hypothesis: Hypothesis, core: Core, candidates: Sequence[int]) -> list[int]:
    """Return the candidates that are farthest from the hyperplane of the core, best first."""
    if len(candidates) < 2:
        return list(candidates)
    spans = dict.fromkeys(candidates, 0.0)
    if hypothesis.positions is not None:
        edges = hypothesis.positions - hypothesis.positions[core[0]]
        corners = edges[[(*core[1:], apex) for apex in candidates]]
        volumes = np.abs(np.linalg.det(corners)).tolist()
        by_span = sorted(zip(candidates, volumes, strict=True), key=lambda pair: -pair[1])
        # Bound the heights of the candidates that are farthest in the placement.
        spans = dict(by_span[: 2 * MAX_APEXES])
    heights = {}
    for apex, span in spans.items():
        # The height of the apex depends on these points only.
        frame = (*core, apex)
        among = np.ix_(frame, frame)
        lower, upper = hypothesis.lower[among], hypothesis.upper[among]
        local = _enclose_locally(lower, upper, range(len(frame)), len(core))
        if local is not None:
            # Rank by the proved height, and by the placement where that is zero.
            heights[apex] = (local.lower[-1, -1], span)
    ranked = sorted(heights, key=lambda apex: heights[apex], reverse=True)
    return ranked[:MAX_APEXES] or list(candidates[:1])
