# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Linear programs for all pairs of a group of points in the plane, in one Procrustes frame."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from dg_localization.solver.box import LOWER, UPPER, FloatArray, IntArray, sub_box
from dg_localization.solver.contract.groups import Groups
from dg_localization.solver.contract.linearization import new_linearization
from dg_localization.solver.contract.procrustes import (
    new_procrustes_frame,
    set_chords,
    set_frame,
)
from dg_localization.solver.contract.turns import (
    complete,
    narrow_turns_by_differences,
    number_pairs,
    set_differences,
    shorten_chains,
)
from dg_localization.solver.search.frame_parts import FramePart, batches

MOST_ROUNDS = 8
"""Linear programs for the turns of the measured pairs are solved at most so often."""

MOST_EXCESS = {1: 1.25, 3: 1.45}
"""
A pair is open when it is so many times wider than the errors explain, by how many chords there are
of each arc: where turns are wide, more is left by all pairs.
"""

MOST_CUTS, MOST_ROUNDS_OF_PART, MOST_OPEN = 2, 2, 20
"""
While a pair is open, the box is cut into one part more. Parts have fewer rounds, and bound no more
than the widest open pairs, so that all cuts together take about as long as the box did at most.
"""

MOST_INFLATED = 5.0
"""
Linear programs gain nothing where bounds of the turns make the measured intervals so many times
wider, in the median.
"""

MOST_POINTS = 40
"""Larger groups have no common frame: their linear programs would take seconds."""

MOST_POINTS_OF_ALL_CHAINS = 24
"""In larger groups chains lead through measured pairs only."""


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
        whole = FramePart(self._box, self._linear, self._turned, errors, self._n_unknowns)
        most_excess = MOST_EXCESS[whole.n_chords]
        if not whole.narrow(pairs, explained, most_excess, MOST_ROUNDS, self._stopped):
            return False
        return self._narrow_parts(whole, pairs, explained, most_excess)

    def _narrow_parts(
        self, whole: FramePart, pairs: IntArray, explained: FloatArray, most_excess: float
    ) -> bool:
        """Cut the box where that narrows pairs; narrow those that are open to what parts leave."""
        parts, (i, j) = [whole], pairs.T
        for _ in range(MOST_CUTS):
            low = np.min([part.box[LOWER, i, j] for part in parts], axis=0)
            high = np.max([part.box[UPPER, i, j] for part in parts], axis=0)
            excess = np.zeros(len(pairs))
            np.divide(high - low, explained, out=excess, where=explained > 0.0)
            widest = np.argsort(-excess, kind='stable')[:MOST_OPEN]
            chosen = widest[excess[widest] > most_excess]
            softest = max(parts, key=lambda part: part.total_loss)
            if self._stopped() or not len(chosen) or softest.total_loss == 0.0:
                break
            parts.remove(softest)
            limits = most_excess, MOST_ROUNDS_OF_PART, self._stopped
            # They get a copy of what is explained: that of the whole is what they are judged by.
            for half in softest.halves():
                if half.narrow(pairs[chosen], explained[chosen], *limits):
                    parts.append(half)
            if not parts:
                return False
        self._box[LOWER, i, j] = np.min([part.box[LOWER, i, j] for part in parts], axis=0)
        self._box[UPPER, i, j] = np.max([part.box[UPPER, i, j] for part in parts], axis=0)
        self._box[:, j, i] = self._box[:, i, j]
        return True

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
        for some in batches(len(hubs), above.size, self._stopped):
            shorten_chains(above, below, hubs[some])
        complete(above, below, len(hubs))
        for some in batches(len(measured), len(pairs), self._stopped):
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
        What the errors explain of the width of each pair by least squares, in m^2. What they
        explain by linear programs is written; left as it is where there is none.
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
