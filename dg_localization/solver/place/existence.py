# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The proof that a placement exists near given coordinates.

No coordinates in floating point meet exact distances. With displacements e of the points, a pair
has the squared distance t when

    d . (e_i - e_j) + |e_i - e_j|^2 / 2 = (t - |d|^2) / 2,    d = x_i - x_j.

Let the rows of A be these d, each scaled by about 1 / |d|, and R an approximate right inverse of A
in floating point. For e = R z, the equations of all exact pairs are z = F(z) with

    F(z) = r - (A R - 1) z - |e_m|^2 / (2 |d_m|)  for each pair m.

If F maps the cube |z| <= rho into itself, it has a fixed point there (Brouwer), so there is a
placement with all these distances within |R| rho of the coordinates. The other constraints are
then checked for all placements within this distance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dg_localization.interval.arrays import Interval, determinant, squared_norm, total_up, up
from dg_localization.interval.kernels import WORK_OF_A_STEP, WORK_PER_LOOK, look_after
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.place.proofs import agrees, lies_in
from dg_localization.solver.problem import Problem, Side
from dg_localization.solver.subproblem import MOST_NUMBERS

NEARNESS = 1e-9
"""Greatest error of coordinates that represent a placement, as a multiple of the longest known
distance."""

NARROW = 1e-10
"""A pair whose squared distance is known to this fraction counts as exact."""

NEWTON_STEPS = 6


def settled(
    problem: Problem, positions: FloatArray, boxes: Sequence[FloatArray] | None = None
) -> tuple[FloatArray, bool]:
    """
    Move a placement onto the exact distances; return it, and whether it is proved to agree.

    The clock is checked in between (`look_after`).
    """
    if agrees(problem, positions):
        return positions, boxes is None or any(lies_in(box, positions) for box in boxes)
    known = problem.pairs
    exact = np.isfinite(known.upper) & ((1.0 - NARROW) * known.upper <= known.lower)
    pairs = known.pairs[exact]
    is_solvable = 0 < len(pairs) <= positions.size - positions.shape[1]
    # A proof inverts a matrix with a row and a column for each pair.
    is_solvable &= len(pairs) ** 2 <= MOST_NUMBERS
    if not (is_solvable and np.isfinite(positions).all()):
        return positions, False
    with np.errstate(all='ignore'):
        targets = 0.5 * (known.lower[exact] + known.upper[exact])
        moved = _newton(positions, pairs, targets)
        if moved is None:
            return positions, False
        radii = _radii(*moved, pairs, targets)
        longest_m = np.sqrt(known.upper[np.isfinite(known.upper)].max())
        if radii is None or not (radii <= NEARNESS * longest_m).all():
            return positions, False
        near = Interval.around(moved[0], radii)
        others = known.pairs[~exact], known.lower[~exact], known.upper[~exact]
        proved = (
            _all_lie_within(near, *others)
            and _all_have_sides(near, problem)
            and (boxes is None or any(_may_lie_in(box, near) for box in boxes))
        )
    return (moved[0], True) if proved else (positions, False)


def _newton(
    positions: FloatArray, pairs: IntArray, targets: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Return coordinates that meet targets in m^2 up to rounding, and a right inverse; or None."""
    moved = positions
    first, second = pairs.T
    number = np.arange(len(pairs))
    for _ in range(NEWTON_STEPS):
        look_after(len(pairs) ** 3 // 3)
        differences = moved[first] - moved[second]
        squared = (differences**2).sum(axis=1)
        weights = 1.0 / np.sqrt(squared)
        if not np.isfinite(weights).all():
            return None
        rows = np.zeros((len(pairs), *positions.shape))
        rows[number, first], rows[number, second] = differences, -differences
        rows = rows.reshape(len(pairs), -1) * weights[:, None]
        try:
            along = np.linalg.solve(rows @ rows.T, 0.5 * (targets - squared) * weights)
        except np.linalg.LinAlgError:
            return None
        step = (along @ rows).reshape(positions.shape)
        moved = moved + step
        if not np.isfinite(moved).all():
            return None
        if np.abs(step).max() <= np.finfo(float).eps * np.abs(moved).max():
            break
    look_after(positions.size * len(pairs) ** 2)
    return moved, np.linalg.solve(rows @ rows.T, rows).T


def _radii(
    positions: FloatArray, inverse: FloatArray, pairs: IntArray, targets: FloatArray
) -> FloatArray | None:
    """Return proved radii around each coordinate that hold a placement; None without a proof."""
    points = Interval.point(positions)
    first, second = pairs.T
    differences = points[first] - points[second]
    squared = squared_norm(differences)
    scales = 1.0 / np.sqrt(squared.upper)
    if not np.isfinite(scales).all():
        return None
    weights = Interval.point(scales)
    half = Interval.point(np.array(0.5))
    residuals = _magnitude((Interval.point(targets) - squared) * weights * half).max()
    by_points = Interval.point(inverse.reshape(*positions.shape, len(pairs)))
    contraction = _contraction(differences * weights[:, None], by_points, pairs)
    reach = total_up(np.abs(by_points.lower))
    spread = Interval.point(reach[first]) + Interval.point(reach[second])
    curvature = (squared_norm(spread) * weights * half).upper.max()
    # Twice the share of the residuals leaves room for the other two terms.
    radius = 2.0 * residuals / max(1.0 - contraction, NEARNESS) + np.finfo(float).tiny
    image = up(up(residuals + up(contraction * radius)) + up(up(curvature * radius) * radius))
    return up(reach * radius) if image <= radius else None


def _contraction(slopes: Interval, inverse: Interval, pairs: IntArray) -> float:
    """Return an upper bound of the norm of A R - 1; the clock is checked in between."""
    n_pairs, dimension = slopes.lower.shape
    unit, norms = np.eye(n_pairs), np.zeros(n_pairs)
    at_once = 1 + WORK_OF_A_STEP // n_pairs
    for first in range(0, n_pairs, at_once):
        some = slice(first, first + at_once)
        product = -Interval.point(unit[some])
        for axis in range(dimension):
            relative = inverse[pairs[some, 0], axis] - inverse[pairs[some, 1], axis]
            product = product + slopes[some, axis, None] * relative
        norms[some] = total_up(_magnitude(product))
        look_after(WORK_PER_LOOK)
    return float(norms.max())


def _magnitude(values: Interval) -> FloatArray:
    """Return the largest absolute values in intervals."""
    return np.maximum(np.abs(values.lower), np.abs(values.upper))


def _all_lie_within(near: Interval, pairs: IntArray, lower: FloatArray, upper: FloatArray) -> bool:
    """Return whether the squared distances of all placements in a box lie within their bounds."""
    squared = squared_norm(near[pairs[:, 0]] - near[pairs[:, 1]])
    return bool(((lower <= squared.lower) & (squared.upper <= upper)).all())


def _may_lie_in(box: FloatArray, near: Interval) -> bool:
    """Return whether some placement within bounds of coordinates may lie in a box."""
    squared = squared_norm(near[:, None] - near[None])
    apart = (squared.upper < box[LOWER]) | (box[UPPER] < squared.lower)
    return not apart.any()


def _all_have_sides(near: Interval, problem: Problem) -> bool:
    """Return whether all placements within bounds have the known sides and chiralities."""

    def sign(*points: int) -> int:
        corners = near[np.array(points)]
        return determinant(corners[1:] - corners[:1]).sign()

    return all(
        sign(*side.face, side.first) * sign(*side.face, side.second) == -side.side
        for side in problem.sides
        if side.side is not Side.FREE
    ) and all(sign(*c.points) == c.sign for c in problem.chiralities)
