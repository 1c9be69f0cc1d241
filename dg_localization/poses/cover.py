# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Covers: boxes of relative poses that hold every pose which agrees with the readings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np

from dg_localization.interval.angles import angle_down, angle_up
from dg_localization.interval.arrays import Interval
from dg_localization.interval.components import components
from dg_localization.poses.grid import fill_cells
from dg_localization.poses.half_spaces import HIGH, LOW, YAW
from dg_localization.poses.readings import PastPoses
from dg_localization.poses.turns import HALF_TURN_UP, TURN, principal, turned

WIDEST_YAW_RAD = TURN / 16.0
"""Widest yaw of the boxes at the start of a search: cuts are sharp to second order in the yaw."""

CARRIED_YAW_RAD = TURN / 80.0
"""Widest yaw of carried boxes: the yaw of a box swings a step, which widens the box."""


@dataclass(frozen=True)
class Cover:
    """
    Boxes that together hold every pose of B in the frame of A.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (n, 2, 4)
        Lower and upper bounds of x, y, z in m and yaw in rad. Yaws are angles: a box may reach
        beyond pi.
    refined : bool
        Whether every box is as small as requested; false if the time or the number of boxes ran
        out. The cover is complete in either case.

    """

    boxes: np.ndarray
    refined: bool = True

    def __len__(self) -> int:
        return len(self.boxes)

    @property
    def empty(self) -> bool:
        """Whether no pose is left, which proves a wrong measurement or bound."""
        return len(self.boxes) == 0

    @property
    def bounded(self) -> bool:
        """Whether the positions are bounded at all."""
        return bool(np.all(np.isfinite(self.boxes)))

    def contains(self, position_m: np.ndarray, yaw_rad: float) -> bool:
        """Return whether a pose lies in one of the boxes, within the rounding of its yaw."""
        lower, upper = self.boxes[:, LOW], self.boxes[:, HIGH]
        position = np.asarray(position_m, dtype=float)
        near = np.all((lower[:, :YAW] <= position) & (position <= upper[:, :YAW]), axis=-1)
        # The angle counterclockwise from just below the lower end, and the width of the box.
        beyond = np.remainder(angle_up(yaw_rad - lower[:, YAW]), TURN)
        width = angle_up(angle_up(upper[:, YAW] - lower[:, YAW]))
        return bool(np.any(near & (beyond <= width)))

    @cached_property
    def components(self) -> tuple[Cover, ...]:
        """The parts that do not touch each other, largest volume first."""
        parts = [Cover(self.boxes[some], self.refined) for some in components(self.boxes, TURN)]
        return tuple(sorted(parts, key=lambda part: -part.volume))

    @property
    def volume(self) -> float:
        """Sum of the volumes of the boxes over the axes that are open, in plain arithmetic."""
        widths = self.boxes[:, HIGH] - self.boxes[:, LOW]
        return float(np.prod(np.where(widths > 0.0, widths, 1.0), axis=-1).sum())

    @property
    def position_m(self) -> Interval:
        """The smallest box around all positions, shape (3,); ValueError for an empty cover."""
        if self.empty:
            raise ValueError('an empty cover has no hull')
        boxes = self.boxes[:, :, :YAW]
        return Interval(boxes[:, LOW].min(axis=0), boxes[:, HIGH].max(axis=0))

    @cached_property
    def yaw_rad(self) -> tuple[float, float]:
        """The shortest arc around all yaws, counterclockwise; the cover must not be empty."""
        return arc_around(self.boxes[:, LOW, YAW], self.boxes[:, HIGH, YAW])

    def carried(
        self, step: PastPoses, ball_m: float, back: PastPoses | None, in_plane: bool
    ) -> Cover | None:
        """
        Return the cover after both bodies have moved along their tracks; None if unbounded.

        `step` is the pose of B relative to its earlier pose, with a further error of `ball_m` in
        any direction; `back` is the earlier pose of A relative to its pose now, None at rest.
        """
        lower, upper = self.boxes[:, LOW], self.boxes[:, HIGH]
        yaw = Interval(lower[:, YAW], upper[:, YAW])
        off = np.array([ball_m, ball_m, 0.0 if in_plane else ball_m])
        positions = Interval(lower[:, :YAW], upper[:, :YAW]) + turned(yaw, step.position_m)
        positions, yaw = positions + Interval(-off, off), yaw + step.yaw_rad
        if back is not None:
            positions = turned(back.yaw_rad, positions) + back.position_m
            yaw = yaw + back.yaw_rad
        if not (np.all(np.isfinite(positions.lower)) and np.all(np.isfinite(positions.upper))):
            return None
        yaw, boxes = principal(yaw), np.empty_like(self.boxes)
        boxes[:, LOW, :YAW], boxes[:, HIGH, :YAW] = positions.lower, positions.upper
        boxes[:, LOW, YAW], boxes[:, HIGH, YAW] = yaw.lower, yaw.upper
        return Cover(boxes, self.refined)

    def unbounded(self) -> Cover:
        """Return a cover of all poses."""
        everywhere = np.full((1, 2, 4), math.inf)
        everywhere[:, LOW] = -math.inf
        return Cover(everywhere, refined=False)

    def coarsened(self, max_boxes: int) -> Cover:
        """
        Return a cover of at most `max_boxes` boxes, or a few per component, around these boxes.

        Its boxes do not overlap, unlike the boxes of a carried cover.
        """
        parts = [
            _gridded(part.boxes, int(max_boxes * len(part) / len(self)))
            for part in self.components
        ]
        return Cover(np.concatenate([np.empty((0, 2, 4)), *parts]), self.refined)


