# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The budget of a call: boxes, time, and time to tighten bounds."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
import math
import time
from typing import Any

from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.result import Statistics

GRACE_S = 0.005
"""Time after the end from which long steps are skipped; short steps still give an answer."""


class _Remembered:
    """Stays set even if its event is cleared, so that no stopped step counts as done."""

    def __init__(self, cancel: Cancel) -> None:
        self._cancel = cancel
        self._was_set = False

    def is_set(self) -> bool:
        self._was_set = self._was_set or bool(self._cancel.is_set())
        return self._was_set


class Budget:
    """The boxes and the time of a call or a part of it; its clock starts at construction."""

    def __init__(
        self,
        options: SolverOptions,
        cancel: Cancel | None = None,
        progress: Callable[[Statistics], None] | None = None,
        submit: Callable[..., Future[Any]] | None = None,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.options = options
        self.spent = Statistics()
        self.progress = progress
        self.submit = submit
        self._cancel = None if cancel is None else _Remembered(cancel)
        self._clock = clock
        self._start = clock()
        self._cancelled_s = math.inf

    def __getstate__(self) -> dict[str, object]:
        """Return the state to pickle, without events, callables and workers."""
        return vars(self) | {'_cancel': None, 'progress': None, 'submit': None}

    def again(self, options: SolverOptions | None = None) -> Budget:
        """Return a budget that starts now, with the same options or others."""
        return Budget(options or self.options, self._cancel, clock=self._clock)

    def new_clock(self) -> Callable[[], bool]:
        """Return a clock for a later computation, which may take as long as the call."""
        return self.again().is_over

    def part(self, share: float, most_boxes: int | None = None, is_silent: bool = False) -> Budget:
        """Return the budget of a part that may take a share of the rest."""
        boxes = self.boxes_left()
        # Without boxes left, a search ends before its first box with all boxes pending.
        most_boxes = min(max(int(share * boxes), 1), most_boxes or boxes, max(boxes, 0))
        options = self._limited(most_boxes, share * self.seconds_left())
        progress = self.report if self.progress and not is_silent else None
        return Budget(options, self._cancel, progress, clock=self._clock)

    def remaining(self) -> SolverOptions:
        """Return the options with the remaining time."""
        return self._limited(self.options.max_boxes, self.seconds_left())

    def _limited(self, max_boxes: int, max_seconds: float) -> SolverOptions:
        tighten_seconds = max(0.0, self.options.tighten_seconds - self.seconds())
        return self.options.limited(max_boxes, max_seconds, tighten_seconds)

    def seconds(self) -> float:
        """Return the time since the call began."""
        return self._clock() - self._start

    def seconds_left(self) -> float:
        """Return the time until the call must end."""
        return self.options.max_seconds - self.seconds()

    def boxes_left(self) -> int:
        """Return the number of boxes left."""
        return self.options.max_boxes - self.spent.processed

    def is_over(self) -> bool:
        """Return whether the call must end."""
        if self._cancel and self._cancel.is_set():
            self._cancelled_s = min(self._cancelled_s, self.seconds())
            return True
        return self.seconds() > self.options.max_seconds

    def has_passed(self, share: float) -> Callable[[], bool]:
        """Return a function that says whether a share of the remaining time has passed."""
        end_s = self.seconds() + share * self.seconds_left()
        return lambda: self.is_over() or self.seconds() > end_s

    def is_overdue(self) -> bool:
        """Return whether the call is past its end by more than a grace period."""
        if not self.is_over():
            return False
        return self.seconds() > min(self.options.max_seconds, self._cancelled_s) + GRACE_S

    def leaves_wide(self) -> bool:
        """Return whether the time to tighten boxes is over."""
        return self.seconds() > self.options.tighten_seconds or self.is_over()

    def report(self, statistics: Statistics) -> None:
        """Report the effort so far, including the part in progress."""
        if self.progress:
            self.progress(self.spent + statistics)

    def spend(self, statistics: Statistics) -> None:
        """Add the effort of a part."""
        if self.boxes_left() <= 0:
            # A problem ruled out by the triangle inequalities alone takes no box.
            statistics = replace(statistics, processed=0, empty=0)
        self.spent += statistics

    def take_back(self, n_pending: int) -> None:
        """Record that pending boxes of a search are examined after all."""
        self.spent = replace(self.spent, pending=self.spent.pending - n_pending)

    def go_on_from(self, n_kept: int) -> None:
        """Record that kept boxes are parts of boxes that are examined next."""
        n_split = min(n_kept, self.spent.kept)
        self.spent = replace(
            self.spent, kept=self.spent.kept - n_split, split=self.spent.split + n_split
        )

    def keep(self, n_boxes: int) -> bool:
        """Record kept boxes that were not found by a search, if enough boxes are left."""
        if n_boxes > self.boxes_left():
            return False
        self.spent += Statistics(processed=n_boxes, kept=n_boxes)
        return True
