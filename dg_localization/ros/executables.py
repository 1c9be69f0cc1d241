"""
The executables, which end without a traceback on SIGINT and SIGTERM from their first moment on.

Importing rclpy and the messages is most of a start: it happens here, when the signals are taken
care of.
"""

from collections.abc import Callable
from importlib import import_module
import signal

# What a shell makes of SIGINT: half an answer must not look whole to a script.
EXIT_INTERRUPTED = 130


def localizer() -> int:
    """Run `localizer`; return the exit code."""
    return _run('node.localizer')


def simulate_fleet() -> int:
    """Run `simulate_fleet`; return the exit code."""
    return _run('demo.simulate_fleet')


def replay() -> int:
    """Run `replay`; return the exit code."""
    return _run('bags.replay')


def localize_bag() -> int:
    """Run `localize_bag`; return the exit code."""
    return _run('bags.localize_bag', interrupted=EXIT_INTERRUPTED)


def _run(name: str, interrupted: int = 0) -> int:
    """Import a module of this room and run its `main`."""
    try:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.default_int_handler)
        main: Callable[[], int] = import_module(f'dg_localization.ros.{name}').main
        return main()
    except KeyboardInterrupt:
        return interrupted
