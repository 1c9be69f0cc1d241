"""One thread that estimates, so that the executor goes on receiving."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from threading import Event

from dg_localization.fleet import Estimate, Snapshot


class EstimateWorker:
    """
    Runs one estimate at a time; all methods are called from the executor's thread.

    Parameters
    ----------
    estimate : callable
        Called with a snapshot and an event that is set when nobody wants the answer any more.
    wake : callable
        Called without arguments from the worker's thread when an answer can be taken.

    """

    def __init__(
        self, estimate: Callable[[Snapshot, Event], Estimate], wake: Callable[[], None]
    ) -> None:
        self._estimate = estimate
        self._wake = wake
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix='estimate')
        self._running: Future[Estimate] | None = None
        self._cancel = Event()

    @property
    def busy(self) -> bool:
        """Whether an answer is being worked out or waits to be taken."""
        return self._running is not None

    def submit(self, snapshot: Snapshot) -> None:
        """Start on a snapshot; only while not `busy`."""
        self._cancel = Event()
        self._running = self._pool.submit(self._estimate, snapshot, self._cancel)
        self._running.add_done_callback(lambda _: self._wake())

    def take(self) -> Estimate | None:
        """
        Return the answer, once; None when there is none or it was cancelled.

        Raises
        ------
        Exception
            Whatever the estimate raised.

        """
        running = self._running
        if running is None or not running.done():
            return None
        self._running = None
        return running.result()

    def cancel(self) -> None:
        """Tell the running estimate to stop, and drop its answer."""
        self._cancel.set()
        self._running = None

    def close(self) -> None:
        """Cancel, and wait for the thread to end."""
        self.cancel()
        self._pool.shutdown()
