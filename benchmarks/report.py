# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Tables and verdicts, in Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
import os
from pathlib import Path
import platform

from benchmarks.cases import Case
from benchmarks.contest import SOLVER, Figure, Row

PACKAGES = ('numpy', 'numba', 'scipy', 'codac', 'pyscipopt')
HEADER = (
    '',
    'ms (min)',
    'x ours',
    'boxes (empty)',
    'found',
    'hypotheses',
    'width (median)',
    'remark',
)


@dataclass(frozen=True)
class Verdict:
    """One aim of a case, what was measured, and whether it was met."""

    what: str
    aim: str
    measured: str
    met: bool

    def __str__(self) -> str:
        return f'{"met" if self.met else "MISSED"}: {self.what} {self.measured}, aim {self.aim}'


def machine() -> str:
    """Return the processor, its cores, the system and the versions of what was run."""
    model = next(
        (
            line.split(':', 1)[1].strip()
            for line in Path('/proc/cpuinfo').read_text().splitlines()
            if line.startswith('model name')
        )
        if Path('/proc/cpuinfo').exists()
        else iter(()),
        platform.processor() or 'unknown processor',
    )
    cores, load = os.cpu_count() or 1, os.getloadavg()[0]
    busy = ' (BUSY: the times below are too long)' if load > 0.75 * cores else ''
    return '\n'.join(
        [
            f'{model}, {cores} cores, load {load:.1f}{busy}; {platform.platform()}',
            f'Python {platform.python_version()}, ' + ', '.join(map(_version, PACKAGES)),
        ]
    )


def _version(package: str) -> str:
    try:
        return f'{package} {version(package)}'
    except PackageNotFoundError:
        return f'no {package}'


def milliseconds(seconds: float) -> str:
    """Return a time in ms with three significant digits."""
    value = seconds * 1e3
    return f'{value:.0f}' if value >= 100.0 else f'{value:.3g}'


def table(header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Return an aligned Markdown table."""
    cells = [list(header), *map(list, lines)]
    widths = [max(3, *(len(line[column]) for line in cells)) for column in range(len(header))]
    cells.insert(1, ['-' * width for width in widths])
    return '\n'.join(
        '| ' + ' | '.join(cell.ljust(w) for cell, w in zip(line, widths, strict=True)) + ' |'
        for line in cells
    )


def _cells(row: Row, own: Row, known: int) -> list[str]:
    timing, scored = row.timing, row.score
    runs = f', {timing.runs} runs' if timing and timing.runs < 7 else ''
    width = ''
    if scored and scored.widest is not None and scored.typical is not None:
        width = f'{scored.widest:.3f} ({scored.typical:.3f})' + (' CUT' if scored.cut else '')
    return [
        row.who,
        f'{milliseconds(timing.median)} ({milliseconds(timing.minimum)}{runs})' if timing else '',
        f'{timing.median / own.timing.median:.2g}' if timing and own.timing else '',
        '' if row.boxes is None else f'{row.boxes}' + _bracketed(row.empty),
        '' if scored is None else f'{scored.found} of {known}',
        '' if row.hypotheses is None else f'{row.hypotheses}',
        width,
        row.remark,
    ]


def _bracketed(number: int | None) -> str:
    return '' if number is None else f' ({number})'


def _own(rows: Iterable[Row]) -> Row:
    return next(row for row in rows if row.who == SOLVER)


def best_codac(case: Case, rows: Iterable[Row]) -> Row | None:
    """Return Codac's fastest formulation that found everything, None when there is none."""
    valid = [
        row
        for row in rows
        if row.who.startswith('codac')
        and row.timing
        and row.score
        and row.score.found == len(case.placements)
        and not row.score.cut
    ]
    return min(valid, key=lambda row: row.timing.median if row.timing else 0.0, default=None)


def speedup(case: Case, rows: Sequence[Row]) -> float | None:
    """Return how many times faster the solver is than the best of Codac, by medians."""
    own = _own(rows)
    best = best_codac(case, rows)
    if best is None or best.timing is None or own.timing is None:
        return None
    return best.timing.median / own.timing.median


def verdicts(case: Case, rows: Sequence[Row]) -> Iterator[Verdict]:
    """Compare the solver's row with the targets of a case."""
    own = _own(rows)
    target = case.target
    if own.score is None or own.timing is None:
        yield Verdict('answer', 'one', own.remark, False)
        return
    known = len(case.placements)
    yield Verdict('found', f'{known}', f'{own.score.found}', own.score.found == known)
    if case.hull == 'exact':
        held = 'no' if own.score.cut else 'yes'
        yield Verdict('exact hulls contained', 'yes', held, not own.score.cut)
    if target.seconds is not None:
        aim, measured = f'{milliseconds(target.seconds)} ms', milliseconds(own.timing.median)
        yield Verdict('time', aim, f'{measured} ms', own.timing.median <= target.seconds)
    for what, aimed, got in (
        ('boxes', target.boxes, own.boxes),
        ('empty boxes', target.empty, own.empty),
    ):
        if aimed is not None and got is not None:
            yield Verdict(what, f'at most {aimed}', f'{got}', got <= aimed)
    if target.hypotheses is not None:
        got = own.hypotheses
        yield Verdict('hypotheses', f'{target.hypotheses}', f'{got}', got == target.hypotheses)
    if target.width is not None and own.score.widest is not None:
        widest = own.score.widest
        met = widest <= target.width
        yield Verdict(f'width / {case.hull}', f'{target.width:g}', f'{widest:.3f}', met)
    factor = speedup(case, rows)
    if target.speedup is not None and factor is not None:
        met = factor >= target.speedup
        yield Verdict('faster than Codac', f'{target.speedup:g} x', f'{factor:.2g} x', met)


def case_report(case: Case, rows: Sequence[Row]) -> str:
    """Return the table of a case and its verdicts."""
    lines = [f'### {case.name}: {case.title}', '']
    own, known = _own(rows), len(case.placements)
    lines.append(table(HEADER, [_cells(row, own, known) for row in rows]))
    lines.append('')
    lines += [f'- {verdict}' for verdict in verdicts(case, rows)]
    return '\n'.join(lines) + '\n'


def summary(results: Sequence[tuple[Case, Sequence[Row]]]) -> str:
    """Return one line per case."""
    lines = []
    for case, rows in results:
        own = _own(rows)
        best, factor = best_codac(case, rows), speedup(case, rows)
        missed = [verdict.what for verdict in verdicts(case, rows) if not verdict.met]
        milli, _, *scores, _ = _cells(own, own, len(case.placements))[1:]
        codac = milliseconds(best.timing.median) if best and best.timing else ''
        ratio = f'{factor:.2g} x' if factor else ''
        verdict = 'missed: ' + ', '.join(missed) if missed else 'all met'
        lines.append([case.name, milli, *scores, codac, ratio, verdict])
    header = ('case', HEADER[1], *HEADER[3:7], 'Codac ms', 'faster', 'targets')
    return table(header, lines)


def figures_report(title: str, figures: Sequence[Figure]) -> str:
    """Return the table of some figures."""
    verdict = {True: 'met', False: 'MISSED', None: ''}
    lines = [[figure.what, figure.value, figure.aim, verdict[figure.met]] for figure in figures]
    return f'### {title}\n\n' + table(('', 'measured', 'aim', ''), lines) + '\n'