def arc_around(lower: np.ndarray, upper: np.ndarray) -> tuple[float, float]:
    """Return the shortest arc that holds all given arcs; its lower end is within a half turn."""
    start = np.remainder(lower, TURN)
    order = np.argsort(start)
    lower, upper = angle_down(start)[order], angle_up(angle_up(start + (upper - lower)))[order]
    # An arc that wraps around covers the first ones again.
    reached = np.maximum.accumulate(np.maximum(upper, upper.max() - TURN))
    gaps = np.append(lower[1:] - reached[:-1], lower[0] + TURN - reached[-1])
    widest = int(np.argmax(gaps))
    if gaps[widest] <= 0.0:
        return -HALF_TURN_UP, HALF_TURN_UP
    wraps = widest < len(lower) - 1
    first = float(lower[widest + 1 if wraps else 0])
    last = float(reached[widest] + TURN if wraps else reached[-1])
    turns = TURN if first > math.pi else 0.0
    return angle_down(first - turns), angle_up(last - turns)


def _gridded(boxes: np.ndarray, max_boxes: int) -> np.ndarray:
    """Return the hulls of the parts of boxes of one component in the cells of a grid."""
    boxes = _unrolled(boxes)
    low, high = boxes[:, LOW].min(axis=0), boxes[:, HIGH].max(axis=0)
    slices = math.ceil((high[YAW] - low[YAW]) / CARRIED_YAW_RAD)
    best = fill_cells(boxes, low, high, np.ones(4, np.int64))
    for across in range(1, max_boxes + 1):
        shape = np.array([across, across, across if high[2] > low[2] else 1, slices])
        cells = fill_cells(boxes, low, high, shape)
        if len(cells) > max_boxes:
            break
        best = cells
    yaw = principal(Interval(best[:, LOW, YAW], best[:, HIGH, YAW]))
    best[:, LOW, YAW], best[:, HIGH, YAW] = yaw.lower, yaw.upper
    return best


def _unrolled(boxes: np.ndarray) -> np.ndarray:
    """Return the boxes with their yaws unwrapped to one connected interval."""
    start = arc_around(boxes[:, LOW, YAW], boxes[:, HIGH, YAW])[0]
    turns = np.floor((boxes[:, LOW, YAW] - start) / TURN)
    unrolled = boxes.copy()
    unrolled[:, LOW, YAW] = angle_down(boxes[:, LOW, YAW] - turns * TURN)
    unrolled[:, HIGH, YAW] = angle_up(boxes[:, HIGH, YAW] - turns * TURN)
    return unrolled
