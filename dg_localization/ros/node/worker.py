# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A thread that estimates, so that the executor goes on receiving, and what watches it."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import suppress
import os
import sys
from threading import Event, Lock, enumerate as running_threads, get_ident, get_native_id
import time
from typing import Any, Generic, TypeVar

from dg_localization.fleet import FleetConfig, Snapshot

A = TypeVar('A')

THREAD_NAME = 'estimate'
CLOSE_S = 2.0
# The solver uses every processor, in threads that inherit the priority of this one. Without this,
# messages wait for a turn among them and are lost (benchmarks/notes/reliability.md).
NICENESS = 5
# A thread cannot be ended from outside. One that never returns costs a processor.
MOST_STUCK = 3


def _nothing() -> None:
    """Do nothing."""


class EstimateWorker(Generic[A]):
    """
    Runs one estimate at a time; all methods are called from the executor's thread.

    Parameters
    ----------
    estimate : callable
        Called with a snapshot and an event that is set when nobody wants the answer any more.
    wake : callable
        Called without arguments from the worker's thread when an answer can be taken; never
        after `cancel` or `close`.
    warm_up : callable, optional
        Called without arguments before the first estimate; `cancel` does not stop it.
    warm : callable, optional
        Called without arguments from the worker's thread when that is over; never after `close`.

    Attributes
    ----------
    warm_up : Future
        Whether it is over, and what it raised.

    """

    def __init__(
        self,
        estimate: Callable[[Snapshot, Event], A],
        wake: Callable[[], None],
        warm_up: Callable[[], None] = _nothing,
        warm: Callable[[], None] = _nothing,
    ) -> None:
        self._estimate = estimate
        self._wake = wake
        self._pool, self._threads = _new_pool()
        self._began_s = self._began_cpu_s = 0.0
        self._stuck: list[Future[Any]] = []
        self._wanted: Future[A] | None = None
        self._cancel = Event()
        self._closed = Event()
        self._lock = Lock()
        self.warm_up = self._pool.submit(warm_up)
        self.warm_up.add_done_callback(lambda _: self._call_unless(self._closed, warm))
        self._newest: Future[Any] = self.warm_up

    @property
    def busy(self) -> bool:
        """Whether an answer is being worked out or waits to be taken."""
        return self._wanted is not None

    @property
    def busy_s(self) -> float:
        """For how long it has been `busy`, in s."""
        return time.monotonic() - self._began_s if self.busy else 0.0

    @property
    def cpu_s(self) -> float:
        """How much of a processor the thread has used while `busy`; no more than `busy_s`."""
        return self._thread_s() - self._began_cpu_s if self.busy else 0.0

    def _thread_s(self) -> float:
        """Return the processor time of the thread; where that is not known, the time."""
        if not hasattr(time, 'pthread_getcpuclockid'):
            return time.monotonic()
        return sum(time.clock_gettime(time.pthread_getcpuclockid(one)) for one in self._threads)

    def submit(self, snapshot: Snapshot) -> None:
        """Start on a snapshot; only while not `busy`."""
        self._began_s, self._began_cpu_s = time.monotonic(), self._thread_s()
        cancel = self._cancel = Event()
        self._newest = self._wanted = self._pool.submit(self._estimate, snapshot, cancel)
        self._wanted.add_done_callback(lambda _: self._call_unless(cancel, self._wake))

    def _call_unless(self, stopped: Event, function: Callable[[], None]) -> None:
        with self._lock:
            if not stopped.is_set():
                function()

    def take(self) -> A | None:
        """Return the answer, once, or raise what the estimate raised; None when there is none."""
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

    def restart(self) -> bool:
        """
        Cancel, go on in a new thread and return True; the old one ends if its estimate returns.

        Where so many threads are stuck that one more does not help, nothing changes.
        """
        self._stuck = [future for future in self._stuck if not future.done()]
        if len(self._stuck) == MOST_STUCK:
            return False
        self._stuck.append(self._newest)
        self.cancel()
        self._pool.shutdown(wait=False)
        self._pool, self._threads = _new_pool()
        return True

    def close(self) -> None:
        """Cancel, and give the thread a moment to end; it may be compiling, which cannot stop."""
        self.cancel()
        with self._lock:
            self._closed.set()
        late = wait([self._newest], timeout=CLOSE_S).not_done
        self._pool.shutdown(wait=not late)


def _new_pool() -> tuple[ThreadPoolExecutor, list[int]]:
    """Return a pool of one thread, and a list that will hold its identifier."""
    threads: list[int] = []

    def begin() -> None:
        threads.append(get_ident())
        _step_back()

    return ThreadPoolExecutor(1, THREAD_NAME, begin), threads


def _step_back() -> None:
    """Lower the priority of this thread where threads have one, which is on Linux."""
    if sys.platform == 'linux':
        thread = get_native_id()
        niceness = os.getpriority(os.PRIO_PROCESS, thread) + NICENESS
        with suppress(OSError):  # a container may forbid it
            os.setpriority(os.PRIO_PROCESS, thread, niceness)


def exit_code_despite_worker(code: int) -> int:
    """
    Return `code`, or end the process with it when a worker's thread is still running.

    The interpreter waits for all threads at its end. The first warm-up of an installation
    compiles the kernels for minutes, longer than anybody waits after a signal.
    """
    if any(thread.name.startswith(THREAD_NAME) for thread in running_threads()):
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    return code


# An estimate that takes so many times its limit, and at least so long, will never end.
PATIENCE = 5.0
LEAST_PATIENCE_S = 10.0
# Any estimate that is not stuck uses this much of a processor in the time that it may take, also
# on a machine that is far too busy.
LEAST_PROGRESS_S = 0.02


def longest_estimate_s(fleet: FleetConfig) -> float:
    """Return how long an estimate may take by its limits."""
    return fleet.solver.max_seconds + fleet.memory_max_seconds + fleet.max_conflict_seconds


class Watchdog:
    """
    Looks at the running estimate from time to time.

    Parameters
    ----------
    limit_s : float
        How long an estimate may take by its parameters.

    """

    def __init__(self, limit_s: float) -> None:
        self._limit_s = limit_s
        self._patience_s = max(LEAST_PATIENCE_S, PATIENCE * limit_s)
        self._seen_cpu_s = 0.0
        self._seen_at_s = 0.0

    def is_late(self, busy_s: float) -> bool:
        """Return whether an estimate that has run for so long should have ended."""
        return busy_s > self._limit_s

    def is_hopeless(self, busy_s: float, cpu_s: float) -> bool:
        """
        Return whether the running estimate will never end.

        It has used all the time of a processor that it may, or has stood still for as long.
        """
        is_another = busy_s < self._seen_at_s or cpu_s < self._seen_cpu_s
        if is_another or cpu_s - self._seen_cpu_s > LEAST_PROGRESS_S:
            self._seen_cpu_s, self._seen_at_s = cpu_s, busy_s
        return cpu_s > self._patience_s or busy_s - self._seen_at_s > self._patience_s
