# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Linear programs in the Procrustes frame, in a box or in a part of it where turns are cut in two.

A chord differs from its arc by the square of how far its pair may turn. Where a box is soft, pairs
turn far and together: half of the turn of one of them is a part of the box in which all turns are
narrower. The pair to cut is the one that turns far and whose chords add most to the pairs that are
still wide.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray
from dg_localization.solver.contract.linearization import Linearization
from dg_localization.solver.contract.procrustes import (
    ProcrustesFrame,
    set_chords,
    set_crossing,
    set_free_rows,
)
from dg_localization.solver.contract.programs import narrow_pairs, narrow_turns
from dg_localization.solver.contract.simplex import set_table

LEAST_GAIN_OF_ROUND = 0.03
"""Linear programs for turns are repeated where these have become narrower by this fraction."""

TOLERANCE = 0.03
"""Of those linear programs (`set_multipliers`)."""

WIDE_RAD = 0.35
"""Where the bounds of turns are wider in the median, arcs have tangents at their ends as well."""

EXCHANGES = 10
"""About how often a program writes its table, for how many are solved between looks."""

Cut = tuple[int, int, float]
"""The pair whose turn is cut, and where, in rad."""


def batches(count: int, table_size: int, stopped: Callable[[], bool]) -> Iterator[slice]:
    """Yield what to do between looks at the clock, until it says stop."""
    size = max(1, WORK_PER_LOOK // (EXCHANGES * table_size))
    for first in range(0, count, size):
        if stopped():
            return
        yield slice(first, first + size)


class FramePart:
    """
    A box, or a part of it, and its linear programs in the Procrustes frame.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; it is narrowed in place.
    linear : Linearization
        The measured pairs in the frame.
    turned : ProcrustesFrame
        The frame, with bounds of the turns in this part, which are narrowed in place.
    errors : ndarray, shape (m,)
        Width of the measured intervals in m^2.
    n_unknowns : int
        The number of free displacements.
    cuts : tuple of Cut, optional
        The turns that were cut to come to this part.

    """

    def __init__(
        self,
        box: FloatArray,
        linear: Linearization,
        turned: ProcrustesFrame,
        errors: FloatArray,
        n_unknowns: int,
        cuts: tuple[Cut, ...] = (),
    ) -> None:
        self.box = box
        self._plain = linear
        self._turned = turned
        self._errors = errors
        self._n_unknowns = n_unknowns
        self._cuts = cuts
        self.n_chords = 1 if np.median(self._widths_rad()) < WIDE_RAD else 3
        self._losses = np.zeros(len(linear.edges))

    @property
    def total_loss(self) -> float:
        """What chords add to the widths of open pairs, relatively, summed."""
        return float(self._losses.sum())

    def narrow(
        self,
        pairs: IntArray,
        explained: FloatArray,
        most_excess: float,
        most_rounds: int,
        stopped: Callable[[], bool],
    ) -> bool:
        """Narrow the turns of the measured pairs, then some pairs; see `narrow_pairs`."""
        n_rows = len(self._plain.edges) * self.n_chords
        linear, chords = self._with_rows(n_rows)
        table = np.empty((self._n_unknowns + 3, self._n_unknowns))
        active = np.full(self._n_unknowns, -1)
        state = (self.box, linear, self._turned, table, active)
        measured, size = self._plain.edges, self._n_unknowns * (self._n_unknowns + n_rows)
        some_gain = list(batches(len(measured), size, stopped))
        for _ in range(most_rounds):
            if not some_gain:
                break
            if not self._set_table(linear, chords, table, active):
                return True
            gains = []
            for some in some_gain:
                if stopped():
                    return True
                first_row = some.start * self.n_chords
                turns = (*state, measured[some], TOLERANCE, first_row, self.n_chords)
                gains.append(narrow_turns(*turns))
                if gains[-1] < 0.0:
                    return False
            pairs_and_gains = zip(some_gain, gains, strict=True)
            some_gain = [some for some, gain in pairs_and_gains if gain > LEAST_GAIN_OF_ROUND]
        if not self._set_table(linear, chords, table, active):
            return True
        errors, losses = np.zeros(len(linear.edges)), np.zeros(len(linear.edges))
        errors[:n_rows] = np.repeat(self._errors, self.n_chords)
        for some in batches(len(pairs), size, stopped):
            if not narrow_pairs(*state, pairs[some], errors, explained[some], most_excess, losses):
                return False
        self._losses = losses[:n_rows].reshape(-1, self.n_chords).sum(axis=1)
        return True

    def halves(self) -> list[FramePart]:
        """Return the two parts with half of the turn of the pair that is best to cut."""
        i, j = self._plain.edges.T
        across_m = self._widths_rad() * np.sqrt(self.box[UPPER, i, j])
        best = int(np.argmax(self._losses * across_m))
        p, q = int(i[best]), int(j[best])
        middle = 0.5 * float(self._turned.turns[p, LOWER, q] + self._turned.turns[p, UPPER, q])
        parts = []
        for end in (LOWER, UPPER):
            turns = self._turned.turns.copy()
            turns[p, end, q] = middle
            turned = self._turned._replace(turns=turns)
            cuts = (*self._cuts, (p, q, middle))
            args = (self.box.copy(), self._plain, turned, self._errors, self._n_unknowns)
            parts.append(FramePart(*args, cuts))
        return parts

    def _widths_rad(self) -> FloatArray:
        """Return how far the measured pairs may turn."""
        i, j = self._plain.edges.T
        widths_rad: FloatArray = self._turned.turns[i, UPPER, j] - self._turned.turns[i, LOWER, j]
        return widths_rad

    def _with_rows(self, n_rows: int) -> tuple[Linearization, Linearization]:
        """Return the chords of the measured pairs with the cuts below, and without them."""
        edges = np.repeat(self._plain.edges, self.n_chords, axis=0)
        cut_edges = np.array([cut[:2] for cut in self._cuts], dtype=np.int64).reshape(-1, 2)
        edges = np.concatenate([edges, cut_edges])
        linear = self._plain._replace(
            edges=edges,
            gradients=np.empty((len(edges), 2)),
            displacements=np.empty_like(self._plain.displacements),
            residuals=np.empty((len(edges), 2)),
        )
        chords = linear._replace(
            edges=linear.edges[:n_rows],
            gradients=linear.gradients[:n_rows],
            residuals=linear.residuals[:n_rows],
        )
        return linear, chords

    def _set_table(
        self, linear: Linearization, chords: Linearization, table: FloatArray, active: IntArray
    ) -> bool:
        """Write the rows and the table of the programs; False where there is none."""
        set_chords(self.box, chords, self._turned, self.n_chords)
        for number, (_, _, middle) in enumerate(self._cuts):
            set_crossing(self.box, linear, self._turned, len(chords.edges) + number, middle)
        set_free_rows(linear, self._turned, table)
        return bool(set_table(linear, table, active))
