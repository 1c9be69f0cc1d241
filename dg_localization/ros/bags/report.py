# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The report on a whole bag: answers are counted at every tick and summed up at the end.

A report is a dictionary of plain values, which is written as JSON. `parts` converts it to
paragraphs and tables, which become Markdown or HTML.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import timedelta
import json
import math
import re
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, LinkKind
from dg_localization.ros.bags.offline import Recording
from dg_localization.ros.interface.diagnostics import key_of_topic
from dg_localization.ros.interface.intake import Intake
from dg_localization.solver.result import Verdict
from msg_adapters import Level, Status

Tree: TypeAlias = dict[str, Any]

NUMBER = re.compile(r'\d[\d.]*')

ROWS = 30
"""Most rows of statuses that the node would publish."""


class Tally:
    """Counts estimates by their contents; `tree` returns the sums."""

    def __init__(self, robots: tuple[str, ...]) -> None:
        self.ticks = 0
        self.last_s = 0.0
        self._hypotheses: Counter[int] = Counter()
        self._verdicts: Counter[str] = Counter()
        self._contradictions, self._forgotten, self._said = Runs(), Runs(), Runs()
        self._robots, self._widths_m = robots, list[NDArray[np.float64]]()
        # Of messages that differ only in their numbers the first is shown.
        self._wording: dict[tuple[str, str], str] = {}

    def add(self, estimate: Estimate, time_s: float, statuses: Iterable[Status] = ()) -> None:
        """Count an estimate and its statuses, at a time from the start of the bag."""
        self.ticks += 1
        self.last_s = time_s
        self._hypotheses[estimate.n_hypotheses] += 1
        self._verdicts[estimate.verdict.value if estimate.verdict else 'none'] += 1
        for placement in estimate.placements:
            self._widths_m.append(np.ptp(placement.enclosure_m, axis=1).max(axis=1))
        for forgotten in estimate.forgotten:
            self._forgotten.add(self.ticks, time_s, why=forgotten.text)
        # Inputs may contradict each other even if some could be dropped.
        if estimate.verdict is Verdict.INFEASIBLE or estimate.conflicts:
            conflicts = tuple(tuple(map(str, conflict)) for conflict in estimate.conflicts)
            self._contradictions.add(self.ticks, time_s, conflicts=conflicts)
        for status in statuses:
            if status.level is not Level.OK:
                name = status.name.partition(': ')[2]
                key = name, NUMBER.sub('#', status.message)
                text = self._wording.setdefault(key, status.message)
                self._said.add(self.ticks, time_s, status=name, message=text)

    def tree(self) -> Tree:
        """Return the sums; a width is None if most enclosures are unbounded, or there are none."""
        # The lower one of two: a finite and an infinite width have no mean.
        of_none = [np.full(len(self._robots), np.inf)]
        widths_m = np.percentile(self._widths_m or of_none, 50.0, axis=0, method='lower')
        return {
            'ticks': self.ticks,
            'ticks_by_hypotheses': _counts(self._hypotheses),
            'ticks_by_verdict': _counts(self._verdicts),
            'median_enclosure_width_m': {
                robot: width_m if math.isfinite(width_m) else None
                for robot, width_m in zip(self._robots, widths_m.tolist(), strict=True)
            },
            'contradictions': self._contradictions,
            'forgotten': self._forgotten,
            'said': self._said,
        }


class Runs(list[Tree]):
    """Runs of consecutive ticks with a common value, in the order of their beginnings."""

    def __init__(self) -> None:
        super().__init__()
        self._open: dict[tuple[Any, ...], tuple[int, Tree]] = {}

    def add(self, tick: int, at_s: float, **what: Any) -> None:
        """Extend the run that ended with the tick before, or begin one."""
        key = tuple(what.values())
        number, run = self._open.get(key, (-2, {}))
        if number == tick - 1:
            run['last_s'], run['ticks'] = at_s, run['ticks'] + 1
        else:
            run = {**what, 'first_s': at_s, 'last_s': at_s, 'ticks': 1}
            self.append(run)
        self._open[key] = tick, run


