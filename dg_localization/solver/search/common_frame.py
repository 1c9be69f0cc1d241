# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs for all pairs of a group of points in the plane, in one Procrustes frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, sub_box
from dg_localization.solver.contract.groups import Groups
from dg_localization.solver.contract.linearization import Linearization, new_linearization
from dg_localization.solver.contract.procrustes import (
    new_procrustes_frame,
    set_chords,
    set_frame,
    set_free_rows,
)
from dg_localization.solver.contract.programs import narrow_pairs, narrow_turns
from dg_localization.solver.contract.simplex import set_table
from dg_localization.solver.contract.turns import (
    complete,
    narrow_turns_by_differences,
    number_pairs,
    set_differences,
    shorten_chains,
)

MOST_ROUNDS = 8
"""Linear programs for the turns of the measured pairs are solved at most so often."""

LEAST_GAIN_OF_ROUND = 0.03
"""Only those are repeated whose turns have become narrower by this fraction."""

TOLERANCE = 0.03
"""Of those linear programs (`set_multipliers`)."""

WIDE_RAD = 0.35
"""Where the bounds of turns are wider in the median, arcs have tangents at their ends as well."""

MOST_INFLATED = 5.0
"""
Linear programs gain nothing where bounds of the turns make the measured intervals so many times
wider, in the median.
"""

MOST_POINTS = 40
"""Larger groups have no common frame: their linear programs would take seconds."""

MOST_POINTS_OF_ALL_CHAINS = 24
"""In larger groups chains lead through measured pairs only."""

EXCHANGES = 10
"""About how often a program writes its table, for how many are solved between looks."""


