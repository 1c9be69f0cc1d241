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
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

RANGE, RAY, PLACE, STEP, TURN = 0, 1, 2, 3, 4

AT_ORIGIN = (0.0, 0.0, 0.0)

LEAST_HALF_WIDTH = 1e-6
"""A reading without error would outweigh all others beyond the digits of a number."""


@dataclass(frozen=True, eq=False)
class RangeTerm:
    """
    The distance between two bodies.

    Parameters
    ----------
    first, second : int
        Rows of the bodies.
    distance_m : float
        The likeliest one.
    half_width_m : float
    first_arm_m, second_arm_m : array_like, shape (3,)
        The ends, in the body frames.

    """

    first: int
    second: int
    distance_m: float
    half_width_m: float
    first_arm_m: Sequence[float] | FloatArray = AT_ORIGIN
    second_arm_m: Sequence[float] | FloatArray = AT_ORIGIN


@dataclass(frozen=True, eq=False)
class RayTerm:
    """
    The direction from a body to another.

    Parameters
    ----------
    observer, target : int
        Rows of the bodies.
    direction : numpy.ndarray, shape (3,)
        The likeliest one: a unit vector in the body frame of the observer.
    half_width_rad : float
    observer_arm_m, target_arm_m : array_like, shape (3,)
        The ends, in the body frames.

    """

    observer: int
    target: int
    direction: FloatArray
    half_width_rad: float
    observer_arm_m: Sequence[float] | FloatArray = AT_ORIGIN
    target_arm_m: Sequence[float] | FloatArray = AT_ORIGIN


@dataclass(frozen=True, eq=False)
class PlaceTerm:
    """
    The position of a body.

    Parameters
    ----------
    body : int
        Row of the body.
    position_m : numpy.ndarray, shape (3,)
        The likeliest one.
    half_width_m : float

    """

    body: int
    position_m: FloatArray
    half_width_m: float


Term: TypeAlias = RangeTerm | RayTerm | PlaceTerm


@dataclass(frozen=True, eq=False)
class PackedTerms:
    """
    Terms as the kernel reads them.

    Parameters
    ----------
    kinds : numpy.ndarray of int, shape (m,)
        A `STEP` says that its two ends are one point, a `TURN` where the second body has its x
        axis.
    bodies : numpy.ndarray of int, shape (m, 2)
    arms_m : numpy.ndarray, shape (m, 2, 3)
    values : numpy.ndarray, shape (m, 3)
        A distance has one number only, a step none; a turn has the axis seen from the first body.
    weights : numpy.ndarray, shape (m,)
        One over the half widths.

    """

    kinds: IntArray
    bodies: IntArray
    arms_m: FloatArray
    values: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, terms: Sequence[Term]) -> PackedTerms:
        """Pack terms."""
        count = len(terms)
        packed = cls(
            np.empty(count, dtype=np.int64),
            np.zeros((count, 2), dtype=np.int64),
            np.zeros((count, 2, 3)),
            np.zeros((count, 3)),
            np.empty(count),
        )
        for row, term in enumerate(terms):
            packed._put(row, term)
        return packed

    @classmethod
    def joined(cls, parts: Sequence[PackedTerms]) -> PackedTerms:
        """Return the terms of all parts."""
        return cls(
            np.concatenate([part.kinds for part in parts]),
            np.concatenate([part.bodies for part in parts]),
            np.concatenate([part.arms_m for part in parts]),
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )

    def chosen(self, rows: IntArray) -> PackedTerms:
        """Return some of the terms."""
        return PackedTerms(
            self.kinds[rows],
            self.bodies[rows],
            self.arms_m[rows],
            self.values[rows],
            self.weights[rows],
        )

    def counted_once(self) -> PackedTerms:
        """Return the terms so that those of one kind and of the same bodies weigh as one."""
        keys = np.column_stack([self.kinds, self.bodies])
        _, groups, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
        return replace(self, weights=self.weights / np.sqrt(counts[groups.ravel()]))

    def _put(self, row: int, term: Term) -> None:
        """Write a term."""
        if isinstance(term, PlaceTerm):
            self.kinds[row], self.bodies[row] = PLACE, term.body
            self.values[row], half_width = term.position_m, term.half_width_m
        elif isinstance(term, RayTerm):
            self.kinds[row], self.bodies[row] = RAY, (term.observer, term.target)
            self.arms_m[row] = term.observer_arm_m, term.target_arm_m
            self.values[row], half_width = term.direction, term.half_width_rad
        else:
            self.kinds[row], self.bodies[row] = RANGE, (term.first, term.second)
            self.arms_m[row] = term.first_arm_m, term.second_arm_m
            self.values[row, 0], half_width = term.distance_m, term.half_width_m
        self.weights[row] = 1.0 / max(half_width, LEAST_HALF_WIDTH)