def inputs_tree(recording: Recording, intake: Intake, now_s: float) -> Tree:
    """Return the counts of each input, and the sums over all inputs."""
    rows, links, states = [], recording.links.values(), intake.states(now_s)
    with_topic = {link.key for link in links}
    accepted, rejected = 0, Counter[str]()
    for key in sorted({*states, *with_topic}):
        state = states.get(key)
        reasons = {reason.value: n for reason, n in state.rejected.items()} if state else {}
        came_by = key_of_topic(key, with_topic)
        row: Tree = {
            'input': str(key),
            'topics': [link.topic for link in links if link.key == came_by],
            'accepted': state.accepted if state else 0,
            'rejected': _counts(reasons),
            'last_rejection': state.last_reason_text if state else '',
        }
        rows.append(row)
        # Readings of peers count as peers, not once more as ranges and rays.
        if key in with_topic or key.kind is LinkKind.PEERS:
            accepted += row['accepted']
            rejected.update(reasons)
    rejected['malformed'] = sum(wrong.count for wrong in intake.malformed.values())
    rejected['unreadable'] = recording.reading.unreadable.total()
    return {
        'accepted': accepted,
        'rejected': _counts(+rejected),
        'inputs': rows,
        'malformed_by_topic': {
            topic: {'messages': wrong.count, 'last': wrong.last}
            for topic, wrong in sorted(intake.malformed.items())
        },
        'unreadable_by_topic': dict(recording.reading.unreadable),
    }


def _counts(counts: Mapping[Any, int]) -> dict[str, int]:
    return {str(key): counts[key] for key in sorted(counts)}


def as_json(tree: Tree) -> str:
    """Return a report for programs; null means unbounded or missing."""
    return json.dumps(tree, indent=2, allow_nan=False) + '\n'


