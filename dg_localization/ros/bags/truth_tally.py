# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Comparison of the answers of a bag with a ground truth: counts per tick and their sums."""

from collections import defaultdict

import numpy as np

from dg_localization.calibration.truth import FleetTruth, TruePlacement
from dg_localization.fleet import Estimate, FixedFrame, FrameKind, Group, Placement, Snapshot
from dg_localization.ros.bags.report import Runs, Tree
from dg_localization.ros.bags.truth import apart_text
from dg_localization.solver.result import Verdict

OF_TRUTH = FixedFrame(FrameKind.ANCHORS, ())
"""The frame of the truth."""


class TruthTally:
    """
    Counts answers that hold the truth; `tree` returns the sums.

    Attributes
    ----------
    counts : dict of str to int
        Numbers of answers with placements, or with a proof that there is none: `compared` if the
        truth is known at their time, else `uncompared`. Of the compared ones, `held` contain the
        truth, `infeasible` have no placement, and in `unlisted` no listed placement contains the
        truth while some are not listed.
    misses : Runs
        The other compared answers: the robots that the nearest hypothesis does not hold.

    """

    def __init__(self, truth: FleetTruth) -> None:
        self.counts = {'compared': 0, 'held': 0, 'infeasible': 0, 'unlisted': 0, 'uncompared': 0}
        self.misses = Runs()
        self._truth = truth
        self._robots = truth.fleet.robots
        self._answers_s: list[float] = []
        self._errors: dict[tuple[str, str], list[float]] = defaultdict(list)
        self._ticks = 0
        self._nees: list[float] = []
        self._beyond, self._n_deviations = 0, 0

    def add(self, estimate: Estimate, snapshot: Snapshot, time_s: float) -> None:
        """Compare an answer to a snapshot with the truth, at a time from the start of the bag."""
        self._ticks += 1
        self._answers_s = [*self._answers_s[:1], snapshot.stamp_s]
        if estimate.verdict is Verdict.INFEASIBLE:
            # A known truth refutes a proof that no placement agrees.
            is_known = self._truth.beside(OF_TRUTH, snapshot).tells
            self.counts['compared'] += is_known
            self.counts['infeasible'] += is_known
            self.counts['uncompared'] += not is_known
            return
        answers: list[Estimate | Group] = [estimate, *estimate.groups]
        placed = [answer for answer in answers if answer.placements]
        compared = [
            (answer, robots)
            for answer in placed
            if (robots := self._missed_by(answer, snapshot)) is not None
        ]
        if not compared:
            self.counts['uncompared'] += bool(placed)
            return
        self.counts['compared'] += 1
        # An unlisted placement may hold robots that the listed ones miss.
        missed = tuple(
            robot
            for answer, robots in compared
            if answer.n_hypotheses == len(answer.placements)
            for robot in robots
        )
        if missed:
            self.misses.add(self._ticks, time_s, robots=missed)
        else:
            misses = any(robots for _, robots in compared)
            self.counts['unlisted' if misses else 'held'] += 1

    def _missed_by(self, answer: Estimate | Group, snapshot: Snapshot) -> tuple[str, ...] | None:
        """Return the robots outside the placement nearest to the truth; None if it is open."""
        assert answer.frame is not None, 'an answer with placements has a frame'
        truth = self._truth.beside(answer.frame, snapshot)
        if not truth.tells:
            return None
        chosen = min(answer.placements, key=lambda placement: _distance_of(placement, truth))
        for name, found in (
            ('point_m', truth.point_errors_m(chosen)),
            ('heading_rad', truth.heading_errors_rad(chosen)),
        ):
            for robot, error in zip(self._robots, found.tolist(), strict=True):
                if np.isfinite(error):
                    self._errors[robot, name].append(error)
        self._add_deviations(chosen, truth)
        return tuple(np.array(self._robots)[truth.outside(chosen)].tolist())

    def _add_deviations(self, placement: Placement, truth: TruePlacement) -> None:
        """Compare the errors of a placement with its stated covariance."""
        if placement.covariances is None:
            return
        dimension = self._truth.fleet.dimension
        off_m = placement.positions_m - truth.positions_m
        turned_rad = truth.heading_errors_rad(placement)
        yaw_rad = np.sqrt(placement.covariances[:, 5, 5]) if dimension == 2 else np.zeros(1)
        known = np.isfinite(turned_rad) & (yaw_rad > 0.0)
        self._beyond += int(np.count_nonzero(known & (turned_rad > 3.0 * yaw_rad)))
        self._n_deviations += int(np.count_nonzero(known))
        for error_m, covariance in zip(off_m, placement.covariances, strict=True):
            stated = covariance[:dimension, :dimension]
            variances = np.diag(stated)
            # A robot that defines the frame has no error there.
            if np.isfinite(error_m).all() and np.isfinite(stated).all() and variances.min() > 0.0:
                self._beyond += int(np.count_nonzero(np.abs(error_m) > 3.0 * np.sqrt(variances)))
                self._n_deviations += dimension
                self._nees.append(float(error_m @ np.linalg.pinv(stated) @ error_m) / dimension)

    def tree(self) -> Tree:
        """Return the counts, and the errors of best points and headings."""
        errors: Tree = {robot: {} for robot in self._robots}
        for (robot, name), found in self._errors.items():
            median, high = np.percentile(found, [50.0, 95.0]).tolist()
            errors[robot][name] = {'median': median, 'percentile_95': high}
        consistency = {}
        if self._nees:
            consistency = {
                'beyond_3_deviations': self._beyond / self._n_deviations,
                'median_nees': float(np.median(self._nees)),
            }
        return {
            **self.counts,
            'without_truth': [name for name in self._robots if name not in self._truth.tracks],
            'missed': self.misses,
            'consistency': consistency,
            'errors': errors,
            'apart': apart_text(self._truth.stamps_s(), self._answers_s, 'the answers'),
        }


def _distance_of(placement: Placement, truth: TruePlacement) -> tuple[int, float]:
    """Return the distance of a placement from the truth: robots outside of it, then meters."""
    errors_m = truth.point_errors_m(placement)
    worst_m = float(np.max(errors_m, initial=0.0, where=np.isfinite(errors_m)))
    return int(np.count_nonzero(truth.outside(placement))), worst_m
