# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whether some observations of a snapshot contradict each other: by pairs alone, or the solver."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from dg_localization.fleet.answers import answer_of
from dg_localization.fleet.constraints.constrain import Constraints, constrain
from dg_localization.fleet.contradictions.conflicts import Effort
from dg_localization.fleet.contradictions.suspects import Links, Observations, Suspects
from dg_localization.fleet.frames.plan import plan_frames
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.arrays import Interval
from dg_localization.solver.options import Cancel
from dg_localization.solver.result import Verdict
from dg_localization.solver.solve import solve

BRIEF_BOXES = 32
"""Most boxes of one brief problem: a contradiction shows early or hardly ever."""


class ContradictionOracle:
    """
    Decides whether observations of a snapshot contradict each other.

    Parameters
    ----------
    snapshot : Snapshot
    observed : Observations
        Its observations.
    cancel : Cancel, optional
        Stops a search of the solver when set.

    """

    def __init__(self, snapshot: Snapshot, observed: Observations, cancel: Cancel | None) -> None:
        self._snapshot = snapshot
        self._observed = observed
        self._cancel = cancel
        self._everything = frozenset(snapshot.keys)
        options = snapshot.config.solver
        self._thorough = replace(options, tighten_seconds=0.0)
        boxes = min(BRIEF_BOXES, options.max_boxes)
        self._brief = replace(self._thorough, max_boxes=boxes, max_hypotheses=1)

    def __call__(self, observations: Suspects, effort: Effort) -> bool:
        """Return whether no placement agrees with observations: true is a proof."""
        links = self._observed.links_of(observations)
        dropped = self._everything - links
        constraints = constrain(self._snapshot, dropped)
        if constraints.contradictory:
            return True
        points = self._points_of(links, constraints)
        if not points:
            return False
        if effort is Effort.PAIRS:
            return not _triangles_hold(constraints.of(points))
        if effort is Effort.BRIEF:
            found = solve(constraints.of(points).problem(), self._brief, self._cancel)
            return found.verdict is Verdict.INFEASIBLE
        (plans,) = plan_frames(self._snapshot, constraints, [constraints])
        whole = answer_of(
            self._snapshot, constraints, plans, self._thorough, dropped, self._cancel
        )
        return whole.verdict is Verdict.INFEASIBLE

    def _points_of(self, links: Links, constraints: Constraints) -> tuple[int, ...]:
        """Return the points that links concern, with the rest of their bodies that helps."""
        config, rows = self._snapshot.config, constraints.rows
        members = self._snapshot.mounts.members
        points = set()
        for key in links:
            for point in key.ends:
                robot = config.robot_of(point)
                points |= {rows[member] for member in members.get(robot, (point,))}
        if points & self._snapshot.anchors.boxes.keys():
            # Which of two mirror images the anchors are.
            for known in self._snapshot.anchors.chiralities:
                points.update(known.points)
        return tuple(sorted(points))


def _triangles_hold(constraints: Constraints) -> bool:
    """Return whether each distance fits the ways through one other point."""
    distance = Interval(constraints.lower, constraints.upper).sqrt()
    return all(
        np.all(distance.lower <= (distance[:, point, None] + distance[None, point]).upper)
        for point in range(len(constraints.points))
    )


def small_parts(snapshot: Snapshot, observed: Observations) -> tuple[Suspects, ...]:
    """Return parts of the observations that concern few robots, small ones first."""
    return tuple(dict.fromkeys(_regions(snapshot, observed)))


def _regions(snapshot: Snapshot, observed: Observations) -> Iterator[Suspects]:
    """Yield robots among the anchors, then pairs of these, then robots with their neighbors."""
    config = snapshot.config
    ends = {
        one: frozenset((config.robot_of(one.name), config.robot_of(one.target)))
        for one in observed.observations
    }
    anchors = frozenset(config.anchors)
    free = [robot for robot in config.robots if robot not in anchors]
    pairs = sorted({between for between in ends.values() if not between & anchors}, key=sorted)
    near = [frozenset([robot]) for robot in free]
    if anchors:
        yield from (_among(ends, robots | anchors) for robots in (*near, *pairs))
    for robot in free:
        yield _among(ends, frozenset().union(*(pair for pair in pairs if robot in pair)))


def _among(ends: dict, robots: frozenset[str]) -> Suspects:
    """Return the observations between some robots and anchors."""
    return frozenset(one for one, between in ends.items() if between <= robots)
