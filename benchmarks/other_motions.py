# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Motions of two robots that agree with ranges which are wrong.

Sequential linear programs look for a motion that the odometries of both and chosen ranges allow.
One that is found and checked is a proof; where none is found, there may be one.

Step i of a robot has a stated way r_i and a stated turn; the true turn is off by b_i in rad at
most, and the true way by a_i in m, where a_i and b_i are shares of both. Seen from the odometry
frame of A, which is not turned at the first range, B is at the time of range k at

    w_k = w_0 + sum R(f + E_i) r_i  -  sum R(E_i) r_i  +  d_1 + ... + d_k,

where the first sum is of the steps of B before k and the second of those of A, f turns the
odometry frame of B into that of A, and E_i is the sum of the errors of the turns before step i.
Errors of the ways between two ranges add up to any vector d of a ball, whose radius is the sum of
all a_i.
Turns between two ranges all err by the same share of their bounds, which leaves motions out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
import math

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog

from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.pairs.turns import turned

FloatArray = NDArray[np.float64]

SIDES = 16
"""Of the polygon in each ball."""

IN_BALL = 1.0 - 1e-5
"""Its corners are so far from the middle: programs are exact to 1e-7 m only."""

MARGIN_M = 1e-6
"""Ranges are obeyed by this much."""

WITHIN = 1.0 - 1e-9
"""Of the bounds of odometry: it is far more than what is rounded here."""

MOST_PROGRAMS = 25
ENDS_RAD, ENDS_M = 1e-4, 1e-9
"""The search ends when steps may be no longer, or gain no more."""


@dataclass(frozen=True)
class Way:
    """
    What odometry says of a robot while ranges are measured.

    Parameters
    ----------
    steps_m : numpy.ndarray, shape (n, 2)
        In the odometry frame.
    ball_m : numpy.ndarray, shape (g,)
        How far the ways between two ranges may be off.
    turns_rad : numpy.ndarray, shape (n, g)
        How much each turn may be off, in the column of the two ranges that it is between.

    """

    steps_m: FloatArray
    ball_m: FloatArray
    turns_rad: FloatArray

    @classmethod
    def of(
        cls, stated_m: FloatArray, stated_rad: FloatArray, share: float, at: NDArray[np.intp]
    ) -> Way:
        """
        Return the way of a robot.

        Parameters
        ----------
        stated_m : numpy.ndarray, shape (m, 3)
        stated_rad : numpy.ndarray, shape (m,)
        share : float
            Of ways and of turns, by which these are off at most.
        at : numpy.ndarray of int, shape (g + 1,)
            The samples with ranges.

        """
        number = np.arange(at[0], at[-1])
        between = np.searchsorted(at, number, side='right') - 1
        steps_m = np.diff(stated_m[at[0] : at[-1] + 1, :2], axis=0)
        turns_rad = np.zeros((len(number), len(at) - 1))
        off_rad = np.abs(np.diff(stated_rad[at[0] : at[-1] + 1])) * share * WITHIN
        turns_rad[number - at[0], between] = off_rad
        off_m = np.linalg.norm(steps_m, axis=-1) * share * WITHIN
        ball_m = np.array([off_m[between == g].sum() for g in range(len(at) - 1)])
        return cls(steps_m, ball_m, turns_rad)

    @cached_property
    def swings_rad(self) -> FloatArray:
        """How much the turns before each step may be off, shape (n, g)."""
        before = np.cumsum(self.turns_rad, axis=0)[:-1]
        return np.concatenate([np.zeros((1, self.turns_rad.shape[1])), before])

    def swings_within(self, shares: FloatArray) -> Interval:
        """Return how much the turns before each step are off, shape (n,), rounded outward."""
        total, found = Interval.point(0.0), []
        for turn in self.turns_rad:
            found.append(total)
            (column,) = np.flatnonzero(turn) if turn.any() else (0,)
            total = total + Interval.point(turn[column]) * Interval.point(shares[column])
        return Interval.stack(found)