class CommonFrame:
    """
    The Procrustes frame of one group of points, and its linear programs.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box of the group in m^2; it is narrowed in place.
    positions : ndarray, shape (n, 2)
        A placement in or near the box, in m.
    edges : ndarray of int, shape (m, 2)
        The measured pairs.
    stopped : callable
        Whether to stop early; the box is sound all the same.

    """

    def __init__(
        self,
        box: FloatArray,
        positions: FloatArray,
        edges: IntArray,
        stopped: Callable[[], bool],
    ) -> None:
        self._box = box
        self._stopped = stopped
        self._linear = new_linearization(np.sort(edges, axis=1), *positions.shape)
        self._turned = new_procrustes_frame(len(positions))
        self._n_unknowns = 0
        if len(positions) <= MOST_POINTS:
            self._n_unknowns = set_frame(box, positions, self._linear, self._turned)

    @property
    def is_known(self) -> bool:
        """Whether there is a frame, so that there are bounds."""
        return 0 < self._n_unknowns <= len(self._linear.edges)

    @property
    def reference(self) -> FloatArray:
        """Reference placement, shape (n, 2), in m."""
        return self._linear.reference

    @property
    def turns(self) -> FloatArray:
        """Bounds of the turn of pair i < j at [i, :, j], shape (n, 2, n), in rad."""
        return self._turned.turns

    def narrow(self, pairs: IntArray, errors: FloatArray, explained: FloatArray) -> bool:
        """Narrow some pairs, i < j; see `narrow_pairs`. False when nothing is left."""
        if not self.is_known:
            return True
        if not self._by_triangles():
            return False
        if self._stopped() or self._inflation() > MOST_INFLATED:
            return True
        linear, n_chords = self._with_chords()
        table = np.empty((self._n_unknowns + 3, self._n_unknowns))
        active = np.full(self._n_unknowns, -1)
        state = (self._box, linear, self._turned, table, active)
        measured, size = self._linear.edges, self._n_unknowns * (self._n_unknowns + len(errors))
        some_gain = list(self._batches(len(measured), size))
        for _ in range(MOST_ROUNDS):
            if not self._set_table(linear, n_chords, table, active):
                return True
            gains = []
            for some in some_gain:
                if self._stopped():
                    return True
                first_row = some.start * n_chords
                gains.append(narrow_turns(*state, measured[some], TOLERANCE, first_row, n_chords))
                if gains[-1] < 0.0:
                    return False
            pairs_and_gains = zip(some_gain, gains, strict=True)
            some_gain = [some for some, gain in pairs_and_gains if gain > LEAST_GAIN_OF_ROUND]
        if not self._set_table(linear, n_chords, table, active):
            return True
        errors = np.repeat(errors, n_chords)
        for some in self._batches(len(pairs), size):
            if not narrow_pairs(*state, pairs[some], errors, explained[some]):
                return False
        return True

    def _set_table(
        self, linear: Linearization, n_chords: int, table: FloatArray, active: IntArray
    ) -> bool:
        """Write the chords and the table of the programs; False where there is none."""
        set_chords(self._box, linear, self._turned, n_chords)
        set_free_rows(linear, self._turned, table)
        return bool(set_table(linear, table, active))

    def _with_chords(self) -> tuple[Linearization, int]:
        """Return the measured pairs, each with as many rows as its arcs need, and how many."""
        linear = self._linear
        i, j = linear.edges.T
        widths_rad = self._turned.turns[i, UPPER, j] - self._turned.turns[i, LOWER, j]
        n_chords = 1 if np.median(widths_rad) < WIDE_RAD else 3
        edges = np.repeat(linear.edges, n_chords, axis=0)
        gradients, residuals = np.empty((len(edges), 2)), np.empty((len(edges), 2))
        chords = linear._replace(edges=edges, gradients=gradients, residuals=residuals)
        return chords, n_chords

    def _by_triangles(self) -> bool:
        """Narrow the turns by the angles of triangles."""
        box, reference = self._box, self._linear.reference
        n_points = len(reference)
        number = np.zeros((n_points, n_points), dtype=np.int64)
        pairs = np.empty((n_points * (n_points - 1) // 2, 2), dtype=np.int64)
        number_pairs(n_points, number, pairs)
        above = np.empty((len(pairs), len(pairs)))
        set_differences(box, reference, number, above)
        below = np.ascontiguousarray(above.T)
        measured = number[tuple(self._linear.edges.T)]
        hubs = measured if n_points > MOST_POINTS_OF_ALL_CHAINS else np.arange(len(pairs))
        for some in self._batches(len(hubs), above.size):
            shorten_chains(above, below, hubs[some])
        complete(above, below, len(hubs))
        for some in self._batches(len(measured), len(pairs)):
            chosen = measured[some]
            if not narrow_turns_by_differences(
                box, reference, pairs, above, below, chosen, self._turned.turns
            ):
                return False
        set_chords(box, self._linear, self._turned, 1)
        return True

    def _inflation(self) -> float:
        """Return how many times wider the residuals are than the measured intervals."""
        (i, j), residuals = self._linear.edges.T, self._linear.residuals
        widths = self._box[UPPER, i, j] - self._box[LOWER, i, j]
        inflated = residuals[:, UPPER] - residuals[:, LOWER]
        open_edges = widths > 0.0
        if not open_edges.any():
            return 1.0
        return float(np.median(inflated[open_edges] / widths[open_edges]))

    def _batches(self, count: int, table_size: int) -> Iterator[slice]:
        """Yield what to do between looks at the clock, until it says stop."""
        size = max(1, WORK_PER_LOOK // (EXCHANGES * table_size))
        for first in range(0, count, size):
            if self._stopped():
                return
            yield slice(first, first + size)


def narrow_in_common_frame(
    groups: Groups,
    box: FloatArray,
    positions: FloatArray,
    pairs: IntArray,
    explained: FloatArray,
    stopped: Callable[[], bool],
) -> bool:
    """
    Narrow unknown pairs of a box in place, each group of connected points in its own frame.

    Parameters
    ----------
    groups : Groups
        The connected points and their measured pairs.
    box : ndarray, shape (4, n, n)
        The box in m^2; the upper bounds within a group are finite.
    positions : ndarray, shape (n, 2)
        A placement in or near the box, in m.
    pairs : ndarray of int, shape (k, 2)
        The pairs, i < j.
    explained : ndarray, shape (k,)
        Where the width that the errors explain to first order is written, in m^2; left as it is
        where there is no linear program.
    stopped : callable
        Whether to stop early; the box is sound all the same.

    Returns
    -------
    bool
        False when the box is proved to hold no placement.

    """
    for group in range(len(groups.offsets) - 1):
        points = groups.members[groups.offsets[group] : groups.offsets[group + 1]]
        chosen = np.flatnonzero(np.isin(pairs, points).all(axis=1))
        if not len(chosen):
            continue
        inside = slice(groups.edge_offsets[group], groups.edge_offsets[group + 1])
        local, local_pairs = sub_box(box, points), np.searchsorted(points, pairs[chosen])
        local_explained = explained[chosen]
        frame = CommonFrame(local, positions[points], groups.edges[inside], stopped)
        if not frame.narrow(local_pairs, groups.errors[inside], local_explained):
            return False
        explained[chosen] = local_explained
        (i, j), (x, y) = pairs[chosen].T, local_pairs.T
        box[:, i, j] = box[:, j, i] = local[:, x, y]
    return True
