# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which placement goes on from which one of the estimate before."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.snapshot import Snapshot

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Framed:
    """A placement and the frame of its coordinates."""

    placement: Placement
    frame: FixedFrame | None


def matches(
    snapshot: Snapshot, before_s: float, before: Sequence[Framed], now: Sequence[Framed]
) -> dict[int, int]:
    """
    Match placements with those they go on from.

    Two can be of one hypothesis where the distances of now are those of before, as far as the
    robots can have moved. Of these, positions that differ least go together, in the frame of the
    anchors. Any other frame moves with the fleet: there the shapes are compared, and a mirror
    image is another shape.
    """
    if not before or not now:
        return {}
    old_placements = [one.placement for one in before]
    new_placements = [one.placement for one in now]
    first, second = _positions(old_placements)[:, None], _positions(new_placements)[None]
    known = np.asarray(np.isfinite(first).all(axis=-1) & np.isfinite(second).all(axis=-1))
    at_rest = np.array(
        [[old.frame == new.frame and _is_at_rest(new.frame) for new in now] for old in before]
    )
    cost_m2 = np.where(at_rest, _moved_m2(first, second, known), _bent_m2(first, second, known))
    possible = _distances_agree(snapshot, before_s, old_placements, new_placements)
    cost_m2 = np.where(possible & _share_robots(first, second, known), cost_m2, np.inf)
    found: dict[int, int] = {}
    for flat in np.argsort(cost_m2, axis=None, kind='stable'):
        old, new = divmod(int(flat), len(now))
        if not np.isfinite(cost_m2[old, new]):
            break
        if new not in found and old not in found.values():
            found[new] = old
    return found


def _positions(placements: Sequence[Placement]) -> FloatArray:
    return np.stack([placement.positions_m for placement in placements])


def _distances_agree(
    snapshot: Snapshot, before_s: float, before: Sequence[Placement], now: Sequence[Placement]
) -> NDArray[np.bool_]:
    """Return which placements of before and of now, (k, m), may have the same distances."""
    moved = np.array(
        [
            snapshot.motion.displacement_m(robot, before_s, snapshot.stamp_s)
            for robot in snapshot.config.robots
        ]
    )
    slack = moved[:, None] + moved[None]
    lower = np.stack([placement.lower_m - slack for placement in before])
    upper = np.stack([placement.upper_m + slack for placement in before])
    new_lower = np.stack([placement.lower_m for placement in now])
    new_upper = np.stack([placement.upper_m for placement in now])
    meet = (lower[:, None] <= new_upper[None]) & (new_lower[None] <= upper[:, None])
    return np.asarray(meet.all(axis=(2, 3)))


def _share_robots(
    first: FloatArray, second: FloatArray, known: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """Return which placements, (k, m), have more than one robot in common, or all of one."""
    fewest = np.minimum(_n_placed(first), _n_placed(second))
    return np.asarray(known.sum(axis=-1) >= np.clip(fewest, 1, 2))


def _n_placed(positions: FloatArray) -> NDArray[np.int_]:
    """Return how many robots have a position in each placement."""
    return np.asarray(np.isfinite(positions).all(axis=-1).sum(axis=-1))


def _is_at_rest(frame: FixedFrame | None) -> bool:
    return frame is not None and frame.kind is FrameKind.ANCHORS


def _moved_m2(first: FloatArray, second: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return how far the robots moved from placement to placement: mean squares, (k, m)."""
    squares = np.where(known[..., None], first - second, 0.0) ** 2
    return np.asarray(squares.sum(axis=(-1, -2)) / np.maximum(known.sum(axis=-1), 1))


def _bent_m2(first: FloatArray, second: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return the same after the motion of the fleet as a whole that fits best."""
    first, second = _centered(first, known), _centered(second, known)
    values = np.linalg.svd(np.einsum('kmni,kmnj->kmij', first, second), compute_uv=True)
    turns = np.sign(np.linalg.det(values.U) * np.linalg.det(values.Vh))
    gain = values.S[..., :-1].sum(axis=-1) + turns * values.S[..., -1]
    spread = (first**2).sum(axis=(-1, -2)) + (second**2).sum(axis=(-1, -2))
    mean = np.maximum(spread - 2.0 * gain, 0.0) / np.maximum(known.sum(axis=-1), 1)
    return np.asarray(mean)


def _centered(points: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return points around the middle of those that are known, zero for the others."""
    shape = (*known.shape, points.shape[-1])
    points = np.where(known[..., None], np.broadcast_to(points, shape), 0.0)
    count = np.maximum(known.sum(axis=-1), 1)[..., None, None]
    middle = points.sum(axis=-2, keepdims=True) / count
    return np.asarray(np.where(known[..., None], points - middle, 0.0))
