# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The report on a whole bag: its answers are counted tick by tick and summed up at the end."""

from array import array
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
import json
import math
import re
from statistics import median_low
from typing import Any

from dg_localization.fleet import Conflict, Estimate, InputState, LinkKey, LinkKind
from dg_localization.ros.bags.tables import Runs, table, ticks
from dg_localization.ros.bags.truth_tally import TruthTally, truth_paragraphs, truth_tree
from dg_localization.ros.interface.diagnostics import Malformed
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from dg_localization.solver.result import Verdict
from msg_adapters import Level, Status

WITHOUT_CHECKSUMS = (
    'Not all of its messages have checksums: a flipped bit in a message would not be noticed.'
)


NUMBER = re.compile(r'\d[\d.]*')

ROWS = 30
"""So many rows of what the node would say are shown."""


class Tally:
    """
    Counts estimates by what they contain.

    Attributes
    ----------
    ticks : int
        Estimates so far.
    last_s : float
        Time of the last one, from the start of the bag.
    hypotheses : Counter of int
        How many ticks had so many hypotheses.
    verdicts : Counter of str
        How many ticks had this verdict; 'none' where there was nothing to solve.
    contradictions : Runs of tuple of tuple of LinkKey
        Sets of inputs that contradict each other; empty when none was found in time.
    forgotten : Runs of str
        Why something that was remembered was forgotten: some bound was broken.
    said : Runs of (str, str)
        What the node would say that is no good news: name of the status, and message.
    gaps : list of (float, float)
        Times without any message of an input, from the start of the bag.

    """

    def __init__(self, robots: tuple[str, ...]) -> None:
        self.ticks = 0
        self.last_s = 0.0
        self.hypotheses: Counter[int] = Counter()
        self.verdicts: Counter[str] = Counter()
        self.contradictions: Runs[tuple[Conflict, ...]] = Runs()
        self.forgotten: Runs[str] = Runs()
        self.said: Runs[tuple[str, str]] = Runs()
        self.gaps: list[tuple[float, float]] = []
        self._widths_m = {robot: array('d') for robot in robots}
        # Of messages that differ in their numbers the first is shown.
        self._wording: dict[tuple[str, str], tuple[str, str]] = {}

    def add(self, estimate: Estimate, time_s: float, statuses: Iterable[Status] = ()) -> None:
        """Count an estimate for a time from the start of the bag, and what the node would say."""
        self.ticks += 1
        self.last_s = time_s
        self.hypotheses[estimate.n_hypotheses] += 1
        self.verdicts[estimate.verdict.value if estimate.verdict else 'none'] += 1
        for placement in estimate.placements:
            sides_m = placement.enclosure_m[:, 1] - placement.enclosure_m[:, 0]
            for robot, width_m in zip(estimate.robots, sides_m.max(axis=1), strict=True):
                self._widths_m[robot].append(float(width_m))
        for forgotten in estimate.forgotten:
            self.forgotten.add(forgotten.text, self.ticks, time_s)
        # Inputs may contradict each other also where some could be dropped.
        if estimate.verdict is Verdict.INFEASIBLE or estimate.conflicts:
            self.contradictions.add(estimate.conflicts, self.ticks, time_s)
        for status in statuses:
            if status.level is not Level.OK:
                name = status.name.partition(': ')[2]
                key = name, NUMBER.sub('#', status.message)
                what = self._wording.setdefault(key, (name, status.message))
                self.said.add(what, self.ticks, time_s)

    def add_gap(self, first_s: float, last_s: float) -> None:
        """Add a time without any message of an input."""
        self.gaps.append((first_s, last_s))

    def median_widths_m(self) -> dict[str, float]:
        """
        Return for each robot the median over all placements of the longest side of its enclosure.

        It is infinite where most enclosures are not bounded, and NaN without a placement.
        """
        # The lower one of two: a finite and an infinite width have no mean.
        return {
            robot: median_low(widths_m) if widths_m else math.nan
            for robot, widths_m in self._widths_m.items()
        }


