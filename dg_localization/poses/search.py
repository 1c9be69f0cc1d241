# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The search for all poses that agree with readings: of one body, or of a few together."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.interval.pave import Examined, pave
from dg_localization.poses.cover import WIDEST_YAW_RAD, Cover
from dg_localization.poses.cuts import B_ERROR, BY_B, GROUP, OBSERVER, B
from dg_localization.poses.differences import reach_of_differences
from dg_localization.poses.half_spaces import HIGH, LOW, YAW, Z
from dg_localization.poses.inversion import COUNT, examine
from dg_localization.poses.readings import PairReadings, start_bounds
from dg_localization.poses.turns import HALF_TURN_UP, TURN

QUICK_READINGS = 48
QUICK_GENERATIONS = 4
"""The first generations try only a few readings, spread over the window: all readings would not
cut off much more of such large boxes."""

BATCH = 128
"""Boxes between two checks of the clock."""

_GOLDEN_RATIO = 0.5 * (math.sqrt(5.0) - 1.0)


@dataclass(frozen=True)
class PairOptions:
    """
    The resolution and the limits of a search for poses.

    Parameters
    ----------
    max_outliers : int
        Number of observations that may be wrong: a pose stays until more of them rule it out.
    resolution_m : float
        A box is finished if no reading changes by more than this along any of its axes.
    max_boxes : int
        Most boxes of a cover; a search that starts from more boxes returns these.
    max_programs : int
        Most boxes of joint poses of robots in the plane that linear programs narrow, if no outlier
        is tolerated.
    hull_only : bool
        Whether linear programs pass over boxes inside the hull of others, which cannot widen it.
        Fewer impossible hypotheses are ruled out. The hull is as narrow if headings were known
        before; from unknown ones it is often a little wider, since fewer boxes are halved.

    """

    max_outliers: int = 0
    resolution_m: float = 0.25
    max_boxes: int = 2000
    max_programs: int = 0
    hull_only: bool = False


class PosesFound(NamedTuple):
    """
    Boxes (m, 2, 4 n) that hold every pose of n bodies that readings allow.

    `refined` says whether all are as small as requested, `guilty` how many boxes the readings of
    each group ruled out.
    """

    boxes: np.ndarray
    refined: bool
    guilty: np.ndarray


class _Batch(NamedTuple):
    """Boxes of equal depth that are examined at once, in the arrays of `examine`."""

    depth: int
    boxes: np.ndarray
    tickets: np.ndarray
    pool: np.ndarray


