# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
What readings tell of their errors where the truth is not known.

Readings of one pair within a short time differ by their errors alone, once the motion is taken
out: that shows how they scatter. Readings of the two directions of a pair show the difference of
their errors, and the sides of a triangle show where bounds cannot be right. What all readings of a
pair have in common, a bias, no recording without truth shows.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dg_localization.calibration.angles import without_turns

FloatArray = NDArray[np.float64]

WINDOW_S = 1.0
LEAST_NEIGHBORS = 2
"""On each side of a reading."""
TOGETHER_S = 0.1
"""Readings of three sides that are no farther apart are taken together."""


def residuals(stamps_s: ArrayLike, values: ArrayLike, angles: bool = False) -> FloatArray:
    """
    Return how far each reading is from what its neighbors in time let expect.

    Parameters
    ----------
    stamps_s : array_like, shape (n,)
        Increasing.
    values : array_like, shape (n,)
        Ranges in m, or angles in rad.
    angles : bool, optional
        Whether they are angles, which differ by less than half a turn.

    Returns
    -------
    ndarray, shape (n,)
        The reading minus the median of as many neighbors on either side, within half a second,
        without itself: a steady motion cancels. NaN where there are fewer than two on a side.

    """
    stamps, readings = np.asarray(stamps_s, dtype=float), np.asarray(values, dtype=float)
    first = np.searchsorted(stamps, stamps - WINDOW_S / 2.0, side='left')
    last = np.searchsorted(stamps, stamps + WINDOW_S / 2.0, side='right') - 1
    found = np.full(len(stamps), np.nan)
    for i in range(len(stamps)):
        reach = min(i - first[i], last[i] - i)
        if reach >= LEAST_NEIGHBORS:
            around = np.concatenate([readings[i - reach : i], readings[i + 1 : i + reach + 1]])
            ahead = around - readings[i]
            found[i] = -np.median(without_turns(ahead) if angles else ahead)
    return found


def direction_differences(
    stamps_s: ArrayLike, values_m: ArrayLike, back_stamps_s: ArrayLike, back_values_m: ArrayLike
) -> FloatArray:
    """
    Return the readings of a pair minus those of the other direction at the same time.

    Parameters
    ----------
    stamps_s, values_m : array_like, shape (n,)
        Increasing stamps, and ranges from A to B.
    back_stamps_s, back_values_m : array_like, shape (k,)
        From B to A.

    Returns
    -------
    ndarray, shape (m,)
        One for each reading with two of the other direction around it, within half a second.

    """
    stamps, values = np.asarray(stamps_s, dtype=float), np.asarray(values_m, dtype=float)
    back_s, back_m = np.asarray(back_stamps_s, dtype=float), np.asarray(back_values_m, dtype=float)
    after = np.searchsorted(back_s, stamps)
    inside = (after > 0) & (after < len(back_s))
    stamps, values, after = stamps[inside], values[inside], after[inside]
    gaps_s = back_s[after] - back_s[after - 1]
    near = (gaps_s > 0.0) & (gaps_s <= WINDOW_S / 2.0)
    stamps, values, after, gaps_s = stamps[near], values[near], after[near], gaps_s[near]
    share = (stamps - back_s[after - 1]) / gaps_s
    return values - ((1.0 - share) * back_m[after - 1] + share * back_m[after])


def triangle_contradictions(
    stamps_s: Sequence[ArrayLike],
    lower_m: Sequence[ArrayLike],
    upper_m: Sequence[ArrayLike],
    speed_m_s: float,
    between_stamps_s: float = 0.0,
) -> tuple[int, int]:
    """
    Count the moments at which three points cannot be as far apart as their bounds say.

    Parameters
    ----------
    stamps_s, lower_m, upper_m : sequence of three array_like, shapes (n1,), (n2,), (n3,)
        For each side of the triangle, increasing stamps and the bounds of its readings.
    speed_m_s : float
        No distance changes faster.
    between_stamps_s : float, optional
        How much longer or shorter than between two stamps the time between them may be.

    Returns
    -------
    tuple of int
        How many moments, and how many there were to look at: the readings of the first side with
        one of each of the others within 0.1 s.

    """
    times = np.asarray(stamps_s[0], dtype=float)
    low, high = [np.asarray(lower_m[0])], [np.asarray(upper_m[0])]
    near = np.ones(len(times), bool)
    for side in (1, 2):
        stamps = np.asarray(stamps_s[side], dtype=float)
        after = np.clip(np.searchsorted(stamps, times), 1, max(1, len(stamps) - 1))
        before = after - 1
        after = np.minimum(after, len(stamps) - 1)
        closer = np.abs(stamps[after] - times) < np.abs(stamps[before] - times)
        nearest = np.where(closer, after, before)
        age_s = np.abs(stamps[nearest] - times)
        near &= age_s <= TOGETHER_S
        moved_m = speed_m_s * (age_s + between_stamps_s)
        low.append(np.asarray(lower_m[side])[nearest] - moved_m)
        high.append(np.asarray(upper_m[side])[nearest] + moved_m)
    lower, upper = np.array(low), np.array(high)
    broken = np.any(lower > upper.sum(axis=0) - upper, axis=0)
    return int(np.count_nonzero(broken & near)), int(np.count_nonzero(near))
