# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What came of the contraction of a box."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """
    What came of a box.

    Kernels that are called from Python return truth values or numbers instead: numba takes longer
    to hand over an enumeration than many of them take.
    """

    EMPTY = 0
    """It is proved to hold no placement."""

    CONTRACTED = 1
    """It was narrowed as far as it goes, perhaps not at all."""

    NOT_RIGID = 2
    """It was left as it is: the measured pairs do not fix the points."""

    UNFINISHED = 3
    """The clock or the caller stopped the contraction; the box is sound all the same."""
