# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs for all pairs of a group of points in the plane, in one Procrustes frame."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK
from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, sub_box
from dg_localization.solver.contract.groups import Groups
from dg_localization.solver.contract.linearization import new_linearization
from dg_localization.solver.contract.newton import LEAST_NEWTON_GAIN
from dg_localization.solver.contract.procrustes import (
    BOUNDED,
    EMPTY,
    bound_displacements,
    new_procrustes_frame,
    newton_step,
)
from dg_localization.solver.contract.programs import narrow_across, narrow_pairs
from dg_localization.solver.contract.simplex import set_table

MOST_STEPS = 10
"""Interval Newton steps in the Procrustes frame."""

MOST_INFLATED = 5.0
"""
Linear programs gain nothing where the squares of displacements make the measured intervals so many
times wider, in the median.
"""

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
        self._linear = new_linearization(edges, *positions.shape)
        self._turned = new_procrustes_frame(len(positions))
        self.status = bound_displacements(box, positions, self._linear, self._turned)
        self._steps()

    def _steps(self) -> None:
        """Narrow the displacements by Newton steps and by linear programs."""
        for _ in range(MOST_STEPS):
            if self.status != BOUNDED or self._stopped():
                return
            gain = newton_step(self._box, self._linear, self._turned)
            if gain < 0.0:
                self.status = EMPTY
            if gain < LEAST_NEWTON_GAIN:
                break

    def narrow(self, pairs: IntArray, errors: FloatArray, explained: FloatArray) -> bool:
        """Narrow some pairs, i < j; see `narrow_pairs`. False when nothing is left."""
        if self.status != BOUNDED or self._stopped():
            return self.status != EMPTY
        linear = self._linear
        if self._inflation() > MOST_INFLATED:
            return True
        n_unknowns = int(linear.unknowns.max()) + 1
        table = np.empty((len(linear.edges) + n_unknowns + 2, n_unknowns))
        active = np.full(n_unknowns, -1)
        if not set_table(linear, table, active):
            return True
        state = (self._box, linear, self._turned, table, active)
        measured = np.sort(linear.edges, axis=1)
        for some in self._batches(len(measured), table.size):
            if not narrow_across(*state, measured[some]):
                return False
        for some in self._batches(len(pairs), table.size):
            if not narrow_pairs(*state, pairs[some], errors, explained[some]):
                return False
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
