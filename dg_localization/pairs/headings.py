# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Shape first, then headings: what old readings tell of the headings of bodies at known places.

A hypothesis of the moment gives the places of all bodies in a frame of its own, a shape, and
nothing of their headings. The readings of a window, carried to now in body frames, tell which
headings of two bodies go together: a table of cells for every pair. A heading must have a partner
in each table of its body (arc consistency; Mackworth, Consistency in networks of relations,
Artificial Intelligence 8, 1977). Where a body has none left the hypothesis is impossible, as a
mirror image mostly is: odometry knows left from right. With headings the readings bound the places
in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.interval.angles import angle_up
from dg_localization.interval.arrays import Interval, down, up
from dg_localization.interval.environment import default_environment
from dg_localization.pairs.cover import arc_around
from dg_localization.pairs.heading_kernels import try_cells
from dg_localization.pairs.readings import PairReadings
from dg_localization.pairs.turns import TURN

COARSEST, ALL_TRIED = 16, 32
"""Cells of the full turn in the first round, and the most of which all pairs are tried."""

BATCH = 8
"""
Cells of a body tried between two looks at the clock, in about 1 ms: where other threads wait for
the interpreter, each return to it may cost more than a cell.
"""

Pair = tuple[int, int]


@dataclass(frozen=True)
class HeadingOptions:
    """
    How finely headings are resolved, and what they tolerate.

    Parameters
    ----------
    cells : int
        Cells of the full turn: 16 or that times a power of two.
    max_outliers : int
        So many observations of each pair may be wrong.
    max_rounds : int
        How often places and headings narrow each other at the finest cells.
    most_readings : int, optional
        Of each pair, spread in time; all where None.

    """

    cells: int = 128
    max_outliers: int = 0
    max_rounds: int = 3
    most_readings: int | None = None

    def __post_init__(self) -> None:
        ratio = self.cells // COARSEST
        if self.cells != ratio * COARSEST or ratio < 1 or ratio & (ratio - 1):
            raise ValueError(f'cells is {self.cells}, must be {COARSEST} times a power of two')
        if self.max_outliers < 0:
            raise ValueError(f'max_outliers is {self.max_outliers}, must not be negative')
        if self.max_rounds < 1:
            raise ValueError(f'max_rounds is {self.max_rounds}, must be positive')
        if self.most_readings is not None and self.most_readings < 1:
            raise ValueError(f'most_readings is {self.most_readings}, must be positive')

    def chosen(self, table: np.ndarray) -> np.ndarray:
        """Return the readings to use of a table of them."""
        if self.most_readings is None or len(table) <= self.most_readings:
            return table
        return table[np.linspace(0, len(table) - 1, self.most_readings).astype(int)]


@dataclass(frozen=True)
class Headings:
    """
    The headings and places of bodies that agree with their readings.

    Parameters
    ----------
    allowed : numpy.ndarray of bool, shape (n, cells)
        Of each body, the cells of the full turn, from 0 on counterclockwise, that may hold its
        heading. None at all where the hypothesis is impossible.
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the places.
    ruled_out_by : tuple of int, or None
        The pair of bodies whose readings left nothing; None while the hypothesis is possible.
    finished : bool
        Whether the cells are as fine as was asked; false where time ran out.

    """

    allowed: np.ndarray
    lower_m: np.ndarray
    upper_m: np.ndarray
    ruled_out_by: Pair | None
    finished: bool

    @property
    def possible(self) -> bool:
        """Whether any headings agree with all readings."""
        return self.ruled_out_by is None

    def arc_rad(self, body: int) -> tuple[float, float]:
        """Return the shortest arc with all headings of a body; a full turn where any may be."""
        cells = np.flatnonzero(self.allowed[body])
        if len(cells) == 0:
            raise ValueError(f'body {body} has no heading: the hypothesis is impossible')
        width = TURN / self.allowed.shape[1]
        return arc_around(cells * width, angle_up((cells + 1) * width))


def heading_cells(lower_rad: ArrayLike, upper_rad: ArrayLike, cells: int) -> np.ndarray:
    """
    Return the cells of the full turn that arcs have anything in common with.

    Parameters
    ----------
    lower_rad, upper_rad : array_like, shape (m,)
        Each arc runs counterclockwise from the first to the second.
    cells : int

    Returns
    -------
    numpy.ndarray of bool, shape (cells,)

    """
    # In cells, to far more than division rounds: an arc that ends on an edge meets both sides.
    slack = 1e-6
    first = np.floor(np.asarray(lower_rad, dtype=float) / TURN * cells - slack)
    last = np.floor(np.asarray(upper_rad, dtype=float) / TURN * cells + slack)
    first, last = np.atleast_1d(first).astype(int), np.atleast_1d(last).astype(int)
    # How many arcs begin less those that end, around the turn twice.
    begins = first % cells
    ends = begins + np.minimum(last - first + 1, cells)
    size = 2 * cells + 1
    changes = np.bincount(begins, minlength=size) - np.bincount(ends, minlength=size)
    met = np.cumsum(changes[:-1]) > 0
    return np.asarray(met[:cells] | met[cells:])


class _Impossible(Exception):
    """A pair of bodies has no headings left."""

    def __init__(self, pair: Pair) -> None:
        super().__init__(pair)
        self.pair = pair


