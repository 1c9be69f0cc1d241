# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The terms of a least-squares fit: likeliest readings and their half widths.

A term joins two bodies, each with a position and a rotation. Its ends are lever arms in their body
frames: of sensors away from the origin of a robot, or of its earlier poses by odometry. Residuals
are in half widths, so that a reading at the end of its bounds has the residual 1.

A moving robot has one body now and others for earlier times, joined by odometry steps and turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RANGE, RAY, PLACE, STEP, TURN, DIFFERENCE = 0, 1, 2, 3, 4, 5
READINGS = (RANGE, RAY, DIFFERENCE)

AT_ORIGIN = (0.0, 0.0, 0.0)

LEAST_HALF_WIDTH = 1e-6
"""Least half width: an exact reading would outweigh all others beyond machine precision."""

MOST_BODIES = 30
"""
The cost of a fit grows with the cube of the number of bodies: fleets of more points get one start
only, and fleets of more robots no smoother. All robots together have at most twice as many past
poses.
"""

UNIFORM = 3.0
"""The square of a half width over the variance of an error distributed uniformly within it."""


class Term(NamedTuple):
    """
    A likeliest reading between two bodies.

    The value of a `RANGE` has the distance as its first number. The value of a `RAY` is a unit
    vector in the frame of the first body, that of a `PLACE` the position of the first body. The
    value of a `DIFFERENCE`, in the plane, is x and y of a fixed point, and how much farther the
    first body is away from the second, which is fixed, too. Arms are the ends in the body frames.
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
    Terms in the arrays of the kernel; variants stack several arms and values along a first axis.

    Parameters
    ----------
    kinds : numpy.ndarray of int, shape (m,)
        A `STEP` means that its two ends are one point, a `TURN` gives the x axis of the second
        body.
    bodies : numpy.ndarray of int, shape (m, 2)
    arms_m : numpy.ndarray, shape (m, 2, 3)
    values : numpy.ndarray, shape (m, 3)
        Unused for a step; for a turn the x axis of the second body in the frame of the first.
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
        """Return the terms of one variant."""
        # A kernel is compiled anew for arrays of another layout.
        arms_m, values = map(np.ascontiguousarray, (self.arms_m[number], self.values[number]))
        return self._replace(arms_m=arms_m, values=values)

    def common_errors(self, residuals: FloatArray) -> FloatArray:
        """
        Return the variance factor of each term for errors shared by readings of one target.

        Readings may share the part of the variance of their bounds that they do not scatter.
        """
        keys = np.column_stack([self.kinds, self.bodies])
        _, groups, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        groups, residuals = groups.ravel(), np.clip(residuals, -1.0, 1.0)
        scatter = (residuals - (np.bincount(groups, residuals) / counts)[groups]) ** 2
        # One more reading without scatter is the prior.
        repeats = 1.0 + np.bincount(self.kinds, 1.0 - 1.0 / counts[groups])
        common = np.maximum(0.0, 1.0 - UNIFORM * np.bincount(self.kinds, scatter) / repeats)
        return 1.0 + common[self.kinds] * (counts[groups] - 1.0)
