# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A sign of life while one answer takes long, and which answer took the longest."""

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Event, Lock, Thread
import time

from dg_localization.ros.terminal import Progress

NOTE_PERIOD_S = 1.0


class TickWatch:
    """
    Shows, from a thread of its own, for how long the present answer is being worked at.

    Parameters
    ----------
    progress : Progress

    Attributes
    ----------
    slowest_s : float
        The longest time that an answer has taken.
    slowest_at_s : float
        The time of that answer, from the start of the bag.

    """

    def __init__(self, progress: Progress) -> None:
        self.slowest_s = 0.0
        self.slowest_at_s = 0.0
        self._progress = progress
        self._lock = Lock()
        self._began_s: float | None = None
        self._at_s = 0.0
        self._ended = Event()
        self._thread = Thread(target=self._watch, name='tick watch', daemon=True)
        self._thread.start()

    @contextmanager
    def solving(self, at_s: float) -> Iterator[None]:
        """Take the time of what is done in the block, for an answer `at_s` into the bag."""
        began_s = time.monotonic()
        with self._lock:
            self._began_s, self._at_s = began_s, at_s
        try:
            yield
        finally:
            took_s = time.monotonic() - began_s
            with self._lock:
                self._began_s = None
                if took_s >= NOTE_PERIOD_S:
                    self._progress.note('')
            if took_s > self.slowest_s:
                self.slowest_s, self.slowest_at_s = took_s, at_s

    def _watch(self) -> None:
        while not self._ended.wait(NOTE_PERIOD_S):
            with self._lock:
                if self._began_s is not None:
                    took_s = time.monotonic() - self._began_s
                    if took_s >= NOTE_PERIOD_S:
                        self._progress.note(f'{took_s:.0f} s for the answer at {self._at_s:.1f} s')

    def close(self) -> None:
        """End the thread."""
        self._ended.set()
        self._thread.join()