@dataclass(frozen=True)
class BagReport:
    """
    The summary of a bag; nothing in it depends on the machine.

    Attributes
    ----------
    bag : str
        Its name.
    start_s, end_s : float
        What was read, from the start of the bag.
    rate_hz : float
        Ticks in a second of the bag.
    ending : str
        Why it ended before `end_s`; empty when it did not.
    tally : Tally
        The estimates.
    links : sequence of Link
        The inputs.
    states : mapping of LinkKey to InputState
        What they delivered.
    malformed : mapping of str to Malformed
        By topic, the messages that could not be read.
    unreadable : mapping of str to int
        By topic, the messages whose bytes are damaged.
    notices : sequence of str
        Topics that were passed over, a sentence each.
    damage : sequence of str
        What is wrong with the bag, a sentence each.
    checksums : bool
        Whether checksums protect all of its messages.
    max_boxes : int
        The budget of one answer.
    truth : TruthTally or None
        The answers beside a ground truth; None without one.

    """

    bag: str
    start_s: float
    end_s: float
    rate_hz: float
    ending: str
    tally: Tally
    links: Sequence[Link]
    states: Mapping[LinkKey, InputState]
    malformed: Mapping[str, Malformed]
    unreadable: Mapping[str, int]
    notices: Sequence[str]
    damage: Sequence[str]
    checksums: bool
    max_boxes: int
    truth: TruthTally | None = None

    @property
    def gap_texts(self) -> list[str]:
        """Sentences on the gaps of the recording."""
        return [
            f'Nothing was received from {first_s:.1f} to {last_s:.1f} s of the bag '
            f'({_duration_text(last_s - first_s)}): this gap is skipped.'
            for first_s, last_s in self.tally.gaps
        ]

    @property
    def at_budget(self) -> int:
        """Ticks whose search ended at the budget."""
        return self.tally.verdicts[Verdict.OUT_OF_BUDGET.value]

    @property
    def rejected(self) -> Counter[str]:
        """Measurements that were not taken, by reason."""
        rejected: Counter[str] = Counter()
        for state in self._delivered:
            for reason, count in state.rejected.items():
                rejected[reason.value] += count
        rejected['malformed'] = sum(wrong.count for wrong in self.malformed.values())
        rejected['unreadable'] = sum(self.unreadable.values())
        return +rejected

    @property
    def accepted(self) -> int:
        """Measurements that were taken."""
        return sum(state.accepted for state in self._delivered)

    @property
    def _delivered(self) -> list[InputState]:
        """What came by topics: of peers the sum, not each once more."""
        with_topic = {link.key for link in self.links}
        # Messages that name their observer themselves are peers of whoever that is.
        named = any(key.observer == ANY_OBSERVER for key in with_topic)
        return [
            state
            for key, state in self.states.items()
            if key in with_topic or (named and key.kind is LinkKind.PEERS)
        ]


def as_json(report: BagReport) -> str:
    """Return a report for programs; null stands for what is not bounded or not there."""
    tally = report.tally
    tree = {
        'bag': report.bag,
        'start_s': report.start_s,
        'end_s': report.end_s,
        'rate_hz': report.rate_hz,
        'ending': report.ending,
        'damage': list(report.damage),
        'checksums': report.checksums,
        'max_boxes': report.max_boxes,
        'ticks': tally.ticks,
        'ticks_by_hypotheses': _sorted(tally.hypotheses),
        'ticks_by_verdict': _sorted(tally.verdicts),
        'median_enclosure_width_m': {
            robot: width_m if math.isfinite(width_m) else None
            for robot, width_m in tally.median_widths_m().items()
        },
        'accepted': report.accepted,
        'rejected': _sorted(report.rejected),
        'inputs': [
            _input_tree(report, key)
            for key in sorted({*report.states, *(link.key for link in report.links)})
        ],
        'malformed_by_topic': {topic: wrong.count for topic, wrong in report.malformed.items()},
        'unreadable_by_topic': dict(report.unreadable),
        'contradictions': [
            {
                'first_s': found.first_s,
                'last_s': found.last_s,
                'ticks': found.ticks,
                'conflicts': [[str(key) for key in conflict] for conflict in found.what],
            }
            for found in tally.contradictions
        ],
        'truth': truth_tree(report.truth) if report.truth else None,
        'forgotten': [{'at_s': run.first_s, 'why': run.what} for run in tally.forgotten],
        'said': [
            {
                'status': run.what[0],
                'message': run.what[1],
                'first_s': run.first_s,
                'last_s': run.last_s,
                'ticks': run.ticks,
            }
            for run in tally.said
        ],
        'gaps': [{'first_s': first_s, 'last_s': last_s} for first_s, last_s in tally.gaps],
        'notices': [*report.notices, *report.gap_texts],
    }
    return json.dumps(tree, indent=2, allow_nan=False) + '\n'