@default_environment()
def narrow_headings(
    lower_m: np.ndarray,
    upper_m: np.ndarray,
    readings: Mapping[Pair, PairReadings],
    options: HeadingOptions | None = None,
    *,
    known: np.ndarray | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> Headings:
    """
    Find the headings of bodies at known places, and bound their places by their headings.

    Parameters
    ----------
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the places of the bodies now, in the frame of the hypothesis; z is zero in the
        plane. Infinite where a place is not known.
    readings : mapping of (int, int) to PairReadings
        What two bodies, A and B of the readings, measured of each other in the window.
    options : HeadingOptions, optional
    known : numpy.ndarray of bool, shape (n, cells), optional
        The headings that are possible by what else is known (`heading_cells`).
    stopped : callable, optional
        Asked between bounded steps; once it is true the headings are returned as they are.

    Returns
    -------
    Headings
        Whatever was not proved impossible.

    """
    options = options or HeadingOptions()
    if known is None:
        known = np.ones((len(lower_m), options.cells), bool)
    search = _Search(lower_m, upper_m, readings, options, known, stopped)
    try:
        finished = search.run()
    except _Impossible as impossible:
        nothing = np.zeros_like(search.allowed)
        return Headings(nothing, search.lower_m, search.upper_m, impossible.pair, True)
    return Headings(search.allowed, search.lower_m, search.upper_m, None, finished)


class _Search:
    """The tables of all pairs, from coarse cells to fine ones."""

    def __init__(
        self,
        lower_m: np.ndarray,
        upper_m: np.ndarray,
        readings: Mapping[Pair, PairReadings],
        options: HeadingOptions,
        known: np.ndarray,
        stopped: Callable[[], bool],
    ) -> None:
        self.lower_m = np.array(lower_m, dtype=float)
        self.upper_m = np.array(upper_m, dtype=float)
        self._options, self._known, self._stopped = options, known, stopped
        self.allowed = self._known_cells(COARSEST)
        self._readings = {pair: options.chosen(part.table) for pair, part in readings.items()}
        shape = (COARSEST, COARSEST)
        self._tables = {pair: np.ones(shape, bool) for pair in readings}
        self._ways = self._unknown_ways()

    def run(self) -> bool:
        """Narrow headings and places; return whether it came to its end."""
        while True:
            finest = self.allowed.shape[1] == self._options.cells
            for _round in range(self._options.max_rounds if finest else 1):
                before = self.allowed.sum()
                if not self._try_pairs():
                    return False
                if self.allowed.sum() == before and finest:
                    break
            if finest:
                return True
            self._halve_cells()

    def _known_cells(self, cells: int) -> np.ndarray:
        """Return what is known of the headings, shape (n, cells)."""
        return np.asarray(self._known.reshape(len(self._known), cells, -1).any(axis=2))

    def _try_pairs(self) -> bool:
        """Let the readings of every pair rule out headings; return whether there was time."""
        for pair, rows in self._readings.items():
            between = self._between(pair)
            if not np.all(np.isfinite(between)):
                continue
            found = np.stack([np.full(3, math.inf), np.full(3, -math.inf)])
            self._make_consistent(pair)
            cells = self.allowed.shape[1]
            for first in range(0, cells, BATCH):
                if self._stopped():
                    return False
                try_cells(
                    self._tables[pair],
                    self._ways[pair],
                    between,
                    rows,
                    self._options.max_outliers,
                    angle_up(math.pi / cells),
                    first,
                    first + BATCH,
                    found,
                )
            self._make_consistent(pair)
            self._place(pair, found)
        return True

    def _unknown_ways(self) -> dict[Pair, np.ndarray]:
        """Return what no reading has bounded: the ways between two bodies by their headings."""
        anywhere = np.array([np.full(3, -math.inf), np.full(3, math.inf)])
        cells = self.allowed.shape[1]
        return {pair: np.tile(anywhere, (cells, cells, 1, 1)) for pair in self._tables}

    def _between(self, pair: Pair) -> np.ndarray:
        """Return bounds of the way from one body to another, shape (2, 3)."""
        a, b = pair
        return np.stack(
            [
                down(self.lower_m[b] - self.upper_m[a]),
                up(self.upper_m[b] - self.lower_m[a]),
            ]
        )

    def _make_consistent(self, changed: Pair) -> None:
        """Drop headings without a partner in some table, until all have one in each."""
        pending = [changed]
        while pending:
            pair = pending.pop()
            a, b = pair
            table = self._tables[pair]
            table &= self.allowed[a][:, None] & self.allowed[b][None, :]
            for body, partnered in ((a, table.any(axis=1)), (b, table.any(axis=0))):
                if not np.any(partnered):
                    raise _Impossible(changed)
                if np.any(self.allowed[body] & ~partnered):
                    self.allowed[body] &= partnered
                    pending += [other for other in self._tables if body in other]

    def _place(self, pair: Pair, found: np.ndarray) -> None:
        """Cut the places of two bodies to what their headings leave of the way between them."""
        a, b = pair
        way = Interval(found[0], found[1])
        first = Interval(self.lower_m[a], self.upper_m[a])
        second = Interval(self.lower_m[b], self.upper_m[b])
        second = second.intersect(first + way)
        first = first.intersect(second - way)
        if first.empty() or second.empty():
            raise _Impossible(pair)
        self.lower_m[a], self.upper_m[a] = first.lower, first.upper
        self.lower_m[b], self.upper_m[b] = second.lower, second.upper

    def _halve_cells(self) -> None:
        """Halve all cells."""
        self.allowed = np.repeat(self.allowed, 2, axis=1)
        self.allowed &= self._known_cells(self.allowed.shape[1])
        self._tables = {
            pair: np.repeat(np.repeat(table, 2, axis=0), 2, axis=1)
            for pair, table in self._tables.items()
        }
        if self.allowed.shape[1] <= ALL_TRIED:
            self._ways = self._unknown_ways()
