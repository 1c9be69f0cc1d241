# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The terms of a least-squares fit: what was likely measured, and how wrong it may be.

A term joins bodies, each of which has a position and a rotation. Its ends are arms in their body
frames: sensors away from the origin of a robot, or where its odometry says that it was before.
Residuals are in half widths, so that a reading at the end of its bounds counts 1.

A robot that moves is one body now and others before: steps and turns of its odometry join these.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RANGE, RAY, PLACE, STEP, TURN = 0, 1, 2, 3, 4

AT_ORIGIN = (0.0, 0.0, 0.0)

LEAST_HALF_WIDTH = 1e-6
"""A reading without error would outweigh all others beyond the digits of a number."""

MOST_BODIES = 30
"""
The cost of a fit grows with the cube of the number of bodies: fleets of more points get one start
only, and fleets of more robots no smoother. Others have twice as many past poses.
"""

UNIFORM = 3.0
"""The square of a half width over the variance of an error that is anywhere within it."""


class Term(NamedTuple):
    """
    A likeliest reading between two bodies.

    The value of a `RANGE` is the distance in its first number, that of a `RAY` a unit vector in
    the body frame of the first, that of a `PLACE` the position of the first. Arms are the ends in
    the body frames.
    """

    kind: int
    first: int
    second: int
    value: ArrayLike
    half_width: float
    first_arm_m: ArrayLike = AT_ORIGIN
    second_arm_m: ArrayLike = AT_ORIGIN


class Terms(NamedTuple):
    """
    Terms as the kernel reads them; several arms and values, stacked in front, are variants.

    Parameters
    ----------
    kinds : numpy.ndarray of int, shape (m,)
        A `STEP` says that its two ends are one point, a `TURN` where the second body has its x
        axis.
    bodies : numpy.ndarray of int, shape (m, 2)
    arms_m : numpy.ndarray, shape (m, 2, 3)
    values : numpy.ndarray, shape (m, 3)
        A step has none; a turn has the axis seen from the first body.
    weights : numpy.ndarray, shape (m,)
        One over the half widths.

    """

    kinds: IntArray
    bodies: IntArray
    arms_m: FloatArray
    values: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, terms: Sequence[Term]) -> Terms:
        """Pack terms."""
        columns = [list(column) for column in zip(*terms, strict=True)] or [[]] * len(Term._fields)
        kinds, first, second, values, widths, *arms = columns
        return cls(
            np.array(kinds, dtype=np.int64),
            np.array([first, second], dtype=np.int64).T.copy(),
            np.array(arms, dtype=float).reshape(2, -1, 3).transpose(1, 0, 2).copy(),
            np.array(values, dtype=float).reshape(-1, 3),
            1.0 / np.maximum(np.array(widths, dtype=float), LEAST_HALF_WIDTH),
        )

    @classmethod
    def joined(cls, parts: Sequence[Terms]) -> Terms:
        """Return the terms of all parts, which have equally many variants."""
        axes = (-1, -2, -3, -2, -1)
        columns = zip(*parts, strict=True)
        return cls(*(np.concatenate(c, axis) for c, axis in zip(columns, axes, strict=True)))

    def variant(self, number: int) -> Terms:
        """Return the terms with one of several arms and values."""
        return self._replace(arms_m=self.arms_m[number], values=self.values[number])

    def common_errors(self, residuals: FloatArray) -> FloatArray:
        """
        Return how much less the readings of one target in a while tell than independent ones.

        What they do not scatter, of the variance that their bounds allow, they may have in common.
        """
        keys = np.column_stack([self.kinds, self.bodies])
        _, groups, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        groups, residuals = groups.ravel(), np.clip(residuals, -1.0, 1.0)
        scatter = (residuals - (np.bincount(groups, residuals) / counts)[groups]) ** 2
        # One more reading that does not scatter stands for what is known before.
        repeats = 1.0 + np.bincount(self.kinds, 1.0 - 1.0 / counts[groups])
        common = np.maximum(0.0, 1.0 - UNIFORM * np.bincount(self.kinds, scatter) / repeats)
        return 1.0 + common[self.kinds] * (counts[groups] - 1.0)