@default_environment()
def cover_poses(
    readings: PairReadings,
    options: PairOptions | None = None,
    *,
    height_m: tuple[float, float] = (0.0, 0.0),
    within: Cover | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Cover:
    """
    Cover every pose of B in the frame of A that at most `max_outliers` readings rule out.

    `height_m` bounds the height of the origin of B over the origin of A: zero in the plane,
    infinite for unknown; `within` is a cover of the pose that replaces it. When `stopped` becomes
    true, the cover so far is returned, which is complete. It is empty if no pose agrees, and
    unbounded if the readings do not bound the position.
    """
    options = options or PairOptions()
    table = readings.table
    boxes = _start_boxes(table, options.max_outliers, height_m) if within is None else within.boxes
    if not np.all(np.isfinite(boxes)):
        return Cover(boxes, refined=False)
    found = find_poses(table, boxes, options, stopped)
    return Cover(found.boxes, found.refined)


def find_poses(
    table: np.ndarray, boxes: np.ndarray, options: PairOptions, stopped: Callable[[], bool]
) -> PosesFound:
    """Return the poses in finite boxes (m, 2, 4 n) that agree with the readings of a table."""
    inversion = _Inversion(table, options, len(boxes))
    paving = pave(
        inversion.batches(boxes),
        inversion.examine,
        lambda *_: inversion.has_room() and not stopped(),
        lambda batch: batch.depth,
    )
    left = [boxes[:0], *(batch.boxes for batch in (*paving.kept, *paving.pending))]
    return PosesFound(np.concatenate(left), not paving.pending, inversion.guilty)


class _Inversion:
    """Set inversion over the readings of a table; counts the boxes of its cover."""

    def __init__(self, table: np.ndarray, options: PairOptions, n_boxes: int) -> None:
        self._table, self._options, self._n_boxes = table, options, n_boxes
        self.guilty = np.zeros(int(table[:, GROUP].max(initial=0.0)) + 1, np.int64)

    def has_room(self) -> bool:
        """Return whether the cover may have more boxes."""
        return self._n_boxes < self._options.max_boxes

    def batches(self, boxes: np.ndarray) -> list[_Batch]:
        """Return boxes of which no reading is decided."""
        everything = np.array([0, len(self._table), *(0 * self.guilty)])
        return _batches(0, boxes, np.tile(everything, (len(boxes), 1)), _spread(len(self._table)))

    def examine(self, batch: _Batch) -> Examined[_Batch]:
        """Cut the boxes of a batch, and halve the undecided ones, while there is room."""
        depth, boxes, tickets, pool = batch
        options, axes = self._options, boxes.shape[2]
        quick = depth < QUICK_GENERATIONS
        most = QUICK_READINGS + options.max_outliers if quick else len(self._table)
        following = (
            np.empty((2 * len(boxes), 2, axes)),
            np.empty((2 * len(boxes), tickets.shape[1]), np.int64),
            np.empty(int(tickets[:, COUNT].sum()), np.int64),
        )
        finished = np.empty((len(boxes) + 1, 2, axes))
        gain = options.max_boxes - self._n_boxes
        limits = (options.max_outliers, options.resolution_m, gain, most)
        processed, listed, used, done = examine(
            boxes, tickets, pool, self._table, limits, *following, finished, self.guilty
        )
        self._n_boxes += listed + done - processed
        return Examined(
            _batches(depth, finished[:done], tickets[:0], pool),
            _batches(depth + 1, following[0][:listed], following[1][:listed], following[2][:used]),
            _batches(depth, boxes[processed:], tickets[processed:], pool),
        )


def _batches(depth: int, boxes: np.ndarray, tickets: np.ndarray, pool: np.ndarray) -> list[_Batch]:
    """Return boxes and their tickets in batches."""
    starts = range(0, len(boxes), BATCH)
    return [_Batch(depth, boxes[i : i + BATCH], tickets[i : i + BATCH], pool) for i in starts]


def _start_boxes(
    table: np.ndarray, max_outliers: int, height_m: tuple[float, float]
) -> np.ndarray:
    """Return boxes that hold every pose: bounds of the position of B, in slices of its yaw."""
    lower, upper = start_bounds(table, max_outliers)
    near, far = reach_of_differences(table[_spread(len(table))], max_outliers, height_m)
    lower, upper = np.maximum(lower, near), np.minimum(upper, far)
    lower[Z], upper[Z] = max(lower[Z], height_m[0]), min(upper[Z], height_m[1])
    if np.any(lower > upper):
        return np.empty((0, 2, 4))
    turns = np.any(table[:, B : B_ERROR + 2] != 0.0) or np.any(table[:, OBSERVER] == BY_B)
    slices = round(TURN / WIDEST_YAW_RAD) if turns else 1
    boxes = np.empty((slices, 2, 4))
    boxes[:, LOW, :YAW], boxes[:, HIGH, :YAW] = lower, upper
    edges = np.linspace(-math.pi, math.pi, slices + 1)
    edges[0], edges[-1] = -HALF_TURN_UP, HALF_TURN_UP
    boxes[:, LOW, YAW], boxes[:, HIGH, YAW] = edges[:-1], edges[1:]
    return boxes


def _spread(count: int) -> np.ndarray:
    """Return all indices in an order whose first ones are spread over the whole range."""
    return np.argsort((np.arange(count) * _GOLDEN_RATIO) % 1.0, kind='stable')
