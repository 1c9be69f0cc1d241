# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bounds of the distance of a body by range differences alone.

Let two beacons a and b be within e of a center, and o at the distance R from it, in the direction
u. Then |o - b| - |o - a| differs from u.(a - b) by at most e^2 / (2 (R - e)): from far away, a
difference depends on the direction alone. If no direction agrees with all differences, no distant
place does.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.arrays import Interval, dot, down, up
from dg_localization.interval.bounds import quotient_up, square_up, sum_up
from dg_localization.poses import cuts
from dg_localization.poses.half_spaces import Z
from dg_localization.poses.readings import norm_up

CELLS = {2: 64, 3: 24}
"""Number of cells along an edge of the square or cube that the directions are projected to."""

MOST_DIFFERENCES = 60


def reach_of_differences(
    table: np.ndarray, max_outliers: int, height_m: tuple[float, float]
) -> tuple[np.ndarray, np.ndarray]:
    """
    Bound the position of B, for any yaw, by its range differences to points of A.

    Parameters
    ----------
    table : numpy.ndarray, shape (m, COLUMNS)
        The readings; the first `MOST_DIFFERENCES` differences count.
    max_outliers : int
        A direction stays until more differences than this disagree.
    height_m : tuple of float
        Bounds of z; infinite in space.

    Returns
    -------
    lower, upper : numpy.ndarray, shape (3,)
        In m; infinite if some direction agrees.

    """
    nowhere = np.full(3, -math.inf), np.full(3, math.inf)
    heard = table[table[:, cuts.HEARD_BY] == cuts.BY_B][:MOST_DIFFERENCES]
    if len(heard) <= max_outliers:
        return nowhere
    ends = [heard[:, column : column + 3] for column in (cuts.A, cuts.REFERENCE)]
    errors = [heard[:, error : error + 3] for error in (cuts.A_ERROR, cuts.REFERENCE_ERROR)]
    center, rise_m, q = 0.5 * (ends[0] + ends[1]).mean(axis=0), 0.0, 3
    if np.isfinite(height_m).all():
        # The height counts as a part of e.
        center[Z], rise_m, q = 0.5 * sum(height_m), float(up(height_m[1] - height_m[0])), 2
    lever_m = up(up(norm_up(heard[:, cuts.B : cuts.B + 3]) + heard[:, cuts.ERROR_RADIUS]) + rise_m)
    away_m = [
        norm_up(up(up(np.abs(end - center)) + error))
        for end, error in zip(ends, errors, strict=True)
    ]
    e_m = float(up(np.maximum(*away_m) + lever_m).max())
    directions, radius = _directions(q)
    targets, references = map(Interval.around, ends, errors)
    ways = (references - targets)[:, :q]
    seen = dot(Interval.point(directions[:, None]), ways[None])
    # A direction is within `radius` of one of those.
    spread_m = up(norm_up(np.maximum(np.abs(ways.lower), np.abs(ways.upper))) * radius)
    off_m = np.maximum(heard[:, cuts.LEAST] - seen.upper, seen.lower - heard[:, cuts.MOST])
    off_m = np.sort(down(down(off_m) - spread_m), axis=1)[:, -1 - max_outliers]
    if off_m.min() <= 0.0:
        return nowhere
    far_m = sum_up(e_m, quotient_up(square_up(e_m), float(off_m.min())))
    around = Interval.around(center, np.full(3, far_m))
    return around.lower, around.upper


def _directions(q: int) -> tuple[np.ndarray, float]:
    """Return unit vectors, shape (k, q), and the greatest distance of any other to the nearest."""
    count = CELLS[q]
    middles = (2.0 * np.arange(count) + 1.0) / count - 1.0
    face = np.stack(np.meshgrid(*[middles] * (q - 1)), axis=-1).reshape(-1, q - 1)
    faces = [np.insert(face, axis, side, axis=1) for axis in range(q) for side in (-1.0, 1.0)]
    points = np.concatenate(faces)
    # Projecting onto the unit ball from outside lengthens no distance.
    radius = float(up(up(math.sqrt(q - 1)) / count))
    return points / np.linalg.norm(points, axis=1, keepdims=True), radius
