# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Which projections are worth their time: the data behind docs/projections.md.

Axes and their order are studied on the boxes that a search meets, one projection at a time.
Choices that are compiled into the kernels are studied by whole searches, each in a process that
changes one of them before it compiles (about a minute each)::

    python -m benchmarks.projections axes order points [--picture docs/projections.png]
    python -m benchmarks.projections variants [--only NAME ...]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
import json
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases import Case, all_cases
from dg_localization import Problem, Result, SolverOptions, solve
from dg_localization.interval.kernels import kernel
from dg_localization.solver.box import LOWER, UPPER
from dg_localization.solver.contract import fixed_point, projection, reduction
from dg_localization.solver.contract.axes import axes_of, rank_axes
from dg_localization.solver.contract.back_projection import back_project
from dg_localization.solver.contract.combination import combine
from dg_localization.solver.contract.groups import Groups, groups_of
from dg_localization.solver.contract.line import reduce_line
from dg_localization.solver.contract.projection import is_axis, project
from dg_localization.solver.contract.reduction import Workspace, make_workspace, rows_of
from dg_localization.solver.contract.sides import Sides, sides_of
from dg_localization.solver.contract.status import Status
from dg_localization.solver.contract.widths import relative_error
from dg_localization.solver.search.pruning import Pruner
from dg_localization.solver.search.splitting import split

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

CASES = (
    'fleet',
    'fleet-3pc',
    'octahedral',
    'octahedral-sides',
    'octahedral-convex',
    'random2d-n10-3pc-s0',
    'random2d-n20-3pc-s0',
    'random2d-n50-3pc-s0',
    'random3d-n6-1pc-s0',
    'random3d-n10-1pc-s0',
    'random3d-n20-1pc-s0',
)
DRAWN = tuple(name for name in CASES if name.startswith('random') and 'n6' not in name)
LARGE_CASES = ('random2d-n20-3pc-s0', 'random2d-n50-3pc-s0', 'random3d-n20-1pc-s0')

MOST_BOXES = 8
"""So many boxes of a search are studied."""
MOST_AXES_STUDIED = 300
"""So many axes of a box are tried, evenly picked."""

RESOLVED_M = 1e-3
"""Gains below this width of a distance do not count."""
LEAST_GAIN_BITS = 0.01

LARGEST_ERROR = 1.0 - projection.LEAST_AXIS_RATIO
"""Pairs with a greater relative error of the squared distance are no axes."""

ERROR_BINS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
ORDERS = (
    'best first',
    'ranked anew',
    'axis error',
    'as numbered',
    'random',
    'worst first',
    'greedy',
)
"""Best first is the order of the solver; ranked anew applies it after every projection."""

RANDOM_REPEATS = 3
GREEDY_POINTS = 10
"""The greedy order tries every axis at every step, in fleets up to this size."""

POINTS = (5, 10, 20, 35, 50)
THROUGH = (4, 8, 16, 50)

MOST_SECONDS = 5.0
MOST_RUNS = 7
PATIENCE_S = 3.0


@cache
def cases(names: tuple[str, ...] = CASES) -> list[Case]:
    """Return the cases of these names."""
    return [case for case in all_cases() if case.name in names]


# One axis at a time.


def widths_m(box: FloatArray) -> FloatArray:
    """Return the widths of all distances of a box, in m, a pair at a time."""
    pairs = np.triu_indices(box.shape[1], 1)
    return np.sqrt(box[UPPER][pairs]) - np.sqrt(box[LOWER][pairs])


def gain_bits(before: FloatArray, after: FloatArray) -> float:
    """Return how many times the widths of the pairs were halved in sum."""
    return float(np.log2((widths_m(before) + RESOLVED_M) / (widths_m(after) + RESOLVED_M)).sum())


def relative_errors(box: FloatArray, axes: IntArray) -> FloatArray:
    """Return (upper - lower) / upper of the squared lengths of axes."""
    lower, upper = box[LOWER][tuple(axes.T)], box[UPPER][tuple(axes.T)]
    return 1.0 - lower / upper


