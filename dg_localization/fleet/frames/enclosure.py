# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Enclosures: the coordinates in the fixed frame that the boxes of a hypothesis allow.

Interval arithmetic, rounded outward, from the distances to the coordinates: the true placement
cannot get lost.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, reduce

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FrameKind
from dg_localization.fleet.frames.local import best_apexes, enclose_locally, mirrored
from dg_localization.fleet.frames.mirror_images import ChiralityChoice
from dg_localization.fleet.frames.registration import Registration
from dg_localization.interval.arrays import Interval, determinant
from dg_localization.solver.contract.angles import ANGLE_SWEEPS, contract_by_angles
from dg_localization.solver.contract.coordinate_boxes import contract_coordinate_boxes
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]
Core = tuple[int, ...]

MAX_BOXES = 16
"""Up to how many boxes of a hypothesis are enclosed one by one instead of by their hull."""

SWEEPS = 20
"""Most passes of the contraction of coordinate boxes."""


class Encloser:
    """
    Encloses the solved points of a plan in the fixed frame.

    Parameters
    ----------
    solved : Constraints
        Of the solved points.
    registration : Registration
    rows : sequence of int
        Those that frames are made of.

    """

    def __init__(
        self, solved: Constraints, registration: Registration, rows: Sequence[int]
    ) -> None:
        self._solved = solved
        self._rows = rows
        self._cosines = solved.angles.cosines()
        self._registration = registration
        self._poses = {core: registration.pose_of(core) for core in registration.cores}

    def enclose(
        self, hypothesis: Hypothesis, choices: Sequence[ChiralityChoice | None]
    ) -> list[tuple[ChiralityChoice | None, Interval]]:
        """
        Return the coordinates of mirror images of a hypothesis.

        Parameters
        ----------
        hypothesis : Hypothesis
        choices : sequence of ChiralityChoice or None
            Which of them; None when there is only one.

        Returns
        -------
        list of tuple of ChiralityChoice or None, and Interval, shape (n, q)
            A choice without such coordinates is left out.

        """
        boxes = hypothesis.boxes
        if len(boxes) > MAX_BOXES:
            boxes = np.stack([hypothesis.lower, hypothesis.upper])[None]

        @cache
        def apexes_of(core: Core) -> list[int]:
            others = [row for row in self._rows if row not in core]
            return best_apexes(hypothesis, core, others)

        images = []
        for choice in choices:
            parts = [
                self._enclose_box(np.array(lower), np.array(upper), choice, apexes_of)
                for lower, upper in boxes
            ]
            enclosures = [part for part in parts if part is not None]
            if enclosures:
                images.append((choice, reduce(Interval.hull, enclosures)))
        return images

    def _enclose_box(
        self,
        lower: FloatArray,
        upper: FloatArray,
        choice: ChiralityChoice | None,
        apexes_of: Callable[[Core], list[int]],
    ) -> Interval | None:
        """Return the coordinates that one box of squared distances allows."""
        corners = self._solved.angles.corners
        contract_by_angles(lower, upper, corners, self._cosines, ANGLE_SWEEPS)
        if (lower > upper).any():
            return None
        fixed = self._enclose_by_core(lower, upper, choice)
        if fixed is None or choice is None:
            return fixed
        fixed = self._intersect_cores(fixed, lower, upper, choice, apexes_of)
        if fixed is None:
            return None
        fixed = self._contract(fixed, lower, upper)
        if fixed is None or self._contradicts_chirality(fixed):
            return None
        return fixed

    def _enclose_by_core(
        self, lower: FloatArray, upper: FloatArray, choice: ChiralityChoice | None
    ) -> Interval | None:
        """Return the coordinates by the first core."""
        core = self._registration.cores[0]
        frame, sign = (core, 1) if choice is None else ((*core, choice.apex), choice.sign)
        local = enclose_locally(lower, upper, frame, self._solved.dimension)
        if local is None:
            return None
        fixed = self._poses[core].to_fixed(mirrored(local, sign))
        return self._contract(fixed, lower, upper)

    def _intersect_cores(
        self,
        fixed: Interval,
        lower: FloatArray,
        upper: FloatArray,
        choice: ChiralityChoice,
        apexes_of: Callable[[Core], list[int]],
    ) -> Interval | None:
        """Return the part of an enclosure that all cores and apexes of certain sign allow."""
        for core, pose in self._poses.items():
            for apex in apexes_of(core):
                if (core, apex) == (choice.core, choice.apex):
                    continue
                sign = _chirality_of(fixed, (*core, apex))
                if sign == 0:
                    continue
                local = enclose_locally(lower, upper, (*core, apex), self._solved.dimension)
                if local is None:
                    return None
                fixed = fixed.intersect(pose.to_fixed(mirrored(local, sign)))
                if fixed.empty():
                    return None
        return fixed

    def _contract(self, fixed: Interval, lower: FloatArray, upper: FloatArray) -> Interval | None:
        """Return the part that the distances and the coordinates of the anchors allow."""
        low, high = np.array(fixed.lower), np.array(fixed.upper)
        if self._registration.kind == FrameKind.ANCHORS:
            for point, box in self._registration.anchors.items():
                low[point] = np.maximum(low[point], box.lower)
                high[point] = np.minimum(high[point], box.upper)
        if (low > high).any():
            return None
        if not contract_coordinate_boxes(low, high, lower, upper, SWEEPS):
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


def _chirality_of(coordinates: Interval, points: tuple[int, ...]) -> int:
    """Return the sign of the chirality of q + 1 points, or 0 when in doubt."""
    chosen = coordinates[list(points)]
    return determinant(chosen[1:] - chosen[:1]).sign()
