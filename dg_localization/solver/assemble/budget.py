# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The effort of one call, shared by the searches of its pieces."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
import time

from dg_localization.solver.box import FloatArray
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Statistics
from dg_localization.solver.search.branch_and_prune import Cover
from dg_localization.solver.search.search import search

SHORTEST_S = 1e-9
"""A search with less time than this left does not look at a single box."""


class _Stopped:
    """Stops a search before its first box: what it covers is all pending."""

    def is_set(self) -> bool:
        return True


class CallBudget:
    """
    What is left of the boxes and of the time that a call may take.

    Parameters
    ----------
    options : SolverOptions
        The limits of the whole call.
    cancel : object with ``is_set()``, optional
        Stops every search when set.
    progress : callable, optional
        Called with the statistics of all searches so far after every box.

    """

    def __init__(
        self,
        options: SolverOptions,
        cancel: Cancel | None = None,
        progress: Callable[[Statistics], None] | None = None,
    ) -> None:
        self.options = options
        self.spent = Statistics()
        self._cancel = cancel
        self._progress = progress
        self._start = time.perf_counter()

    def seconds(self) -> float:
        """Return the time since the call began."""
        return time.perf_counter() - self._start

    def is_cancelled(self) -> bool:
        """Return whether the call was cancelled."""
        return bool(self._cancel and self._cancel.is_set())

    def is_over(self) -> bool:
        """Return whether the call is to come to an end."""
        if self.is_cancelled():
            return True
        return self.seconds() > self.options.max_seconds

    def _report(self, statistics: Statistics) -> None:
        if self._progress:
            self._progress(self.spent + statistics)

    def take_back(self, n_pending: int) -> None:
        """Note that boxes which a search left pending are examined after all."""
        self.spent = replace(self.spent, pending=self.spent.pending - n_pending)

    def go_on_from(self, n_kept: int) -> None:
        """Note that boxes which were kept are parts of boxes that are examined next."""
        n_split = min(n_kept, self.spent.kept)
        self.spent = replace(
            self.spent, kept=self.spent.kept - n_split, split=self.spent.split + n_split
        )

    def accept(self, n_pending: int) -> None:
        """Note that boxes which a search left pending are kept as they are."""
        self.spent = replace(
            self.spent,
            processed=self.spent.processed + n_pending,
            kept=self.spent.kept + n_pending,
            pending=self.spent.pending - n_pending,
        )

    def search(
        self,
        problem: Problem,
        share: float,
        within: Sequence[tuple[FloatArray, FloatArray]] | None = None,
        most_boxes: int | None = None,
    ) -> Cover:
        """
        Cover the placements of a piece with a share of what is left.

        Parameters
        ----------
        problem : Problem
            The piece.
        share : float
            The fraction of the boxes and of the time left that the search may take.
        within : sequence of (lower, upper), optional
            The boxes in m^2 to search in; everywhere when there are none.
        most_boxes : int, optional
            Most boxes to process, besides the share.

        Returns
        -------
        Cover
            The cover; complete, whatever is left.

        """
        boxes = self.options.max_boxes - self.spent.processed
        seconds = self.options.max_seconds - (self.seconds() if self.spent.processed else 0.0)
        options = replace(
            self.options,
            max_boxes=max(1, min(int(share * boxes), most_boxes or boxes)),
            max_seconds=max(SHORTEST_S, share * seconds),
            tighten_seconds=max(SHORTEST_S, self.options.tighten_seconds - self.seconds()),
        )
        cancel = self._cancel if boxes > 0 else _Stopped()
        cover, statistics = search(problem, options, cancel, self._report, within)
        if boxes <= 0:
            # What the triangle inequalities alone rule out takes no box.
            statistics = replace(statistics, processed=0, empty=0)
        self.spent += statistics
        return cover

    def search_in_one_box(self, problem: Problem) -> Cover | None:
        """
        Cover the placements of a problem by one box.

        Parameters
        ----------
        problem : Problem
            The problem.

        Returns
        -------
        Cover or None
            The cover, empty where there is no placement; None where one box is not enough or the
            time is over, which counts as no effort.

        """
        seconds = max(SHORTEST_S, self.options.max_seconds - self.seconds())
        tighten_seconds = max(SHORTEST_S, self.options.tighten_seconds - self.seconds())
        options = replace(
            self.options, max_boxes=1, max_seconds=seconds, tighten_seconds=tighten_seconds
        )
        cover, statistics = search(problem, options, self._cancel)
        if cover.pending:
            return None
        self.spent += statistics
        self._report(Statistics())
        return cover