def boxes_met(case: Case) -> list[FloatArray]:
    """Return boxes as a search meets them, those left out that turn out to be empty."""
    pruner = Pruner(case.problem, SolverOptions(resolution=case.resolution))
    whole = pruner.whole()
    assert whole is not None
    waiting, met = [whole], []
    while waiting:
        box = waiting.pop()
        pruned = pruner.prune(box)
        if pruned.status is not Status.EMPTY:
            met.append(box)
            waiting += split(pruned, case.resolution)
    return met[:: max(1, -(-len(met) // MOST_BOXES))]


@dataclass
class Bench:
    """A problem with the scratch space to project its boxes."""

    sides: Sides
    axes: IntArray
    groups: Groups
    work: Workspace
    measured: NDArray[np.bool_]
    dimension: int

    @classmethod
    def of(cls, problem: Problem) -> Bench:
        """Return the bench of a problem."""
        return cls(
            sides_of(problem),
            axes_of(problem),
            groups_of(problem.lower, problem.upper),
            make_workspace(problem.n_points, problem.dimension),
            np.isfinite(problem.upper),
            problem.dimension,
        )

    def applied(self, box: FloatArray, axis: IntArray) -> FloatArray:
        """Return a box after the projection along an axis, however badly known that is."""
        n_points = box.shape[1]
        self.work.box[:] = box
        self.work.points[:] = np.arange(n_points)
        a, b = (int(end) for end in axis)
        if self.dimension == 2:
            left = reduction.reduce_plane(self.work, self.sides, n_points, a, b)
        else:
            left = reduction.reduce_space(self.work, self.sides, n_points, a, b)
        assert left, 'a box that holds a placement was found empty'
        return self.work.box.copy()

    def ranked(self, box: FloatArray) -> IntArray:
        """Return the axes of a box in the order of the solver."""
        return rank_axes(box, self.axes)


@dataclass(frozen=True)
class Trial:
    """What one projection gained."""

    dimension: int
    error: float
    length: float
    """In multiples of the median of the box."""
    measured: bool
    bits: float


def trials(case: Case) -> Iterator[Trial]:
    """Project boxes of a case along their axes, each alone."""
    bench = Bench.of(case.problem)
    for box in boxes_met(case):
        axes = bench.axes[:: -(-len(bench.axes) // MOST_AXES_STUDIED)]
        errors = relative_errors(box, axes)
        lengths = np.sqrt(box[UPPER][tuple(axes.T)])
        for axis, error, length in zip(axes, errors, lengths / np.median(lengths), strict=True):
            gained = gain_bits(box, bench.applied(box, axis))
            measured = bool(bench.measured[tuple(axis)])
            yield Trial(case.problem.dimension, float(error), float(length), measured, gained)


def table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ['---'] * len(head), *rows]
    return '\n'.join('| ' + ' | '.join(str(cell) for cell in line) + ' |' for line in lines)


def gain_row(name: str, some: Sequence[Trial]) -> list[str]:
    """Return what a kind of axis gains."""
    if not some:
        return [name, '0', '', '', '']
    bits = np.array([trial.bits for trial in some])
    return [
        name,
        str(len(bits)),
        f'{np.mean(bits > LEAST_GAIN_BITS):.0%}',
        f'{np.median(bits):.2f}',
        f'{bits.mean():.2f}',
    ]


def binned(some: Sequence[Trial]) -> list[list[Trial]]:
    """Sort trials by the relative error of their axis."""
    return [
        [trial for trial in some if low <= trial.error < high or trial.error == high == 1.0]
        for low, high in zip(ERROR_BINS, ERROR_BINS[1:], strict=False)
    ]


def study_axes() -> dict[str, list[Trial]]:
    """Print what an axis gains by its error, its length and whether it was measured."""
    found = {case.name: list(trials(case)) for case in cases()}
    head = ('axes', 'tried', 'gain', 'median (bits)', 'mean (bits)')
    names = [f'{low:g} to {high:g}' for low, high in zip(ERROR_BINS, ERROR_BINS[1:], strict=False)]
    for dimension in (2, 3):
        some = [t for many in found.values() for t in many if t.dimension == dimension]
        rows = [gain_row(name, part) for name, part in zip(names, binned(some), strict=True)]
        known = [t for t in some if t.error < LARGEST_ERROR]
        for name, part in (
            ('known, measured', [t for t in known if t.measured]),
            ('known, not measured', [t for t in known if not t.measured]),
            ('known, short', [t for t in known if t.length < 0.7]),
            ('known, middle', [t for t in known if 0.7 <= t.length <= 1.3]),
            ('known, long', [t for t in known if t.length > 1.3]),
        ):
            rows.append(gain_row(name, part))
        print(f'### axes in {dimension}D, by relative error\n\n{table(head, rows)}\n', flush=True)
    rows = []
    for name, some in found.items():
        total = sum(t.bits for t in some)
        cells = [name, str(len(some))]
        for part in binned(some):
            mean = f'{np.mean([t.bits for t in part]):.2f}' if part else ''
            cells.append(f'{mean} ({sum(t.bits for t in part) / total:.0%})' if part else '')
        rows.append(cells)
    by_error = ('case', 'axes', *names)
    title = '### mean gain in bits (share of all) by error'
    print(f'{title}\n\n{table(by_error, rows)}\n', flush=True)
    return found


# The order of axes.


def fixed_order(name: str, bench: Bench, box: FloatArray, seed: int) -> IntArray:
    """Return the axes of a box in an order that does not depend on what they gain."""
    if name == 'random':
        return np.random.default_rng(seed).permutation(bench.axes)
    if name == 'as numbered':
        return bench.axes
    if name == 'axis error':
        return bench.axes[np.argsort(relative_errors(box, bench.axes), kind='stable')]
    ranked = bench.ranked(box)
    return ranked[::-1] if name == 'worst first' else ranked


def next_best(name: str, bench: Bench, box: FloatArray) -> Iterator[IntArray]:
    """Yield the axes that are best in the state the box then has."""
    left = {tuple(axis) for axis in bench.axes.tolist()}
    while True:
        errors = relative_errors(box, bench.axes)
        fit = {tuple(axis) for axis in bench.axes[errors < LARGEST_ERROR].tolist()} & left
        if not fit:
            return
        usable = [axis for axis in bench.ranked(box) if tuple(axis.tolist()) in fit]
        best = usable[0]
        if name == 'greedy':
            best = max(usable, key=lambda axis: gain_bits(box, bench.applied(box, axis)))
        left.remove(tuple(best.tolist()))
        yield best


def gains_along(name: str, bench: Bench, start: FloatArray, seed: int) -> list[float]:
    """Return the bits gained after 1, 2, ... projections in an order; unfit axes do not count."""
    box = start.copy()
    gains = []
    if name in ('ranked anew', 'greedy'):
        axes: Iterable[IntArray] = next_best(name, bench, box)
    else:
        axes = fixed_order(name, bench, box, seed)
    for axis in axes:
        if is_axis(box, *axis):
            box[:] = bench.applied(box, axis)
            gains.append(gain_bits(start, box))
    return gains


def study_order() -> dict[str, dict[str, list[float]]]:
    """Print the share of a sweep's gain that is reached after some axes, in several orders."""
    shares: dict[str, dict[str, list[float]]] = {}
    rows = []
    for case in cases():
        bench = Bench.of(case.problem)
        n_points = case.problem.n_points
        # One box of a large fleet takes as long as all of a small one.
        boxes = boxes_met(case)[: MOST_BOXES if n_points <= 20 else 1]
        goals = []
        for box in boxes:
            bottom = box.copy()
            for _ in range(3):
                for axis in bench.ranked(bottom):
                    if is_axis(bottom, *axis):
                        bottom = bench.applied(bottom, axis)
            goals.append(gain_bits(box, bottom))
        shares[case.name] = {}
        for name in ORDERS:
            if name == 'greedy' and n_points > GREEDY_POINTS:
                continue
            runs = []
            for goal, box in zip(goals, boxes, strict=True):
                for seed in range(RANDOM_REPEATS if name == 'random' else 1):
                    gains = gains_along(name, bench, box, seed)
                    gains += [gains[-1] if gains else 0.0] * (len(bench.axes) - len(gains))
                    runs.append(np.array(gains) / max(goal, LEAST_GAIN_BITS))
            share = np.mean(runs, axis=0)
            shares[case.name][name] = share.tolist()
            at = (n_points // 2, n_points, 2 * n_points, len(share))
            rows.append([case.name, name, *(f'{share[min(k, len(share)) - 1]:.0%}' for k in at)])
    head = ('case', 'order', 'n/2 axes', 'n', '2n', 'one sweep')
    print(f'### share of the gain of three sweeps\n\n{table(head, rows)}\n', flush=True)
    return shares


# How many points, and through how many.


@kernel
def reduce_through(
    box: FloatArray, points: IntArray, work: Workspace, level: int, a: int, b: int, through: int
) -> bool:
    """Project a plane to the line and back, comparing points through the first `through`."""
    rows = rows_of(work, level)
    left = project(box, rows, points, a, b)
    scratch = work.distance, work.is_open, work.n_open
    if left < 0 or not reduce_line(
        rows.across, *scratch, rows.points[:left], through, -1, work.sigma
    ):
        return False
    return back_project(box, rows, left, a, b)


@kernel
def sweep_through(
    work: Workspace, dimension: int, axes: IntArray, count: int, through: int
) -> int:
    """Apply the axes that are fit to the `count` points known best from each; return how many."""
    box, rows = work.box, rows_of(work, 0)
    n_points = box.shape[1]
    errors = np.empty(n_points)
    applied = 0
    for x in range(len(axes)):
        a, b = axes[x, 0], axes[x, 1]
        if not is_axis(box, a, b):
            continue
        for i in range(n_points):
            errors[i] = relative_error(box, a, i)
            errors[i] += relative_error(box, b, i)
        errors[a] = errors[b] = -1.0
        work.points[:] = np.argsort(errors, kind='mergesort')
        applied += 1
        if dimension == 2:
            reduce_through(box, work.points[:count], work, 0, a, b, through)
            continue
        left = project(box, rows, work.points[:count], a, b)
        for y in range(left - 1):
            if is_axis(rows.across, left - 1, y):
                points = work.in_order[:left]
                reduce_through(rows.across, points, work, 1, left - 1, y, through)
        back_project(box, rows, left, a, b)
    return applied


def study_points() -> None:
    """Print the time and the gain of a first sweep by the number of points and of throughs."""
    for case in cases(LARGE_CASES):
        bench = Bench.of(case.problem)
        (box, *_) = boxes_met(case)
        axes = bench.ranked(box)[: len(bench.groups.edges)]
        unknown = ~bench.measured[np.triu_indices(case.problem.n_points, 1)]
        sweep_through(bench.work, bench.dimension, axes[:0], 0, 0)
        rows = []
        for count in POINTS:
            for through in THROUGH:
                if count > case.problem.n_points or through > max(count, THROUGH[0]) > THROUGH[0]:
                    continue
                seconds = []
                for _ in range(3):
                    bench.work.box[:] = box
                    begin = time.process_time()
                    applied = sweep_through(bench.work, bench.dimension, axes, count, through)
                    seconds.append(time.process_time() - begin)
                after = bench.work.box
                rows.append(
                    [
                        count,
                        min(through, count),
                        applied,
                        f'{1e6 * min(seconds) / applied:.0f}',
                        f'{gain_bits(box, after) / unknown.sum():.2f}',
                        f'{np.median(widths_m(after)[unknown]):.2f}',
                    ]
                )
        head = ('points', 'through', 'axes', 'µs/axis', 'bits/unknown pair', 'median width (m)')
        print(f'### first sweep of {case.name}\n\n{table(head, rows)}\n', flush=True)


# Whole searches with one choice changed.


@kernel
def reduce_space_off_faces(work: Workspace, sides: Sides, count: int, a: int, b: int) -> bool:
    """Project space along (a, b) to a plane, reduce that along axes off (a, b), and return."""
    rows = rows_of(work, 0)
    left = project(work.box, rows, work.points[:count], a, b)
    if left < 0:
        return False
    for x in range(left - 1):
        for y in range(x + 1, left - 1):
            if is_axis(rows.across, x, y) and not reduction.reduce_projected_plane(
                work, sides, work.in_order[:left], x, y, reduction.NO_FACE
            ):
                return False
    return back_project(work.box, rows, left, a, b)


def skip_axes(*_: Any) -> bool:
    """Leave a box as it is."""
    return True


def explain_only(*arguments: Any) -> bool:
    """Return what the errors explain, so that the search ends where it does; narrow nothing."""
    *groups, box, dimension, explained = arguments
    combine(*(*groups, box.copy(), dimension, explained))
    return True


def rank_as_numbered(_: FloatArray, axes: IntArray) -> IntArray:
    """Leave the axes in the order of their numbers."""
    return axes


def setting(module: Any, name: str, value: Any) -> Callable[[], None]:
    """Return what changes one choice of a module."""
    return lambda: setattr(module, name, value)


def without_local_sweeps() -> tuple[tuple[fixed_point.Schedule, ...], ...]:
    """Return the schedules without the sweeps that project only some points."""
    return tuple(
        tuple(schedule._replace(local=()) for schedule in schedules)
        for schedules in fixed_point.SCHEDULES
    )


SPACE_CASES = tuple(name for name in CASES if name.startswith(('octahedral', 'random3d')))
VARIANTS: dict[str, tuple[Callable[[], None], tuple[str, ...]]] = {
    'as it is': (lambda: None, CASES),
    'any axis (ratio 0)': (setting(projection, 'LEAST_AXIS_RATIO', 0.0), CASES),
    'good axes only (ratio 0.7)': (setting(projection, 'LEAST_AXIS_RATIO', 0.7), CASES),
    'axes as numbered': (setting(fixed_point, 'rank_axes', rank_as_numbered), CASES),
    'faces only': (setting(reduction, 'SMALL_FLEET', 0), SPACE_CASES),
    'all inner axes': (setting(reduction, 'SMALL_FLEET', 10**6), SPACE_CASES),
    'inner axes off faces': (
        setting(reduction, 'reduce_space', reduce_space_off_faces),
        SPACE_CASES,
    ),
    'through 8 points': (setting(reduction, 'MOST_THROUGH', 8), LARGE_CASES),
    'no local sweep': (setting(fixed_point, 'SCHEDULES', without_local_sweeps()), LARGE_CASES),
    'no combinations': (setting(fixed_point, 'combine', explain_only), CASES),
    'no projections': (setting(fixed_point, 'apply_axes', skip_axes), CASES),
}


def unknown_width_m(problem: Problem, result: Result) -> float:
    """Return the mean width of the distances that were not measured, in m."""
    rows, columns = np.triu_indices(problem.n_points, 1)
    unknown = np.isinf(problem.upper[rows, columns])
    return float(
        np.mean(
            [
                np.sqrt(hypothesis.upper[rows, columns][unknown])
                - np.sqrt(hypothesis.lower[rows, columns][unknown])
                for hypothesis in result.hypotheses
            ]
        )
    )


def measure(case: Case) -> dict[str, Any]:
    """Solve a case as often as patience allows; times are those of the processor."""
    options = SolverOptions(case.resolution, max_boxes=2000, max_seconds=MOST_SECONDS)
    solve(case.problem, options)
    seconds: list[float] = []
    while len(seconds) < MOST_RUNS and sum(seconds) < PATIENCE_S:
        begin = time.process_time()
        result = solve(case.problem, options)
        seconds.append(time.process_time() - begin)
    return {
        'case': case.name,
        'ms': 1e3 * min(seconds),
        'verdict': result.verdict.name,
        'boxes': result.statistics.processed,
        'empty': result.statistics.empty,
        'hypotheses': len(result.hypotheses),
        'width': unknown_width_m(case.problem, result),
    }


def run_variant(name: str) -> None:
    """Change one choice, solve its cases and print what came of it, a line each."""
    change, names = VARIANTS[name]
    change()
    for case in cases(names):
        print(json.dumps(measure(case)), flush=True)


def study_variants(names: Sequence[str]) -> None:
    """Print what whole searches make of each choice."""
    rows = []
    for name in names:
        with tempfile.TemporaryDirectory() as cache:
            done = subprocess.run(
                [sys.executable, '-m', 'benchmarks.projections', 'variants', '--variant', name],
                env={**os.environ, 'NUMBA_CACHE_DIR': cache},
                check=True,
                stdout=subprocess.PIPE,
                text=True,
            )
        for line in done.stdout.splitlines():
            found = json.loads(line)
            late = '' if found['verdict'] == 'COVERED' else ' ' + found['verdict'].lower()
            boxes = f'{found["boxes"]} ({found["empty"]})'
            rows.append(
                [
                    found['case'],
                    name,
                    f'{found["ms"]:.3g}{late}',
                    boxes,
                    found['hypotheses'],
                    f'{found["width"]:.3g}',
                ]
            )
    rows.sort(key=lambda row: CASES.index(row[0]))
    head = ('case', 'choice', 'ms', 'boxes (empty)', 'hypotheses', 'mean unknown width (m)')
    print(f'### whole searches\n\n{table(head, rows)}\n', flush=True)


def draw(
    found: dict[str, list[Trial]], shares: dict[str, dict[str, list[float]]], path: Path
) -> None:
    """Draw gain against error, and gain against the number of axes in several orders."""
    import matplotlib

    matplotlib.use('Agg')
    from matplotlib import pyplot

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11.0, 4.4), layout='constrained')
    for dimension, color in ((2, '#0072B2'), (3, '#D55E00')):
        some = [t for many in found.values() for t in many if t.dimension == dimension]
        left.plot(
            [t.error for t in some],
            [max(t.bits, 1e-3) for t in some],
            '.',
            color=color,
            markersize=3,
            alpha=0.35,
            label=f'{dimension}D',
        )
    left.axvline(LARGEST_ERROR, color='black', linestyle='--', linewidth=1.0)
    left.set_yscale('log')
    left.set_xlabel('relative error of the squared axis')
    left.set_ylabel('gain of one projection (bits)')
    left.set_title('an axis alone')
    left.legend(markerscale=4.0)
    colors = ('#0072B2', 'black', '#009E73', '#E69F00', '0.5', '#D55E00')
    for name, color in zip(ORDERS[:-1], colors, strict=True):
        curves = [
            np.interp(
                np.linspace(0.0, 3.0, 61), np.arange(len(c) + 1) / n_points_of(case), [0, *c]
            )
            for case, by_order in shares.items()
            if case in DRAWN and (c := by_order.get(name)) is not None
        ]
        right.plot(np.linspace(0.0, 3.0, 61), np.mean(curves, axis=0), color=color, label=name)
    right.set_xlabel('projections per point')
    right.set_ylabel('share of the gain of three sweeps')
    right.set_ylim(0.0, 1.0)
    right.set_title('axes in several orders, mean of five random fleets')
    right.legend()
    figure.savefig(path, dpi=110)
    pyplot.close(figure)


def n_points_of(name: str) -> int:
    """Return the number of points of a case."""
    (case,) = cases((name,))
    return case.problem.n_points


def main() -> None:
    """Run the studies asked for."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.projections', description=__doc__)
    parser.add_argument('studies', nargs='+', choices=('axes', 'order', 'points', 'variants'))
    parser.add_argument(
        '--picture', type=Path, help='draws axes and order, both of them asked for'
    )
    parser.add_argument('--only', action='append', choices=tuple(VARIANTS), metavar='VARIANT')
    parser.add_argument('--variant', choices=tuple(VARIANTS), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.variant:
        run_variant(options.variant)
        return
    found = study_axes() if 'axes' in options.studies else None
    shares = study_order() if 'order' in options.studies else None
    if 'points' in options.studies:
        study_points()
    if 'variants' in options.studies:
        study_variants(options.only or tuple(VARIANTS))
    if options.picture and found and shares:
        draw(found, shares, options.picture)


if __name__ == '__main__':
    main()
