# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The answers of a bag beside a ground truth: counted tick by tick, and summed up at the end."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from dg_localization.calibration.answers import FleetTruth, TruePlacement
from dg_localization.calibration.truth import MOST_GAP_S
from dg_localization.fleet import Estimate, FixedFrame, FrameKind, Group, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.ros.bags.tables import span, table
from dg_localization.solver.result import Verdict

OF_TRUTH = FixedFrame(FrameKind.ANCHORS, ())
"""The frame of the truth itself."""

MOST_NAMED = 20
"""Of the times when the truth is outside; the rest are counted."""


@dataclass
class Miss:
    """
    One run of ticks of which no hypothesis holds the truth.

    Attributes
    ----------
    first_s, last_s : float
        The first and the last of these ticks, from the start of the bag.
    ticks : int
        How many there are.
    robots : tuple of str
        Those that the nearest hypothesis does not hold.

    """

    first_s: float
    last_s: float
    ticks: int
    robots: tuple[str, ...]


class TruthTally:
    """
    Counts answers that hold the truth.

    Parameters
    ----------
    truth : FleetTruth

    Attributes
    ----------
    compared : int
        Answers of whose time the truth is known, with placements or a proof that there is none.
    held : int
        Those of them that hold it.
    infeasible : int
        Those without a placement, because the measurements contradict each other.
    unlisted : int
        Those of which none that is listed holds it, and not all are listed.
    misses : list of Miss
        The others, in the order of time.
    uncompared : int
        Answers as those compared, of whose time no truth is known.
    unknown : tuple of str
        The robots without a truth.

    """

    def __init__(self, truth: FleetTruth) -> None:
        self.compared = 0
        self.held = 0
        self.infeasible = 0
        self.unlisted = 0
        self.misses: list[Miss] = []
        self.uncompared = 0
        self._truth = truth
        self._robots = truth.fleet.robots
        self.unknown = tuple(name for name in self._robots if name not in truth.tracks)
        self._errors_m: dict[str, list[float]] = defaultdict(list)
        self._errors_rad: dict[str, list[float]] = defaultdict(list)
        self._missed = False

    def add(self, estimate: Estimate, snapshot: Snapshot, time_s: float) -> None:
        """Compare an answer to a snapshot with the truth, for a time from the start of the bag."""
        was_missed, self._missed = self._missed, False
        if estimate.verdict is Verdict.INFEASIBLE:
            self._add_infeasible(snapshot)
            return
        answers: list[Estimate | Group] = [estimate, *estimate.groups]
        placed = [answer for answer in answers if answer.placements]
        compared = [
            (answer, robots)
            for answer in placed
            if (robots := self._missed_by(answer, snapshot)) is not None
        ]
        if not compared:
            self.uncompared += bool(placed)
            return
        self.compared += 1
        # One that is not listed may hold what the listed ones of its answer miss.
        missed = tuple(
            robot
            for answer, robots in compared
            if answer.n_hypotheses == len(answer.placements)
            for robot in robots
        )
        if missed:
            self._missed = True
            self._add_miss(missed, time_s, was_missed)
        elif any(robots for _, robots in compared):
            self.unlisted += 1
        else:
            self.held += 1

    def _add_infeasible(self, snapshot: Snapshot) -> None:
        """Count a proof that no placement agrees, which the truth refutes where it is known."""
        if self._truth.beside(OF_TRUTH, snapshot).tells:
            self.compared += 1
            self.infeasible += 1
        else:
            self.uncompared += 1

    def _missed_by(self, answer: Estimate | Group, snapshot: Snapshot) -> tuple[str, ...] | None:
        """Return whom the placement that is nearest to the truth misses; None if that is open."""
        assert answer.frame is not None, 'an answer with placements has a frame'
        truth = self._truth.beside(answer.frame, snapshot)
        if not truth.tells:
            return None
        chosen = min(answer.placements, key=lambda placement: _distance_of(placement, truth))
        self._add_errors(chosen, truth)
        return tuple(np.array(self._robots)[truth.outside(chosen)].tolist())

    def _add_errors(self, placement: Placement, truth: TruePlacement) -> None:
        """Keep how far off a placement is."""
        for errors, found in (
            (self._errors_m, truth.point_errors_m(placement)),
            (self._errors_rad, truth.heading_errors_rad(placement)),
        ):
            for robot, error in zip(self._robots, found.tolist(), strict=True):
                if np.isfinite(error):
                    errors[robot].append(error)

    def _add_miss(self, robots: tuple[str, ...], time_s: float, was_missed: bool) -> None:
        """Lengthen the last miss or begin one."""
        if was_missed and self.misses[-1].robots == robots:
            self.misses[-1].last_s = time_s
            self.misses[-1].ticks += 1
        else:
            self.misses.append(Miss(time_s, time_s, 1, robots))

    def errors(self) -> dict[str, dict[str, tuple[float, float]]]:
        """
        Return how far best points and headings are off the truth in the nearest hypothesis.

        Returns
        -------
        dict
            By robot, under 'point_m' and 'heading_rad' as far as they are known, the median and
            what 95 % are below.

        """
        found: dict[str, dict[str, tuple[float, float]]] = {}
        for robot in self._robots:
            kinds = {'point_m': self._errors_m[robot], 'heading_rad': self._errors_rad[robot]}
            found[robot] = {
                name: (float(np.median(errors)), float(np.percentile(errors, 95.0)))
                for name, errors in kinds.items()
                if errors
            }
        return found


