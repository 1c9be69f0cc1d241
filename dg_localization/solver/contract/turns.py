# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How far the pairs of a placement in the plane are turned against a reference, by its triangles.

**Differences.** The angle at each corner of each triangle is bounded, and with the chirality of
the triangle its sign (`triangle_angles`): the angle from one side to another. What that differs by
from the same angle in the reference is the difference of the turns of the two sides. A chain of
such differences bounds another one; the shortest chains (Floyd and Warshall) are all there is to
know of differences alone. Differences are meant in (-pi, pi]. A sum of two that must lie in there
is the difference, and not one that a whole turn is missing from; other sums are left out.

**Turns.** The Procrustes frame of a placement is turned so that the sum of |e_i|^2 is least
(`procrustes`). With g = x*_i - x*_j, a pair of length L that is turned by t against some frame has
g . v = |g| L cos t and g x v = |g| L sin t. Let t_q be the turns against pair p. The turn of p
itself is then minus the argument of the sum of |g_q| L_q exp(i t_q) over all pairs q, because the
sum of |e_i|^2 is that of |e_ij|^2 / n.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.kernels import kernel
from dg_localization.interval.rounding import down, rounding_error, sqrt_down, sqrt_up, up
from dg_localization.interval.scalars import add, mul, sub
from dg_localization.interval.trigonometry import angle_between, cosine, sine
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.newton import narrow_bounds
from dg_localization.solver.contract.reference import reference_distance_m2
from dg_localization.solver.contract.triangle_angles import (
    ascending,
    cross,
    permutation_sign,
    set_angles,
    set_chiralities,
)

FARTHEST = 3.14
"""Differences beyond this, in rad, are not taken for bounds: they may miss a whole turn."""


@kernel
def _signed_angle(low: float, high: float, sign: int, is_ahead: bool) -> tuple[float, float]:
    """
    Bound an angle with its sign by its absolute value.

    Where the sign is unknown, the angle is bounded around 0 or around pi, whichever is narrower;
    in the second case as one above 0 or below, as asked.
    """
    if sign > 0:
        return low, high
    if sign < 0:
        return -high, -low
    if up(low + high) < math.pi:
        return -high, high
    rest = up(up(2.0 * up(math.pi)) - low)
    return (low, rest) if is_ahead else (-rest, -low)


@kernel
def _set_differences(
    reference: FloatArray,
    angles: FloatArray,
    chiralities: NDArray[np.int8],
    number: IntArray,
    above: FloatArray,
) -> None:
    """Write the upper bounds of the turn of pair p less that of q at [p, q]; pi: unknown."""
    n_points = len(reference)
    above[:] = math.pi
    for p in range(len(above)):
        above[p, p] = 0.0
    for i in range(n_points):
        for j in range(n_points):
            for k in range(j + 1, n_points):
                if i in (j, k):
                    continue
                u, v, w = ascending(i, j, k)
                sign = chiralities[u, v, w] * permutation_sign(i, j, k)
                ahead = cross(reference, i, j, k) > 0.0
                angle = _signed_angle(angles[i, j, k, LOWER], angles[i, j, k, UPPER], sign, ahead)
                at_reference = angle_between(
                    reference[j, 0] - reference[i, 0],
                    reference[j, 1] - reference[i, 1],
                    reference[k, 0] - reference[i, 0],
                    reference[k, 1] - reference[i, 1],
                )
                low, high = sub(*angle, *at_reference)
                if low > -math.pi and high < math.pi:
                    p, q = number[i, k], number[i, j]
                    above[p, q] = min(above[p, q], high)
                    above[q, p] = min(above[q, p], -low)


@kernel
def shorten_chains(above: FloatArray, below: FloatArray, hubs: IntArray) -> None:
    """
    Bound the differences of turns by chains through some pairs, in place, not rounded outward.

    Only entries [p, q] with p < q are read and written; `complete` writes the others.

    Parameters
    ----------
    above : ndarray, shape (k, k)
        Upper bounds of the turn of pair p less that of q, in rad; pi where nothing is known.
    below : ndarray, shape (k, k)
        Those of the turn of pair q less that of p.
    hubs : ndarray of int
        The pairs in the middle of the chains.

    """
    n_pairs = len(above)
    from_hub, to_hub = np.empty(n_pairs), np.empty(n_pairs)
    for hub in hubs:
        from_hub[:hub], from_hub[hub:] = below[:hub, hub], above[hub, hub:]
        to_hub[:hub], to_hub[hub:] = above[:hub, hub], below[hub, hub:]
        for p in range(n_pairs):
            to, back = to_hub[p], from_hub[p]
            if p == hub or not (to < FARTHEST and back < FARTHEST):
                continue
            # Compiled, slices and one branch are six times as fast as indices and two choices.
            highest, lowest = above[p, p + 1 :], below[p, p + 1 :]
            onward, backward = from_hub[p + 1 :], to_hub[p + 1 :]
            for q in range(len(highest)):
                high, low = to + onward[q], back + backward[q]
                if (high < FARTHEST) & (low < FARTHEST):
                    highest[q] = min(highest[q], high)
                    lowest[q] = min(lowest[q], low)