class RangedPair:
    """
    The motions of two robots and the ranges between them.

    A motion is an array of w_0 (2), f, the shares of the turns of A (g) and of B (g), and d (2 g).

    Parameters
    ----------
    first, second : Way
    at : numpy.ndarray of int, shape (g + 1,)
        The samples with ranges.
    lower_m, upper_m : numpy.ndarray, shape (g + 1,)
        Bounds of the distances by these.

    """

    def __init__(
        self,
        first: Way,
        second: Way,
        at: NDArray[np.intp],
        lower_m: FloatArray,
        upper_m: FloatArray,
    ) -> None:
        self.first, self.second, self.at = first, second, at
        self._lower_m, self._upper_m = lower_m, upper_m
        self.ball_m = first.ball_m + second.ball_m
        self.inner_m = self.ball_m * (IN_BALL * math.cos(math.pi / SIDES))
        self.groups = len(self.ball_m)
        self.size = 3 + 4 * self.groups
        self._done = (np.arange(len(first.steps_m)) < (at - at[0])[:, None]).astype(float)
        angles = (np.arange(SIDES) + 0.5) * (2.0 * math.pi / SIDES)
        sides = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        rows = np.kron(np.eye(self.groups), sides)
        self._in_balls = np.hstack([np.zeros((len(rows), 3 + 2 * self.groups)), rows])
        self._sides_m = np.repeat(self.inner_m, SIDES)

    def parts(self, motion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the shares of the turns of A (g,), of B (g,), and d (g, 2)."""
        g = self.groups
        return motion[3 : 3 + g], motion[3 + g : 3 + 2 * g], motion[3 + 2 * g :].reshape(g, 2)

    def places_m(self, motion: FloatArray) -> FloatArray:
        """Return where B is from A at all ranges, shape (g + 1, 2)."""
        return self._walked(motion)[0]

    def _walked(self, motion: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return where B is from A at all ranges, and the steps of A and of B."""
        of_a, of_b, off_m = self.parts(motion)
        steps_a = _turned(self.first.swings_rad @ of_a, self.first.steps_m)
        steps_b = _turned(motion[2] + self.second.swings_rad @ of_b, self.second.steps_m)
        places_m = motion[:2] + self._done @ (steps_b - steps_a)
        places_m[1:] += np.cumsum(off_m, axis=0)
        return places_m, steps_a, steps_b

    def broken_by_m(self, motion: FloatArray) -> FloatArray:
        """Return by how much a motion breaks each range."""
        apart_m = np.linalg.norm(self.places_m(motion), axis=-1)
        return np.maximum(0.0, np.maximum(self._lower_m - apart_m, apart_m - self._upper_m))

    def agrees(self, motion: FloatArray, ranges: NDArray[np.bool_]) -> bool:
        """Return whether a motion is within the bounds of odometry and of some ranges: proved."""
        of_a, of_b, off_m = self.parts(motion)
        shares = np.concatenate([of_a, of_b])
        if np.any(np.abs(shares) > 1.0) or np.any(np.linalg.norm(off_m, axis=-1) > self.ball_m):
            return False
        steps = self._steps_within(self.second, of_b, motion[2])
        steps = steps - self._steps_within(self.first, of_a, 0.0)
        place = Interval.point(motion[:2])
        for number in range(len(self.at)):
            if number:
                for step in range(*(self.at[number - 1 : number + 1] - self.at[0])):
                    place = place + steps[step]
                place = place + Interval.point(off_m[number - 1])
            apart = squared_norm(place).sqrt()
            inside = self._lower_m[number] <= apart.lower and apart.upper <= self._upper_m[number]
            if ranges[number] and not inside:
                return False
        return True

    @staticmethod
    def _steps_within(way: Way, shares: FloatArray, turned_rad: float) -> Interval:
        """Return the steps of a robot, shape (n, 2), rounded outward."""
        steps = np.hstack([way.steps_m, np.zeros((len(way.steps_m), 1))])
        angles = way.swings_within(shares) + Interval.point(turned_rad)
        return turned(angles, Interval.point(steps))[:, :2]

    def _slopes(self, motion: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the distances (g + 1,) and their derivatives by the motion."""
        g = self.groups
        places_m, steps_a, steps_b = self._walked(motion)
        across_a, across_b = _quarter_turned(steps_a), _quarter_turned(steps_b)
        slopes = np.zeros((len(self.at), 2, self.size))
        slopes[:, 0, 0] = slopes[:, 1, 1] = 1.0
        slopes[:, :, 2] = self._done @ across_b
        since = np.tril(np.ones((len(self.at), g)), -1)
        for axis in range(2):
            swung_a = self._done @ (across_a[:, axis, None] * self.first.swings_rad)
            swung_b = self._done @ (across_b[:, axis, None] * self.second.swings_rad)
            slopes[:, axis, 3 : 3 + g], slopes[:, axis, 3 + g : 3 + 2 * g] = -swung_a, swung_b
            slopes[:, axis, 3 + 2 * g + axis :: 2] = since
        apart_m = np.linalg.norm(places_m, axis=-1)
        sight = places_m / np.maximum(apart_m, 1e-9)[:, None]
        return apart_m, np.einsum('mk,mkn->mn', sight, slopes)

    def find_motion(
        self, starts: Iterable[FloatArray], ranges: NDArray[np.bool_]
    ) -> FloatArray | None:
        """
        Look for a motion that agrees with some of the ranges.

        Parameters
        ----------
        starts : iterable of numpy.ndarray
            Motions within the bounds of odometry.
        ranges : numpy.ndarray of bool, shape (g + 1,)

        Returns
        -------
        numpy.ndarray or None
            A motion that agrees: proved.

        """
        for start in starts:
            motion = self._improved(start, np.flatnonzero(ranges))
            agree = not np.any(self.broken_by_m(motion)[ranges])
            if agree and self.agrees(motion, ranges):
                return motion
        return None

    def _improved(self, motion: FloatArray, rows: NDArray[np.intp]) -> FloatArray:
        """Return a motion that breaks some ranges by less in all, where there is one nearby."""
        step, broken_m = 1.0, float(self.broken_by_m(motion)[rows].sum())
        for _program in range(MOST_PROGRAMS):
            if broken_m == 0.0:
                break
            program = self._programmed(motion, rows, step)
            if program is None:
                break
            moved, expected_m = program
            new_m = float(self.broken_by_m(moved)[rows].sum())
            if new_m < broken_m - 0.05 * (broken_m - expected_m):
                step *= 2.0 if new_m < 0.3 * broken_m + 0.7 * expected_m else 1.0
                motion, broken_m = moved, new_m
            else:
                step *= 0.3
            if step < ENDS_RAD or broken_m - expected_m < ENDS_M:
                break
        return motion

    def _programmed(
        self, motion: FloatArray, rows: NDArray[np.intp], step: float
    ) -> tuple[FloatArray, float] | None:
        """Return the motion that breaks ranges least to first order, and by how much then."""
        g, m = self.groups, len(rows)
        apart_m, slopes = self._slopes(motion)
        slack = -np.eye(m)
        matrix = np.vstack(
            [
                np.hstack([slopes[rows], slack]),
                np.hstack([-slopes[rows], slack]),
                np.hstack([self._in_balls, np.zeros((len(self._in_balls), m))]),
            ]
        )
        right = np.concatenate(
            [
                (self._upper_m - apart_m)[rows] - MARGIN_M,
                (apart_m - self._lower_m)[rows] - MARGIN_M,
                self._sides_m - self._in_balls @ motion,
            ]
        )
        reach = np.concatenate([[step, step, 0.5 * step], np.full(2 * g, 2.0 * step)])
        free = np.concatenate([[np.inf] * 3, np.ones(2 * g)])
        near = np.maximum(-reach, -free - motion[: 3 + 2 * g])
        far = np.minimum(reach, free - motion[: 3 + 2 * g])
        bounds = np.concatenate(
            [
                np.stack([near, far], axis=-1),
                np.tile([-np.inf, np.inf], (2 * g, 1)),
                np.tile([0.0, np.inf], (m, 1)),
            ]
        )
        cost = np.concatenate([np.zeros(self.size), np.ones(m)])
        found = linprog(cost, matrix, right, bounds=bounds, method='highs')
        if found.x is None:
            return None
        moved = motion + found.x[: self.size]
        # The program itself is exact to 1e-7 only.
        moved[3 : 3 + 2 * g] = np.clip(moved[3 : 3 + 2 * g], -1.0, 1.0)
        return moved, float(found.fun)


def _turned(angles_rad: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return vectors (n, 2), each turned by its angle."""
    along = np.cos(angles_rad)[:, None] * vectors
    return np.asarray(along + np.sin(angles_rad)[:, None] * _quarter_turned(vectors))


def _quarter_turned(vectors: FloatArray) -> FloatArray:
    """Return vectors (n, 2) turned by a quarter turn."""
    return np.stack([-vectors[:, 1], vectors[:, 0]], axis=-1)
