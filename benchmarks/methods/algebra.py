# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Small algebra on the expressions of any library; None stands for zero, to spare terms."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, permutations
from typing import Any

Expression = Any


def parity(order: Sequence[int]) -> int:
    """Return +1 for an even permutation and -1 for an odd one."""
    inversions = sum(a > b for a, b in combinations(order, 2))
    return -1 if inversions % 2 else 1


def minus(a: Expression, b: Expression) -> Expression:
    """Return a - b."""
    if b is None:
        return a
    return -1.0 * b if a is None else a - b


def plus(a: Expression, b: Expression) -> Expression:
    """Return a + b."""
    if a is None or b is None:
        return b if a is None else a
    return a + b


def determinant(rows: Sequence[Sequence[Expression]]) -> Expression:
    """Return the determinant of a small square matrix, written out."""
    total: Expression = None
    for order in permutations(range(len(rows))):
        product: Expression = float(parity(order))
        for row, column in enumerate(order):
            entry = rows[row][column]
            product = None if product is None or entry is None else product * entry
        total = plus(total, product)
    return total
