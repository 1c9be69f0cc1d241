# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The answers of a bag beside a ground truth: counted tick by tick, and summed up at the end."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from dg_localization.calibration.answers import FleetTruth, TruePlacement
from dg_localization.calibration.truth import MOST_GAP_S
from dg_localization.fleet import Estimate, FixedFrame, FrameKind, Group, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.ros.bags.tables import Runs, table
from dg_localization.ros.bags.truth_table import apart_text
from dg_localization.solver.result import Verdict

OF_TRUTH = FixedFrame(FrameKind.ANCHORS, ())
"""The frame of the truth itself."""


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
    misses : Runs of tuple of str
        The others: the robots that the nearest hypothesis does not hold.
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
        self.misses: Runs[tuple[str, ...]] = Runs()
        self.answers_s: list[float] = []
        self.uncompared = 0
        self._truth = truth
        self._robots = truth.fleet.robots
        self.unknown = tuple(name for name in self._robots if name not in truth.tracks)
        self._errors_m: dict[str, list[float]] = defaultdict(list)
        self._errors_rad: dict[str, list[float]] = defaultdict(list)
        self._ticks = 0
        self._nees: list[float] = []
        self._beyond, self._n_deviations = 0, 0

    def add(self, estimate: Estimate, snapshot: Snapshot, time_s: float) -> None:
        """Compare an answer to a snapshot with the truth, for a time from the start of the bag."""
        self._ticks += 1
        self.answers_s = [*self.answers_s[:1], snapshot.stamp_s]
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
            self.misses.add(missed, self._ticks, time_s)
        elif any(robots for _, robots in compared):
            self.unlisted += 1
        else:
            self.held += 1

    def apart(self) -> str:
        """Return how the times of answers and truth miss each other; empty where they meet."""
        return apart_text(self._truth.stamps_s(), self.answers_s, 'the answers')

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
        self._add_deviations(chosen, truth)
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

    def _add_deviations(self, placement: Placement, truth: TruePlacement) -> None:
        """Compare how far a placement is off with the covariance that it states."""
        if placement.covariances is None:
            return
        dimension = self._truth.fleet.dimension
        off_m = placement.positions_m - truth.positions_m
        for error_m, covariance in zip(off_m, placement.covariances, strict=True):
            stated = covariance[:dimension, :dimension]
            variances = np.diag(stated)
            # A robot that defines the frame has no error there.
            if np.isfinite(error_m).all() and np.isfinite(stated).all() and variances.min() > 0.0:
                self._beyond += int(np.count_nonzero(np.abs(error_m) > 3.0 * np.sqrt(variances)))
                self._n_deviations += dimension
                self._nees.append(float(error_m @ np.linalg.pinv(stated) @ error_m) / dimension)

    def consistency(self) -> tuple[float, float] | None:
        """Return how well errors agree with stated covariances; None where there are none."""
        if not self._nees:
            return None
        return self._beyond / self._n_deviations, float(np.median(self._nees))

    def errors(self) -> dict[str, dict[str, tuple[float, float]]]:
        """Return how far best points and headings are off the truth in the nearest hypothesis."""
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
        'missed': [
            {
                'first_s': run.first_s,
                'last_s': run.last_s,
                'ticks': run.ticks,
                'robots': list(run.what),
            }
            for run in tally.misses
        ],
        'consistency': dict(
            zip(('beyond_3_deviations', 'median_nees'), tally.consistency() or (), strict=False)
        ),
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
        text = f'No answer has a ground truth at its time.{_gaps_text(tally)}'
        yield f'{text} {tally.apart()}'.rstrip()
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
    rows = [(when, ', '.join(robots)) for robots, when in tally.misses.merged().items()]
    yield table('truth outside', 'of', rows)
    if consistency := tally.consistency():
        yield (
            f'{100.0 * consistency[0]:.1f} % of the coordinates are off by more than three of '
            f'their stated deviations; the median NEES per coordinate is {consistency[1]:.2f}.'
        )
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
