# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The scratch space of one projection: its points in rows, several of which a processor does at once.

Loops over a row are written for vector instructions: from 0 over whole lanes, without a branch of
the program, and writing one array each, because the compiler has to test at run time that what is
written overlaps nothing that is read. Each row holds its pairs with all others, so every pair is
there twice, to the last bit alike. In spare lanes are pairs that may be any distance apart, so
that a lane in which nothing is left is a proof.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import COMPILED, kernel
from dg_localization.solver.box import FloatArray, IntArray

LANES = 8 if COMPILED else 1
"""Rows are done so many pairs at a time."""

(
    A_LOWER,
    A_UPPER,
    B_LOWER,
    B_UPPER,
    DIFFERENCE_LOWER,
    DIFFERENCE_UPPER,
    T_LOWER,
    T_UPPER,
    NEW_T_LOWER,
) = range(9)
"""The planes of `Rows.ends`."""


class Rows(NamedTuple):
    """
    Scratch arrays of one projection along an axis (a, b); w is n in whole lanes.

    The last row stands for the common image of a and b, the others for the projected points.
    """

    points: IntArray  # (n,): what each row is in the box that is projected
    ends: FloatArray  # (9, w): bounds of A, B, A - B and t (Eq. 7), and room for new ones of t
    squared: FloatArray  # (2, n, w): s_ij before the projection, in m^2
    along: FloatArray  # (2, n, w): bounds of t_i - t_j, in m
    across: FloatArray  # (4, n, w): the projected box, in m^2


def whole_lanes(count: int) -> int:
    """Return the width of a row of so many points, in whole lanes."""
    return (count + LANES - 1) // LANES * LANES


def make_rows(n_points: int) -> Rows:
    """Allocate the scratch arrays of a projection."""
    width = (n_points + LANES - 1) // LANES * LANES
    return Rows(
        np.zeros(n_points, dtype=np.int64),
        np.zeros((9, width)),
        np.zeros((2, n_points, width)),
        np.zeros((2, n_points, width)),
        np.zeros((4, n_points, width)),
    )


# Plain Python calls the functions above, which never wait for a compiler.
lanes_of = kernel(whole_lanes)
new_rows = kernel(make_rows)