@kernel
def complete(above: FloatArray, below: FloatArray, n_hubs: int) -> None:
    """Write bounds [p, q] with p > q; widen all by the rounding of a chain through each hub."""
    slack = rounding_error(math.pi, 2.0 * n_hubs)
    for p in range(len(above)):
        for q in range(p + 1, len(above)):
            if above[p, q] < math.pi:
                above[p, q] = up(above[p, q] + slack)
            if below[p, q] < math.pi:
                below[p, q] = up(below[p, q] + slack)
            above[q, p], below[q, p] = below[p, q], above[p, q]


@kernel
def number_pairs(n_points: int, number: IntArray, pairs: IntArray) -> None:
    """Write the number of each pair, and the points i < j of each number."""
    n_pairs = 0
    for i in range(n_points):
        for j in range(i + 1, n_points):
            number[i, j] = number[j, i] = n_pairs
            pairs[n_pairs, 0], pairs[n_pairs, 1] = i, j
            n_pairs += 1


@kernel
def set_differences(
    box: FloatArray, reference: FloatArray, number: IntArray, above: FloatArray
) -> None:
    """
    Write the bounds of differences of turns that single triangles give.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; all its upper bounds are finite.
    reference : ndarray, shape (n, 2)
        The reference in m, on a grid (`reference`).
    number : ndarray of int, shape (n, n)
        The numbers of the pairs.
    above : ndarray, shape (k, k)
        Where the upper bounds of the turn of pair p less that of q are written, in rad.

    """
    n_points = len(reference)
    angles = np.zeros((n_points, n_points, n_points, 2))
    chiralities = np.empty((n_points, n_points, n_points), dtype=np.int8)
    set_angles(box, angles)
    set_chiralities(angles, reference, chiralities)
    _set_differences(reference, angles, chiralities, number, above)


@kernel
def _turn_above(
    box: FloatArray,
    reference: FloatArray,
    pairs: IntArray,
    to_others: FloatArray,
    from_others: FloatArray,
) -> float:
    """Return the upper bound of the turn of a pair by its differences to the others and back."""
    total, weights = 0.0, 0.0
    for q in range(len(pairs)):
        weight = box[UPPER, pairs[q, 0], pairs[q, 1]]
        if to_others[q] < math.pi:
            total += weight * to_others[q]
            weights += weight
    guess = total / weights if weights > 0.0 else 0.0
    along, across = 0.0, 0.0
    for q in range(len(pairs)):
        i, j = pairs[q, 0], pairs[q, 1]
        g_m2 = reference_distance_m2(reference, i, j)
        length = sqrt_down(box[LOWER, i, j]), sqrt_up(box[UPPER, i, j])
        length = mul(*length, sqrt_down(g_m2), sqrt_up(g_m2))
        turn = -math.inf, math.inf
        if to_others[q] < math.pi and from_others[q] < math.pi:
            turn = add(-to_others[q], from_others[q], guess, guess)
        along = down(along + mul(*length, *cosine(*turn))[0])
        across = down(across + mul(*length, *sine(*turn))[0])
    if not along > 0.0 or abs(guess) > 0.5 * math.pi:
        return math.pi
    return up(guess + angle_between(1.0, 0.0, 1.0, up(max(0.0, -across) / along))[1])


@kernel
def narrow_turns_by_differences(
    box: FloatArray,
    reference: FloatArray,
    pairs: IntArray,
    above: FloatArray,
    below: FloatArray,
    some: IntArray,
    turns: FloatArray,
) -> bool:
    """
    Narrow the turns of some pairs in the Procrustes frame, and those of all others by theirs.

    Parameters
    ----------
    box, reference
        See `set_differences`.
    pairs : ndarray of int, shape (k, 2)
        All pairs i < j, by number.
    above, below : ndarray, shape (k, k)
        Upper bounds of the turn of pair p less that of q, and of the turn of q less that of p.
    some : ndarray of int
        The numbers of some pairs.
    turns : ndarray, shape (n, 2, n)
        Bounds of the turn of pair i < j at [i, :, j] in rad, within [-pi, pi]; narrowed.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    for p in some:
        high = _turn_above(box, reference, pairs, above[p], below[p])
        low = -_turn_above(box, reference, pairs, below[p], above[p])
        if not (low > -math.pi and high < math.pi):
            continue
        for q in range(len(pairs)):
            i, j = pairs[q, 0], pairs[q, 1]
            least, most = add(low, high, -above[p, q], below[p, q])
            known = above[p, q] < math.pi and below[p, q] < math.pi
            if known and least > -math.pi and most < math.pi:
                if narrow_bounds(turns[i], j, least, most) < 0.0:
                    return False
    return True
