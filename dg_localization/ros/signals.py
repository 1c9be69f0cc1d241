# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""SIGINT, SIGTERM and SIGHUP, which are handled alike everywhere."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import signal
import socket
from threading import Thread
from types import FrameType

# The last one comes when the terminal is closed, or the connection of ssh is lost.
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

Handler = Callable[[int, FrameType | None], object]


@contextmanager
def handled_by(handler: Handler) -> Iterator[None]:
    """Have the signals handled, also where SIGINT was ignored by a script, not SIGHUP by nohup."""
    numbers = [n for n in SIGNALS if n != signal.SIGHUP or signal.getsignal(n) != signal.SIG_IGN]
    before = [signal.signal(number, handler) for number in numbers]
    try:
        yield
    finally:
        for number, former in zip(numbers, before, strict=True):
            signal.signal(number, former)


class StopRequest:
    """Set by the first signal; a second SIGINT or SIGTERM does not wait for a clean end."""

    def __init__(self) -> None:
        self._is_set = False

    def is_set(self) -> bool:
        """Return whether to stop."""
        return self._is_set

    def handle(self, signal_number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        # The kernel and the shell send SIGHUP each when a terminal is closed.
        if self._is_set and signal_number != signal.SIGHUP:
            raise KeyboardInterrupt
        self._is_set = True


@contextmanager
def stop_request() -> Iterator[StopRequest]:
    """Turn the signals into a request, where an exception would break what is being written."""
    stop = StopRequest()
    with handled_by(stop.handle):
        yield stop


@contextmanager
def waking(wake: Callable[[], object]) -> Iterator[None]:
    """
    Have a thread call `wake` when a signal comes.

    Python runs its handlers in the main thread between two instructions, and that thread may be
    waiting in a library. The interpreter writes to a file descriptor at once.
    """
    reader, writer = socket.socketpair()
    writer.setblocking(False)

    def wait() -> None:
        while reader.recv(1):
            wake()

    thread = Thread(target=wait, name='signals', daemon=True)
    thread.start()
    before = signal.set_wakeup_fd(writer.fileno())
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        writer.close()
        thread.join()
        reader.close()
