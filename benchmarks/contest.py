# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Answers of different methods to one case, timed and scored alike."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
import multiprocessing
from statistics import median
import time
from typing import TypeVar

import numpy as np

from benchmarks.cases import Case
from benchmarks.exact import exact_hull, linearized_hull, unknown_pairs
from benchmarks.problems import FloatArray, Pair, squared_distances
from dg_localization import SolverOptions, Verdict, solve

Answer = TypeVar('Answer')

SOLVER = 'dg_localization'
RUNS = 7
STEADY = 0.5
"""Short runs are repeated for so long, in seconds: a process just forked is slow at first."""

MAX_PAIRS = 40
"""Widths of larger fleets are compared on so many unknown pairs, drawn at random."""


@dataclass(frozen=True)
class Effort:
    """How long to wait, in seconds."""

    measuring: float
    """After so long no further run of a method is started, however few there were."""
    others: float
    """After so long another method has failed."""


FULL = Effort(measuring=10.0, others=60.0)
QUICK = Effort(measuring=1.5, others=2.0)


@dataclass(frozen=True)
class Timing:
    """Seconds per run, after one run that is not counted."""

    median: float
    minimum: float
    runs: int


@dataclass(frozen=True)
class Score:
    """How much of the truth an answer holds, and how tightly."""

    found: int
    """Known placements contained."""
    widest: float | None = None
    """Largest and ..."""
    typical: float | None = None
    """... median width of an unknown pair over the reference width."""
    cut: bool = False
    """Whether some hull lacks a part of the exact one."""


@dataclass(frozen=True)
class Row:
    """One method's line in the table of a case."""

    who: str
    timing: Timing | None = None
    boxes: int | None = None
    empty: int | None = None
    hypotheses: int | None = None
    score: Score | None = None
    remark: str = ''


@dataclass(frozen=True)
class Figure:
    """One measured figure and what it should be."""

    what: str
    value: str
    aim: str = ''
    met: bool | None = None


@dataclass(frozen=True)
class Hull:
    """Bounds of all squared distances of one connected part of an answer, (n, n) in m^2."""

    lower: FloatArray
    upper: FloatArray


def measure(run: Callable[[], Answer], effort: Effort) -> tuple[Answer, Timing]:
    """
    Time a function on a warm machine.

    Parameters
    ----------
    run : callable
        What to time.
    effort : Effort
        When to stop.

    Returns
    -------
    answer
        What it returned last.
    Timing
        Median and minimum of at least `RUNS` runs, after one that is not counted, and of as many
        as `STEADY` holds; of fewer when time is up; at least the first counts.

    """
    started = time.perf_counter()
    answer = run()
    first = time.perf_counter() - started
    seconds: list[float] = []
    while len(seconds) < RUNS or time.perf_counter() - started < STEADY:
        if time.perf_counter() + first - started > effort.measuring:
            break
        begin = time.perf_counter()
        answer = run()
        seconds.append(time.perf_counter() - begin)
    seconds = seconds or [first]
    return answer, Timing(median(seconds), min(seconds), len(seconds))


def attainable_resolution(case: Case) -> float:
    """Return how far the measurement errors leave a distance open, or the resolution if more."""
    bounds = _linearized_hull(case, 0)
    widths = np.diff(np.sqrt(np.maximum(bounds, 0.0)), axis=1)
    return max(case.resolution, float(widths.max()))


def compared_pairs(case: Case) -> list[Pair]:
    """Return the unknown pairs whose widths are compared."""
    pairs = unknown_pairs(case.problem)
    chosen = np.random.default_rng(0).permutation(len(pairs))[:MAX_PAIRS]
    return [pairs[index] for index in sorted(chosen)]


@cache
def _linearized_hull(case: Case, number: int) -> FloatArray:
    return linearized_hull(case.problem, case.placements[number], compared_pairs(case))


@cache
def _exact_hull(case: Case, number: int) -> FloatArray:
    return exact_hull(case.problem, case.placements[number], compared_pairs(case))


def reference_hull(case: Case, number: int) -> FloatArray | None:
    """Return the hull that the widths about a placement are compared with, None without one."""
    if case.hull is None:
        return None
    return (_exact_hull if case.hull == 'exact' else _linearized_hull)(case, number)


def score(case: Case, hulls: Sequence[Hull]) -> Score:
    """
    Compare an answer with what is known.

    Parameters
    ----------
    case : Case
        The case.
    hulls : sequence of Hull
        The connected parts of the answer.

    Returns
    -------
    Score
        A placement counts as found when one hull holds all its distances, and its widths are
        those of that hull.

    """
    found = 0
    ratios: list[float] = []
    cut = False
    rows, columns = np.array(compared_pairs(case)).T
    for number, placement in enumerate(case.placements):
        squared = squared_distances(placement)
        slack = 1e-12 * squared.max()
        holding = [
            hull
            for hull in hulls
            if (hull.lower <= squared + slack).all() and (hull.upper >= squared - slack).all()
        ]
        if not holding:
            continue
        found += 1
        reference = reference_hull(case, number)
        if reference is None:
            continue
        lower, upper = holding[0].lower[rows, columns], holding[0].upper[rows, columns]
        width = reference[:, 1] - reference[:, 0]
        ratios.extend((upper - lower) / width)
        if case.hull == 'exact':
            tolerance = 1e-6 * width
            cut |= bool((lower > reference[:, 0] + tolerance).any())
            cut |= bool((upper < reference[:, 1] - tolerance).any())
    if not ratios:
        return Score(found)
    return Score(found, max(ratios), median(ratios), cut)


def solver_options(case: Case) -> SolverOptions:
    """Return how the solver is asked to treat a case."""
    return SolverOptions(case.resolution, case.max_boxes, case.max_seconds, case.tighten_seconds)


def rows(case: Case, effort: Effort) -> list[Row]:
    """Solve a case with this package."""
    options = solver_options(case)
    result, timing = measure(lambda: solve(case.problem, options), effort)
    row = Row(
        SOLVER,
        timing,
        result.statistics.processed,
        result.statistics.empty,
        len(result.hypotheses),
        score(case, [Hull(found.lower, found.upper) for found in result.hypotheses]),
        '' if result.verdict is Verdict.COVERED else result.verdict.value.replace('_', ' '),
    )
    return [row]


def prepare(case: Case) -> None:
    """Compute what scores need, once for all methods."""
    attainable_resolution(case)
    for number in range(len(case.placements)):
        reference_hull(case, number)


def isolated(run: Callable[[], Iterable[Row]], who: str, max_seconds: float) -> list[Row]:
    """
    Run a method in a process of its own, which may hang or crash.

    Parameters
    ----------
    run : callable
        Returns the rows of the method.
    who : str
        Named in the row of a method that fails.
    max_seconds : float
        Patience.

    Returns
    -------
    list of Row
        What the method returned, or one row that says how it failed.

    """
    # Forked, so that loaded kernels and prepared hulls are there already.
    context = multiprocessing.get_context('fork')
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=lambda: sender.send(list(run())))
    process.start()
    sender.close()
    try:
        if not receiver.poll(max_seconds):
            return [Row(who, remark=f'stopped after {max_seconds:.0f} s')]
        rows: list[Row] = receiver.recv()
        return rows
    except EOFError:
        process.join()
        return [Row(who, remark=f'crashed, exit code {process.exitcode}')]
    finally:
        process.kill()
        process.join()
