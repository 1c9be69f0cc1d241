# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A thread for estimates, so that the executor continues to receive."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
import gc
import os
import sys
from threading import Event, Lock, enumerate as running_threads, get_native_id
import time
from typing import Any, Generic, TypeVar

from dg_localization.fleet import Snapshot, warm_up

A = TypeVar('A')

THREAD_NAME = 'estimate'
CLOSE_S = 2.0
# The solver uses every processor, in threads that inherit the priority of this one. At normal
# priority, messages wait behind these threads and are lost (benchmarks/notes/reliability.md).
NICENESS = 5
# An estimate that takes this multiple of its limits, and at least this time, may never end. Its
# limit is the sum of those of solver, memory and explanation.
PATIENCE, PATIENCE_S = 5.0, 10.0


def patience_s(limits_s: float) -> float:
    """Return the time in s after which an estimate with given limits is abandoned."""
    return max(PATIENCE * limits_s, PATIENCE_S)


class EstimateWorker(Generic[A]):
    """
    Runs one estimate at a time; all methods are called from the thread of the executor.

    Parameters
    ----------
    estimate : callable
        Called with a snapshot and an event that is set when the answer is no longer wanted.
    wake : callable
        Called without arguments from the thread of the worker when an answer is ready; never after
        `cancel` or `close`.
    warm_up : callable, optional
        Called without arguments before the first estimate; `cancel` does not stop it.

    Attributes
    ----------
    warm_up : Future
        The result of the warm-up.

    """

    def __init__(
        self,
        estimate: Callable[[Snapshot, Event], A],
        wake: Callable[[], None],
        warm_up: Callable[[], None] = lambda: None,
    ) -> None:
        self._estimate = estimate
        self._wake = wake
        self._pool = ThreadPoolExecutor(1, THREAD_NAME, _step_back)
        self._began_s = 0.0
        self._wanted: Future[A] | None = None
        self._cancel = Event()
        self._lock = Lock()
        self._newest: Future[Any] = self._pool.submit(warm_up)
        self.warm_up = self._newest

    @property
    def busy(self) -> bool:
        """Whether an estimate is running or its answer waits to be taken."""
        return self._wanted is not None

    @property
    def busy_s(self) -> float:
        """The time for which it has been `busy`, in s."""
        return time.monotonic() - self._began_s if self.busy else 0.0

    def submit(self, snapshot: Snapshot) -> None:
        """Start on a snapshot; only while not `busy`."""
        self._began_s = time.monotonic()
        cancel = self._cancel = Event()
        self._newest = self._wanted = self._pool.submit(self._estimate, snapshot, cancel)
        self._wanted.add_done_callback(lambda _: self._wake_unless(cancel))

    def _wake_unless(self, cancel: Event) -> None:
        with self._lock:
            if not cancel.is_set():
                self._wake()

    def take(self) -> A | None:
        """Return the answer once, or raise the error of the estimate; None if there is none."""
        wanted = self._wanted
        if wanted is None or not wanted.done():
            return None
        self._wanted = None
        return wanted.result()

    def cancel(self) -> None:
        """Ask the running estimate to stop, and drop its answer."""
        with self._lock:
            self._cancel.set()
        self._wanted = None

    def close(self) -> None:
        """Cancel, and give the thread a moment to end; compilation cannot be stopped."""
        self.cancel()
        late = wait([self._newest], timeout=CLOSE_S).not_done
        self._pool.shutdown(wait=not late)


def _step_back() -> None:
    """Lower the priority of this thread on Linux, where threads have their own priority."""
    if sys.platform == 'linux':
        thread = get_native_id()
        niceness = os.getpriority(os.PRIO_PROCESS, thread) + NICENESS
        with suppress(OSError):  # a container may forbid it
            os.setpriority(os.PRIO_PROCESS, thread, niceness)


def exit_code_despite_worker(code: int) -> int:
    """
    Return `code`, or end the process with it when a worker's thread is still running.

    The interpreter waits for all threads at its end. The first warm-up of an installation
    compiles the kernels for minutes, which is too long after a signal.
    """
    if any(thread.name.startswith(THREAD_NAME) for thread in running_threads()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


def load_for_good() -> None:
    """
    Load the kernels, and keep the objects that exist then out of garbage collections.

    A collection visits all objects of numba, which stops an answer for about 0.1 s every few
    seconds. These objects live as long as the process.
    """
    warm_up()
    gc.collect()
    gc.freeze()