def _distance_of(placement: Placement, truth: TruePlacement) -> tuple[int, float]:
    """Return a measure of how near a placement is to the truth: whom it holds comes first."""
    errors_m = truth.point_errors_m(placement)
    worst_m = float(np.max(errors_m, initial=0.0, where=np.isfinite(errors_m)))
    return int(np.count_nonzero(truth.outside(placement))), worst_m


def truth_tree(tally: TruthTally) -> dict[str, Any]:
    """Return what is said of the truth, for programs."""
    return {
        'compared': tally.compared,
        'held': tally.held,
        'infeasible': tally.infeasible,
        'unlisted': tally.unlisted,
        'uncompared': tally.uncompared,
        'without_truth': list(tally.unknown),
        'missed': [vars(miss) | {'robots': list(miss.robots)} for miss in tally.misses],
        'errors': {
            robot: {
                name: {'median': median, 'percentile_95': high}
                for name, (median, high) in kinds.items()
            }
            for robot, kinds in tally.errors().items()
        },
    }


def truth_paragraphs(tally: TruthTally) -> Iterator[str]:
    """Yield what is said of the truth, for a person."""
    if tally.unknown:
        yield f'There is no ground truth of {", ".join(tally.unknown)}.'
    if not tally.compared:
        yield f'No answer has a ground truth at its time.{_gaps_text(tally)}'
        return
    text = f'The truth is inside a hypothesis in {tally.held} of {tally.compared} answers.'
    if tally.infeasible:
        text += (
            f' {tally.infeasible} answers have no placement at all: the measurements contradict '
            'each other.'
        )
    if tally.unlisted:
        text += (
            f' {tally.unlisted} answers have more hypotheses than max_hypotheses, and those that '
            'are left out were not compared.'
        )
    if tally.uncompared:
        text += f' {tally.uncompared} answers have no ground truth at their time.'
    yield text + _gaps_text(tally)
    rows = [
        (span(miss.first_s, miss.last_s, miss.ticks), ', '.join(miss.robots))
        for miss in tally.misses
    ]
    yield table('truth outside', 'of', rows[:MOST_NAMED])
    if len(rows) > MOST_NAMED:
        yield f'And {len(rows) - MOST_NAMED} times more.'
    errors = {robot: kinds for robot, kinds in tally.errors().items() if kinds}
    yield table(
        'robot',
        'off the truth in the nearest hypothesis, median (95 %)',
        [(robot, _errors_text(kinds)) for robot, kinds in errors.items()],
    )


def _gaps_text(tally: TruthTally) -> str:
    """Return why the truth may be unknown at some times, where that matters."""
    if not tally.uncompared:
        return ''
    return f' Between samples that are more than {MOST_GAP_S:g} s apart no truth is known.'


def _errors_text(kinds: Mapping[str, tuple[float, float]]) -> str:
    """Return how far point and heading of a robot are off."""
    return ', '.join(
        f'{median:.2f} {name.rpartition("_")[2]} ({high:.2f})'
        for name, (median, high) in kinds.items()
    )
