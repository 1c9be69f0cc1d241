# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A test of boxes by chiralities.

Two chiralities that share a face fix a side. Two that share none still fix the sign of the product
of two signed volumes, which is a function of distances alone.
"""

from __future__ import annotations

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.interval.scalars import add, mul, sub
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray


@kernel(borrows=True)
def _inner_product(
    box: FloatArray, p_base: int, p: int, q_base: int, q: int
) -> tuple[float, float]:
    """Bound (x_p - x_pbase) . (x_q - x_qbase) from four squared distances (Eq. 3)."""
    low, high = sub(
        *add(
            box[LOWER, p, q_base],
            box[UPPER, p, q_base],
            box[LOWER, p_base, q],
            box[UPPER, p_base, q],
        ),
        *add(
            box[LOWER, p, q],
            box[UPPER, p, q],
            box[LOWER, p_base, q_base],
            box[UPPER, p_base, q_base],
        ),
    )
    return 0.5 * low, 0.5 * high


@kernel(borrows=True)
def _minor(gram: FloatArray, r: int, s: int, c: int, e: int) -> tuple[float, float]:
    """Bound the 2 x 2 minor of rows r, s and columns c, e."""
    return sub(
        *mul(gram[0, r, c], gram[1, r, c], gram[0, s, e], gram[1, s, e]),
        *mul(gram[0, r, e], gram[1, r, e], gram[0, s, c], gram[1, s, c]),
    )


@kernel
def volume_product(box: FloatArray, p: IntArray, q: IntArray) -> tuple[float, float]:
    """
    Bound det[p2 - p1, ...] det[q2 - q1, ...] over a box.

    The product of the two determinants is the determinant of the inner products
    (p_i - p_1) . (q_j - q_1), each a sum of four squared distances (Eq. 3).
    """
    size = len(p) - 1
    gram = np.empty((2, size, size))
    for r in range(size):
        for c in range(size):
            low, high = _inner_product(box, p[0], p[r + 1], q[0], q[c + 1])
            if np.isinf(low) or np.isinf(high):
                return -np.inf, np.inf
            gram[0, r, c] = low
            gram[1, r, c] = high
    if size == 1:
        return gram[0, 0, 0], gram[1, 0, 0]
    if size == 2:
        return _minor(gram, 0, 1, 0, 1)
    low = 0.0
    high = 0.0
    for c in range(3):
        minor_low, minor_high = _minor(gram, 1, 2, (c + 1) % 3, (c + 2) % 3)
        term = mul(gram[0, 0, c], gram[1, 0, c], minor_low, minor_high)
        low, high = add(low, high, *term)
    return low, high


@kernel
def chiralities_are_possible(box: FloatArray, simplices: IntArray, signs: IntArray) -> bool:
    """
    Return whether chiralities may hold together in a box; False is a proof that they do not.

    Every simplex is compared with the first one.

    False when two of them contradict each other everywhere in the box.
    """
    for x in range(1, len(signs)):
        low, high = volume_product(box, simplices[0], simplices[x])
        if signs[0] * signs[x] > 0:
            if high < 0.0:
                return False
        elif low > 0.0:
            return False
    return True
