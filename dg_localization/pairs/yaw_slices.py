# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Slices of yaws: equal parts of a turn, which reach beyond their ends by what a yaw errs."""

from __future__ import annotations

from dataclasses import dataclass, replace
import math
from typing import Self

import numpy as np

from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import down, up
from dg_localization.pairs.turns import HALF_TURN_UP, TURN

FEWEST_PER_TURN, MOST_PER_TURN = 32, 2**13
"""Powers of two. Slices thinner than a milliradian tell no more."""


@dataclass(frozen=True)
class YawSlices:
    """
    Some of the equal parts of a turn.

    Parameters
    ----------
    numbers : numpy.ndarray of int, shape (n,)
        Ascending; slice k begins k parts after `start_rad`.
    per_turn : int
        How many parts a turn has, a power of two.
    start_rad : float
    beyond_rad : float, optional
        How far each slice reaches beyond both of its ends.

    """

    numbers: np.ndarray
    per_turn: int
    start_rad: float
    beyond_rad: float = 0.0

    @classmethod
    def of_arc(cls, first_rad: float, last_rad: float, most: int) -> Self:
        """Return the thinnest slices of an arc that are no more than `most`."""
        arc = min((last_rad - first_rad) / TURN, 1.0)
        per_turn = FEWEST_PER_TURN
        while per_turn < MOST_PER_TURN and 2 * per_turn * arc + 1.0 <= most:
            per_turn *= 2
        count = min(math.floor(per_turn * arc) + 1, per_turn)
        return cls(np.arange(count), per_turn, first_rad, angle_up(0.0))

    def __len__(self) -> int:
        return len(self.numbers)

    def __getitem__(self, index: np.ndarray | slice) -> Self:
        return replace(self, numbers=self.numbers[index])

    @property
    def width_rad(self) -> float:
        """Width of a slice, without what it reaches beyond its ends."""
        return TURN / self.per_turn

    @property
    def yaws(self) -> np.ndarray:
        """Middle and half-width of each slice in rad, shape (n, 2)."""
        middles = self.start_rad + (self.numbers + 0.5) * self.width_rad
        half = float(angle_up(up(0.5 * self.width_rad + self.beyond_rad)))
        return np.stack([middles, np.full(len(self), half)], axis=-1)

    def turned(self, turn_rad: float, half_rad: float) -> Self:
        """Return the slices of what has turned by a turn or two at most, which errs by so much."""
        beyond_rad = float(angle_up(up(self.beyond_rad + half_rad)))
        return replace(
            self,
            start_rad=math.remainder(self.start_rad + turn_rad, TURN),
            # A slice that reaches so far has all yaws.
            beyond_rad=min(beyond_rad, HALF_TURN_UP),
        )

    def spread(self) -> tuple[Self, np.ndarray, np.ndarray]:
        """
        Return slices that do not reach beyond their ends by their width.

        Returns
        -------
        slices : YawSlices
        sources, targets : numpy.ndarray of int, shape (m,)
            What was in slice `sources` of these may be in slice `targets` of those.

        """
        by = min(int(self.beyond_rad // self.width_rad), self.per_turn)
        reached = self.numbers[:, None] + np.arange(-by, by + 1)
        left = float(up(self.beyond_rad - down(by * self.width_rad)))
        slices = replace(self, beyond_rad=max(left, 0.0))
        return slices._renumbered(reached)

    def wider(self) -> tuple[Self, np.ndarray, np.ndarray]:
        """Return slices twice as wide, and as `spread` does what they are made of."""
        slices = replace(self, per_turn=self.per_turn // 2)
        return slices._renumbered(self.numbers[:, None] // 2)

    def thinner(self) -> tuple[Self, np.ndarray, np.ndarray]:
        """Return slices half as wide, and as `spread` does what they are made of."""
        slices = replace(self, per_turn=self.per_turn * 2)
        return slices._renumbered(2 * self.numbers[:, None] + np.arange(2))

    def _renumbered(self, reached: np.ndarray) -> tuple[Self, np.ndarray, np.ndarray]:
        """Return the slices that slices reach (n, m), each once, and what they are made of."""
        if len(reached) == 0:
            return self, np.empty(0, np.int64), np.empty(0, np.int64)
        first = reached.min()
        numbers, targets = np.unique((reached - first) % self.per_turn, return_inverse=True)
        sources = np.repeat(np.arange(len(reached)), reached.shape[1])
        # Angles that are whole turns apart are the same but for rounding.
        beyond_rad = float(angle_up(self.beyond_rad))
        slices = replace(self, numbers=numbers + first % self.per_turn, beyond_rad=beyond_rad)
        return slices, sources, targets.reshape(-1)
