# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From the constraints of a snapshot to placements: solve, and place the hypotheses in a frame."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import replace
import math
import time
from typing import NamedTuple

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import Placement
from dg_localization.fleet.frames.placer import Placer
from dg_localization.fleet.frames.plan import FramePlan, Plans
from dg_localization.fleet.rigidity import NOT_RIGID, Rigidity, missing_ranges, rigidity_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.result import Statistics, Verdict
from dg_localization.solver.solve import solve


class Part(NamedTuple):
    """
    The solution for one group of connected points.

    Parameters
    ----------
    plan : FramePlan
        The plan of the frame of the placements.
    placements : tuple of Placement
        At most `max_hypotheses` of the settings, or of the solver if a window will narrow them.
    n_hypotheses : int
        The number of hypotheses; those not listed are not checked against the headings.

    """

    plan: FramePlan
    placements: tuple[Placement, ...]
    n_hypotheses: int

    def leaving(self, placements: tuple[Placement, ...]) -> Part:
        """Return the part with the remaining placements of its list."""
        count = self.n_hypotheses - len(self.placements) + len(placements)
        return self._replace(placements=placements, n_hypotheses=count)

    def robots(self, config: FleetConfig) -> tuple[str, ...]:
        """Return the names of the robots of the part."""
        points = self.plan.points
        return tuple(config.robots[point] for point in points if point < len(config.robots))