class Sheet(NamedTuple):
    """A table of a report: the names of its columns, and its rows."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]


def as_markdown(title: str, parts: Iterable[str | Sheet]) -> str:
    """Return a report as Markdown whose tables are readable as plain text."""
    texts = [f'# {title}']
    for part in parts:
        if isinstance(part, str):
            texts.append(part)
        elif part.rows:
            rows = [tuple(map(str, row)) for row in (part.columns, *part.rows)]
            wide = [max(map(len, column)) for column in zip(*rows, strict=True)]
            rows.insert(1, tuple('-' * width for width in wide))
            lines = [' | '.join(map(str.ljust, row, wide)) for row in rows]
            texts.append('\n'.join(f'| {line} |' for line in lines))
    return '\n\n'.join(filter(None, texts)) + '\n'


def parts(tree: Tree) -> Iterator[str | Sheet]:
    """Yield the paragraphs and the tables of a report."""
    yield (
        f'{_ticks(tree["ticks"])} at {tree["rate_hz"]:g} Hz, from {tree["start_s"]:.1f} to '
        f'{tree["end_s"]:.1f} s of the bag.'
    )
    yield tree['ending']
    if tree['damage']:
        yield f'The bag is damaged: {"; ".join(tree["damage"])}.'
    yield Sheet(('hypotheses', 'ticks'), [*tree['ticks_by_hypotheses'].items()])
    yield Sheet(('verdict', 'ticks'), [*tree['ticks_by_verdict'].items()])
    if at_budget := tree['ticks_by_verdict'].get(Verdict.OUT_OF_BUDGET.value):
        yield (
            f'The search of {_ticks(at_budget)} ended at solver.max_boxes, {tree["max_boxes"]} '
            'boxes: no placement is lost, but a longer search may leave less.'
        )
    yield Sheet(
        ('robot', 'median width of its enclosure'),
        [(robot, width_text(tree, robot)) for robot in tree['median_enclosure_width_m']],
    )
    if tree['truth']:
        yield from truth_parts(tree['truth'])
    rejected = tree['rejected']
    yield f'{tree["accepted"]} measurements were taken, {sum(rejected.values())} rejected.'
    yield Sheet(('rejected because', 'measurements'), [*rejected.items()])
    yield Sheet(
        ('could not be read', 'because'),
        [
            (topic, f'{wrong["last"]} ({wrong["messages"]} messages)')
            for topic, wrong in tree['malformed_by_topic'].items()
        ],
    )
    yield from _over_time(tree)
    yield from tree['notices']


def width_text(tree: Tree, robot: str) -> str:
    """Return a text on the widths of the enclosures of a robot."""
    width_m = tree['median_enclosure_width_m'][robot]
    if tree['ticks_by_hypotheses'].keys() <= {'0'}:
        return 'no placement'
    return 'not bounded' if width_m is None else f'{width_m:.2f} m'


def _over_time(tree: Tree) -> Iterator[str | Sheet]:
    """Yield the events over time: contradictions, forgotten observations, statuses."""
    found = spans(tree['contradictions'], 'conflicts')
    if not found:
        yield 'No measurements of one moment were found to contradict each other.'
    rows = [
        (when, '; '.join(', '.join(conflict) for conflict in conflicts) or 'not found')
        for (conflicts,), when in found.items()
    ]
    yield Sheet(('contradiction', 'between'), rows)
    forgotten = spans(tree['forgotten'], 'why')
    yield Sheet(('forgotten because', 'at'), [(why, when) for (why,), when in forgotten.items()])
    # Statuses with the same text at the same times share a row.
    names: dict[tuple[str, str], list[str]] = {}
    for (name, text), when in spans(tree['said'], 'status', 'message').items():
        names.setdefault((text, when), []).append(name)
    said = [(f'{", ".join(found)}: {text}', when) for (text, when), found in names.items()]
    yield Sheet(('the node says', 'at'), said[:ROWS])
    if len(said) > ROWS:
        yield f'A report in JSON has {len(said) - ROWS} more rows.'


def truth_parts(truth: Tree) -> Iterator[str | Sheet]:
    """Yield the comparison of the answers with a ground truth."""
    if truth['without_truth']:
        yield f'There is no ground truth of {", ".join(truth["without_truth"])}.'
    gaps = ' Between samples that are more than 1 s apart no truth is known.'
    gaps = gaps if truth['uncompared'] else ''
    if not truth['compared']:
        yield f'No answer has a ground truth at its time.{gaps} {truth["apart"]}'.rstrip()
        return
    text = f'The truth is inside a hypothesis in {truth["held"]} of {truth["compared"]} answers.'
    for name, sentence in (
        ('infeasible', 'have no placement at all: the measurements contradict each other'),
        ('unlisted', 'have more hypotheses than max_hypotheses, which were not compared'),
        ('uncompared', 'have no ground truth at their time'),
    ):
        text += f' {truth[name]} answers {sentence}.' if truth[name] else ''
    yield text + gaps
    missed = spans(truth['missed'], 'robots')
    yield Sheet(
        ('truth outside', 'of'),
        [(when, ', '.join(robots)) for (robots,), when in missed.items()],
    )
    if stated := truth['consistency']:
        yield (
            f'{100.0 * stated["beyond_3_deviations"]:.1f} % of coordinates and headings are off '
            f'by more than three deviations; the median NEES is {stated["median_nees"]:.2f}.'
        )
    rows = []
    for robot, kinds in truth['errors'].items():
        texts = [
            f'{error["median"]:.2f} {name.rpartition("_")[2]} ({error["percentile_95"]:.2f})'
            for name, error in kinds.items()
        ]
        rows += [(robot, ', '.join(texts))] if texts else []
    yield Sheet(('robot', 'off the truth in the nearest hypothesis, median (95 %)'), rows)


def spans(runs: Iterable[Tree], *names: str) -> dict[tuple[Any, ...], str]:
    """Return the times of runs as text, by their common values."""
    by_key: dict[tuple[Any, ...], list[Tree]] = {}
    for run in runs:
        by_key.setdefault(tuple(run[name] for name in names), []).append(run)
    texts = {}
    for key, found in by_key.items():
        count = _ticks(sum(run['ticks'] for run in found))
        parted = f' in {len(found)} parts' if len(found) > 1 else ''
        texts[key] = f'{found[0]["first_s"]:.1f} to {found[-1]["last_s"]:.1f} s ({count}{parted})'
    return texts


def gap_text(first_s: float, last_s: float) -> str:
    """Return a sentence on a time without messages from any input."""
    span, lasts = f'{first_s:.1f} to {last_s:.1f} s', timedelta(seconds=round(last_s - first_s))
    return f'Nothing was received from {span} of the bag ({lasts}): this gap is skipped.'


def _ticks(number: int) -> str:
    return '1 tick' if number == 1 else f'{number} ticks'
