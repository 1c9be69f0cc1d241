# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which placement goes on from which one of the estimate before."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.snapshot import Snapshot

FloatArray = NDArray[np.float64]


def matches(
    snapshot: Snapshot,
    before_s: float,
    before: Sequence[Placement],
    now: Sequence[Placement],
) -> dict[int, int]:
    """
    Match placements with those they go on from.

    Two can be of one hypothesis where the distances of now are those of before, as far as the
    robots can have moved. Of these, shapes that differ least go together: the frame of a fleet
    moves with it, and a mirror image is another shape.

    Parameters
    ----------
    snapshot : Snapshot
        Of now.
    before_s : float
    before, now : sequence of Placement

    Returns
    -------
    dict of int to int
        From an index into `now` to one into `before`; no two to the same.

    """
    if not before or not now:
        return {}
    possible = _distances_agree(snapshot, before_s, before, now)
    cost_m2 = _difference_m2(_positions(before), _positions(now))
    cost_m2 = np.where(possible, cost_m2, np.inf)
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


def _difference_m2(before: FloatArray, now: FloatArray) -> FloatArray:
    """
    Return how much shapes differ, (k, m), after the motion that fits best; infinite for strangers.

    Parameters
    ----------
    before : numpy.ndarray, shape (k, n, q)
    now : numpy.ndarray, shape (m, n, q)

    """
    first, second = before[:, None], now[None]
    known = np.asarray(np.isfinite(first).all(axis=-1) & np.isfinite(second).all(axis=-1))
    count = known.sum(axis=-1)
    first, second = _centered(first, known), _centered(second, known)
    values = np.linalg.svd(np.einsum('kmni,kmnj->kmij', first, second), compute_uv=True)
    turns = np.sign(np.linalg.det(values.U) * np.linalg.det(values.Vh))
    gain = values.S[..., :-1].sum(axis=-1) + turns * values.S[..., -1]
    spread = (first**2).sum(axis=(-1, -2)) + (second**2).sum(axis=(-1, -2))
    mean = np.maximum(spread - 2.0 * gain, 0.0) / np.maximum(count, 1)
    return np.asarray(np.where(count > 0, mean, np.inf))


def _centered(points: FloatArray, known: NDArray[np.bool_]) -> FloatArray:
    """Return points around the middle of those that are known, zero for the others."""
    shape = (*known.shape, points.shape[-1])
    points = np.where(known[..., None], np.broadcast_to(points, shape), 0.0)
    count = np.maximum(known.sum(axis=-1), 1)[..., None, None]
    middle = points.sum(axis=-2, keepdims=True) / count
    return np.asarray(np.where(known[..., None], points - middle, 0.0))