class Answer(NamedTuple):
    """
    The solution for one choice of links.

    Parameters
    ----------
    verdict : Verdict
    statistics : Statistics
        The work on all problems.
    groups : tuple of Part
        The parts that are not connected to the fixed frame.
    main : Part or None
        The part that is connected to the fixed frame.
    rigidity : Rigidity
        The rigid pieces of all parts.

    """

    verdict: Verdict
    statistics: Statistics = Statistics()
    groups: tuple[Part, ...] = ()
    main: Part | None = None
    rigidity: Rigidity = NOT_RIGID

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, the main one last."""
        return self.groups if self.main is None else (*self.groups, self.main)

    def with_parts(self, parts: Sequence[Part]) -> Answer:
        """Return the answer with other parts in place of its own."""
        count = len(self.groups)
        main = None if self.main is None else parts[-1]
        return self._replace(groups=tuple(parts[:count]), main=main)


def worst_of(verdicts: Collection[Verdict]) -> Verdict:
    """Return the verdict of an answer by the verdicts of its parts."""
    worst_first = (Verdict.INFEASIBLE, Verdict.OUT_OF_BUDGET, Verdict.COVERED)
    return next(verdict for verdict in worst_first if verdict in verdicts)


def open_remedies(config: FleetConfig, found: Answer) -> tuple[str, ...]:
    """Return the remedies that would join pieces, without those that placements have decided."""
    placements = [placement for part in found.parts for placement in part.placements]
    all_listed = sum(part.n_hypotheses for part in found.parts) == len(placements)
    names = (*config.robots, *config.landmarks)
    places_m = [np.concatenate([one.positions_m, one.landmarks_m]) for one in placements]
    return tuple(
        remedy.text
        for remedy in found.rigidity.remedies
        if not all_listed or remedy.is_open(names, places_m)
    )


def would_fix(config: FleetConfig, found: Answer) -> tuple[str, ...]:
    """Return measurements that would join the pieces of a fleet or rule out mirror images."""
    joining = []
    for group in found.groups:
        robots = group.robots(config)
        n_group = len(robots)
        n_others = len(config.robots) + len(config.landmarks) - n_group
        missing = missing_ranges(n_group, n_others, 0, config.dimension)
        # Either side may be flexible itself, and then needs more measurements.
        ranges = f'at least {missing} ranges to other robots or anchors'
        joining.append(f'{ranges} would join {", ".join(robots)} to the rest')
    return (*open_remedies(config, found), *joining, *_driving(config, found.main))


def _driving(config: FleetConfig, part: Part | None) -> Iterator[str]:
    """Yield what would rule out mirror images of robots that can drive, in the plane."""
    if part is None or config.dimension == 3 or config.max_speed_m_s <= 0.0:
        return
    placements = part.placements
    is_mirrored = [one.mirrored for one in placements]
    if is_mirrored.count(False) == 2 and part.n_hypotheses == len(placements):
        advice = (_mirrored_alone(config, placements[0], other) for other in placements[1:])
        if first := next(filter(None, advice), ''):
            yield first
    if any(is_mirrored) and not all(is_mirrored):
        yield 'curves with odometry, or a camera that sees two others, rule out mirror images'


def _mirrored_alone(config: FleetConfig, first: Placement, second: Placement) -> str:
    """Return a text if two placements differ in one robot alone, mirrored in a line of two."""
    both, names = (first, second), (*config.robots, *config.landmarks)
    boxes = np.array([np.concatenate([p.enclosure_m, p.landmark_enclosure_m]) for p in both])
    apart = np.any(boxes[:, :, 0].max(axis=0) > boxes[:, :, 1].min(axis=0), axis=1)
    robot = int(np.argmax(apart))
    if apart.sum() != 1 or names[robot] in config.anchors:
        return ''
    # The line is through the two points whose distances from the robot differ least.
    points_m = np.concatenate([first.positions_m, first.landmarks_m])
    own_m, other_m = (np.hypot(*(points_m - one.positions_m[robot]).T) for one in both)
    line = np.sort(np.argsort(np.abs(own_m - other_m))[:2])
    start_m, end_m = points_m[line]
    arm_m, along_m = points_m[robot] - start_m, end_m - start_m
    image_m = start_m - arm_m + 2.0 * along_m * (arm_m @ along_m) / max(along_m @ along_m, 1e-300)
    if not np.array_equal(np.clip(image_m, *boxes[1, robot]), image_m):
        return ''
    ends = ' - '.join(names[point] for point in line)
    return f'{names[robot]} is mirrored in the line {ends}: drive it in a curve'


SHORTEST_S = 1e-3
"""Least time of a solve: even a short one gives an answer."""


def shared_time(options: SolverOptions, n_solves: int) -> Iterator[SolverOptions]:
    """Yield the options of successive solves that share the time of one."""
    start_s = time.perf_counter()
    for n_left in range(n_solves, 0, -1):
        spent_s = time.perf_counter() - start_s
        yield replace(
            options,
            max_seconds=max(SHORTEST_S, (options.max_seconds - spent_s) / n_left),
            tighten_seconds=max(0.0, (options.tighten_seconds - spent_s) / n_left),
        )


def answer_of(
    snapshot: Snapshot,
    constraints: Constraints,
    plans: Plans,
    options: SolverOptions,
    dropped: frozenset[LinkKey] = frozenset(),
    cancel: Cancel | None = None,
) -> Answer:
    """
    Return every placement that agrees with the constraints, in the frames of the plans.

    The constraints exclude the `dropped` links. A contradiction in any part makes the answer
    infeasible; a limit reached in any part makes it out of budget.
    """
    if constraints.contradictory:
        return Answer(Verdict.INFEASIBLE)
    statistics, rigidity = Statistics(), NOT_RIGID
    verdicts, parts = [Verdict.COVERED], list[Part]()
    for plan, share in zip(plans.all, shared_time(options, len(plans.all)), strict=True):
        found = _answer_group(snapshot, constraints, plan, share, dropped, cancel)
        statistics += found.statistics
        if found.verdict is Verdict.INFEASIBLE:
            return Answer(Verdict.INFEASIBLE, statistics)
        verdicts.append(found.verdict)
        parts += found.groups
        # Pieces of the main part are listed first.
        rigidity = found.rigidity + rigidity if plan is plans.main else rigidity + found.rigidity
    main = None if plans.main is None else parts.pop()
    return Answer(worst_of(verdicts), statistics, tuple(parts), main, rigidity)


def _answer_group(
    snapshot: Snapshot,
    constraints: Constraints,
    plan: FramePlan,
    options: SolverOptions,
    dropped: frozenset[LinkKey],
    cancel: Cancel | None,
) -> Answer:
    """Return every placement of connected points in the frame of their plan, as one group."""
    placer = Placer(snapshot, constraints, plan, dropped)
    most_placements = snapshot.config.max_hypotheses
    if snapshot.window.observations:
        # The window may rule out the first placements.
        most_placements = max(most_placements, options.max_hypotheses)
    # Hypotheses are expensive to build.
    options = replace(options, max_hypotheses=math.ceil(most_placements / placer.most_images))
    result = solve(placer.problem, options, cancel)
    all_listed = result.n_hypotheses <= options.max_hypotheses
    placements: list[Placement] = []
    n_seen = 0
    for hypothesis in result.hypotheses:
        if len(placements) >= most_placements:
            break
        placements += placer.placements(
            hypothesis, alone=result.n_hypotheses == 1, apart=all_listed
        )
        n_seen += 1
    else:
        # A list below its limit is complete; empty hypotheses are left out.
        if n_seen < options.max_hypotheses:
            n_seen = result.n_hypotheses
    n_unseen = max(0, result.n_hypotheses - n_seen)
    # A hypothesis whose headings contradict the rays has no placement.
    verdict = result.verdict if placements or n_unseen else Verdict.INFEASIBLE
    number = len(placements) + n_unseen * placer.most_images
    part = Part(plan, tuple(placements[:most_placements]), number)
    names = [snapshot.config.points[point] for point in placer.points]
    among = np.ix_(placer.points, placer.points)
    measured = None if constraints.all_measured else constraints.measured[among]
    rigidity = rigidity_of(names, result, snapshot.config.dimension, all_listed, measured)
    return Answer(verdict, result.statistics, (part,), rigidity=rigidity)
