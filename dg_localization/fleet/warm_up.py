# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Loading of all compiled kernels, or their compilation the first time on a machine."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from itertools import combinations, permutations
import math
from threading import Event, Thread
import time

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.localizer import Localizer
from dg_localization.interval.kernels import (
    COMPILED,
    compile_progress,
    compiled_soon,
    why_not_kept,
    why_slow,
)
from dg_localization.solver.solve import load_kernels

STAMP_S = 1.0
REPORT_PERIOD_S = 0.5


def warm_up(report: Callable[[str], object] | None = None) -> None:
    """
    Load every kernel of the solver and the fleet, so that later estimates do not wait for them.

    The first time on a machine this compiles the kernels, which takes one to two minutes of one
    processor; `warm_up_status` reports the progress. Without numba there is nothing to load.

    Parameters
    ----------
    report : callable, optional
        Called from another thread with that line and the seconds so far, such as `print`: when
        compilation begins and about ten times during it; not called if kernels are only loaded.

    """
    if not COMPILED:
        return
    with compiled_soon(), nullcontext() if report is None else _reporting(report):
        _load_all()


@contextmanager
def _reporting(report: Callable[[str], object]) -> Iterator[None]:
    """Report the progress of compilation, about every tenth, until the block ends."""
    began_s, ended = time.monotonic(), Event()

    def watch() -> None:
        shown = -1
        while not ended.wait(REPORT_PERIOD_S):
            progress = compile_progress()
            tenths = 10 * progress.compiled // progress.total
            if progress.compiled and tenths > shown:
                shown = tenths
                report(f'{warm_up_status()}, {time.monotonic() - began_s:.0f} s')

    reporter = Thread(target=watch, name='compiling', daemon=True)
    reporter.start()
    try:
        yield
    finally:
        ended.set()
        reporter.join()


@cache
def _load_all() -> None:
    """Run estimates that need every kernel, once per process."""
    load_kernels()
    _estimate_small_fleet()
    for outliers in (0, 1):
        _estimate_in_time(outliers)


def warm_up_status() -> str:
    """Return a readable status of `warm_up` in another thread."""
    progress = compile_progress()
    if not progress.compiled:
        return 'loading the solver'
    return (
        f'compiling the solver, once on this machine: {progress.compiled} of {progress.total} '
        'kernels'
    )


def solver_warnings() -> tuple[str, ...]:
    """Return reasons why the solver is slower than it could be, with remedies."""
    return tuple(text for text in (why_slow(), why_not_kept()) if text)


def _estimate_small_fleet() -> None:
    """
    Estimate a small fleet at one time.

    Of its two groups of robots, which do not measure each other, one has several placements and
    the other has cameras.
    """
    # Two triangles with an edge in common, the lone corners at the ends.
    positions_m = np.array([(0.0, 0.0), (3.0, 0.0), (0.0, 4.0), (3.5, 3.5)])
    groups = [tuple(f'{group}{i}' for i in range(len(positions_m))) for group in 'ab']
    localizer = Localizer(FleetConfig(robots=(*groups[0], *groups[1])))
    for robots in groups:
        for i, j in _measured_pairs(len(robots)):
            range_m = float(np.linalg.norm(positions_m[j] - positions_m[i]))
            localizer.add_range(robots[i], robots[j], range_m, STAMP_S, STAMP_S)
    for i, j in _measured_pairs(len(positions_m)):
        ray = (*(positions_m[j] - positions_m[i]), 0.0)
        localizer.add_bearing(groups[1][i], groups[1][j], ray, STAMP_S, STAMP_S)
    localizer.step(STAMP_S)


def _estimate_in_time(window_outliers: int) -> None:
    """Estimate two robots with odometry from all kinds of readings between them."""
    # Compilation takes longer than an answer may.
    config = FleetConfig(('r', 's'), window_outliers=window_outliers, memory_max_seconds=math.inf)
    localizer = Localizer(config)
    places_m = {'r': (0.0, 1.0, 0.0), 's': (1.0, 1.0, 0.0)}
    for now_s in (STAMP_S, STAMP_S + 1.0, STAMP_S + 2.0):
        for robot, place_m in places_m.items():
            localizer.add_odometry(robot, place_m, (0.0, 0.0, 0.0, 1.0), now_s, now_s)
        for (first, from_m), (other, to_m) in permutations(places_m.items(), 2):
            localizer.add_range(first, other, math.dist(from_m, to_m), now_s, now_s)
            localizer.add_bearing(first, other, np.subtract(to_m, from_m), now_s, now_s)
        localizer.step(now_s)
    # A contradiction is explained and forgotten.
    localizer.add_range('r', 's', 9.0, now_s, now_s)
    localizer.step(now_s)


def _measured_pairs(n: int) -> list[tuple[int, int]]:
    """Return all pairs except the two lone corners, which may be on the same or opposite sides."""
    return [pair for pair in combinations(range(n), 2) if pair != (0, n - 1)]