def _input_tree(report: BagReport, key: LinkKey) -> dict[str, Any]:
    state = report.states.get(key)
    rejected = {reason.value: n for reason, n in state.rejected.items()} if state else {}
    return {
        'input': str(key),
        'topics': [link.topic for link in report.links if link.key == key],
        'accepted': state.accepted if state else 0,
        'rejected': _sorted(rejected),
        'last_rejection': state.last_reason_text if state else '',
    }


def _sorted(counts: Mapping[Any, int]) -> dict[str, int]:
    return {str(key): counts[key] for key in sorted(counts)}


def as_markdown(report: BagReport) -> str:
    """Return a report for a person."""
    tally = report.tally
    widths = {robot: _meters(width_m) for robot, width_m in tally.median_widths_m().items()}
    parts = [
        f'# {report.bag}',
        f'{ticks(tally.ticks)} at {report.rate_hz:g} Hz, from {report.start_s:.1f} to '
        f'{report.end_s:.1f} s of the bag.',
        report.ending,
        _damage(report.damage),
        table('hypotheses', 'ticks', sorted(tally.hypotheses.items())),
        table('verdict', 'ticks', sorted(tally.verdicts.items())),
        _budget(report),
        table('robot', 'median width of its enclosure', widths.items()),
        *(truth_paragraphs(report.truth) if report.truth else ()),
        f'{report.accepted} measurements were taken, {report.rejected.total()} rejected.',
        table('rejected because', 'measurements', sorted(report.rejected.items())),
        table('could not be read', 'because', _malformed_rows(report.malformed)),
        *_contradictions(tally.contradictions),
        table('forgotten because', 'at', tally.forgotten.merged().items()),
        *_said(tally.said),
        *report.notices,
        *report.gap_texts,
        '' if report.checksums else WITHOUT_CHECKSUMS,
    ]
    return '\n\n'.join(filter(None, parts)) + '\n'


def _damage(damage: Sequence[str]) -> str:
    return '\n'.join(['The bag is damaged:', *(f'- {text}' for text in damage)]) if damage else ''


def _budget(report: BagReport) -> str:
    """Return what it means that searches ended at the budget, if any did."""
    if not report.at_budget:
        return ''
    return (
        f'The search of {ticks(report.at_budget)} ended at solver.max_boxes, '
        f'{report.max_boxes} boxes: no placement is lost there, but the enclosures are wider, and '
        'the hypotheses may be more, than a longer search would leave.'
    )


def _contradictions(found: Runs[tuple[Conflict, ...]]) -> Iterator[str]:
    if not found:
        yield 'No measurements of one moment were found to contradict each other.'
        return
    rows = [
        (when, '; '.join(', '.join(map(str, conflict)) for conflict in conflicts) or 'not found')
        for conflicts, when in found.merged().items()
    ]
    yield table('contradiction', 'between', rows)


def _malformed_rows(malformed: Mapping[str, Malformed]) -> list[tuple[str, str]]:
    return [
        (topic, f'{wrong.last} ({wrong.count} messages)')
        for topic, wrong in sorted(malformed.items())
    ]


def _said(said: Runs[tuple[str, str]]) -> Iterator[str]:
    """Yield what the node would say; who is told the same at the same times has one row."""
    names: dict[tuple[str, str], list[str]] = {}
    for (name, text), when in said.merged().items():
        names.setdefault((text, when), []).append(name)
    rows = [(f'{", ".join(found)}: {text}', when) for (text, when), found in names.items()]
    yield table('the node says', 'at', rows[:ROWS])
    if len(rows) > ROWS:
        yield f'And {len(rows) - ROWS} things more, which a report in JSON has.'


def _duration_text(seconds: float) -> str:
    """Return a long time in words."""
    for unit, length_s in (('days', 86_400.0), ('hours', 3_600.0), ('minutes', 60.0)):
        if seconds >= length_s:
            return f'{seconds / length_s:.1f} {unit}'
    return f'{seconds:.1f} s'


def _meters(width_m: float) -> str:
    if math.isnan(width_m):
        return 'no placement'
    return f'{width_m:.2f} m' if math.isfinite(width_m) else 'not bounded'
