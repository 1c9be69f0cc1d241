# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From the constraints of a snapshot to placements: solve, and place the hypotheses in a frame."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
import math
import time

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import Group, Placement
from dg_localization.fleet.frames.placer import Placer
from dg_localization.fleet.frames.plan import FramePlan, Plans
from dg_localization.fleet.rigidity import NOT_RIGID, Rigidity, missing_ranges, rigidity_of
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.solver.options import Cancel, SolverOptions
from dg_localization.solver.result import Statistics, Verdict
from dg_localization.solver.solve import solve

LEAST_S = 1e-3
"""A solve gets this much time even where those before it took all."""


@dataclass(frozen=True)
class Answer:
    """
    What the solver found for one choice of links.

    Parameters
    ----------
    verdict : Verdict
    placements : tuple of Placement
        At most `max_hypotheses` of them, or `LEAST_LISTED` where a window will narrow them.
    n_hypotheses : int
        How many there are; those not listed are not checked against the headings.
    statistics : Statistics
        Of all problems solved.
    groups : tuple of Group
        What is connected, but not to the fixed frame.
    rigidity : Rigidity
        The rigid pieces of all of them.

    """

    verdict: Verdict
    placements: tuple[Placement, ...]
    n_hypotheses: int
    statistics: Statistics
    groups: tuple[Group, ...] = ()
    rigidity: Rigidity = NOT_RIGID


LEAST_LISTED = 64
"""Least number of placements that are tried with the memory, however few are published."""

CONTRADICTION = Answer(Verdict.INFEASIBLE, (), 0, Statistics())
_OF_ALL = (Verdict.INFEASIBLE, Verdict.OUT_OF_BUDGET, Verdict.COVERED)
"""The first of these that is the verdict of some parts is that of all together."""

NO_PLACE = Answer(Verdict.COVERED, (), 0, Statistics())


def open_remedies(config: FleetConfig, found: Answer) -> tuple[str, ...]:
    """Return what would join pieces, without what the placements that are left have decided."""
    parts: list[Answer | Group] = [found, *found.groups]
    placements = [placement for part in parts for placement in part.placements]
    all_listed = sum(part.n_hypotheses for part in parts) == len(placements)
    names = (*config.robots, *config.landmarks)
    places_m = [np.concatenate([one.positions_m, one.landmarks_m]) for one in placements]
    return tuple(
        remedy.text
        for remedy in found.rigidity.remedies
        if not all_listed or remedy.is_open(names, places_m)
    )


def would_fix(config: FleetConfig, found: Answer) -> tuple[str, ...]:
    """Return what would join the pieces of a fleet, those that nothing joins last."""
    joining = []
    for group in found.groups:
        n_group = len(group.robots)
        n_others = len(config.robots) + len(config.landmarks) - n_group
        missing = missing_ranges(n_group, n_others, 0, config.dimension)
        names = ', '.join(group.robots)
        # Either side may be flexible in itself: then it takes more to hold all of it.
        ranges = f'at least {missing} ranges to other robots or anchors'
        joining.append(f'{ranges} would join {names} to the rest')
    return (*open_remedies(config, found), *joining)


def shared_time(options: SolverOptions, n_solves: int) -> Iterator[SolverOptions]:
    """Yield the options of solves one after another, which together take the time of one."""
    start_s = time.perf_counter()
    for n_left in range(n_solves, 0, -1):
        spent_s = time.perf_counter() - start_s
        yield replace(
            options,
            max_seconds=max(LEAST_S, (options.max_seconds - spent_s) / n_left),
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

    The constraints are without the `dropped` links. A contradiction anywhere contradicts the whole
    fleet, and a limit anywhere leaves some of it open.
    """
    if constraints.contradictory:
        return CONTRADICTION
    robots = snapshot.config.robots
    statistics = Statistics()
    groups = []
    verdicts: list[Verdict] = []
    rigidity = NOT_RIGID
    shares = shared_time(options, len(plans.others) + 1)
    for plan in plans.others:
        found = _answer_group(snapshot, constraints, plan, next(shares), dropped, cancel)
        statistics += found.statistics
        if found.verdict is Verdict.INFEASIBLE:
            return replace(CONTRADICTION, statistics=statistics)
        names = tuple(robots[point] for point in plan.points if point < len(robots))
        groups.append(Group(names, plan.frame, found.placements, found.n_hypotheses))
        verdicts.append(found.verdict)
        rigidity += found.rigidity
    found = NO_PLACE
    if plans.main is not None:
        found = _answer_group(snapshot, constraints, plans.main, next(shares), dropped, cancel)
    statistics += found.statistics
    verdicts.append(found.verdict)
    return replace(
        found,
        verdict=next(verdict for verdict in _OF_ALL if verdict in verdicts),
        statistics=statistics,
        groups=tuple(groups),
        rigidity=found.rigidity + rigidity,
    )


def _answer_group(
    snapshot: Snapshot,
    constraints: Constraints,
    plan: FramePlan,
    options: SolverOptions,
    dropped: frozenset[LinkKey],
    cancel: Cancel | None,
) -> Answer:
    """Return every placement of connected points, in the frame of their plan."""
    placer = Placer(snapshot, constraints, plan, dropped)
    most_placements = snapshot.config.max_hypotheses
    if snapshot.window.observations:
        # What is remembered may rule out the first ones.
        most_placements = max(most_placements, LEAST_LISTED)
    # To build one takes the solver long.
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
        # The list is complete where it has fewer than it may; what is empty is left out.
        is_complete = len(result.hypotheses) < options.max_hypotheses
        n_seen = result.n_hypotheses if is_complete else max(n_seen, options.max_hypotheses)
    n_unseen = max(0, result.n_hypotheses - n_seen)
    # A hypothesis whose headings contradict the rays has no placement.
    verdict = result.verdict if placements or n_unseen else Verdict.INFEASIBLE
    number = len(placements) + n_unseen * placer.most_images
    listed = tuple(placements[:most_placements])
    names = [snapshot.config.points[point] for point in placer.points]
    measured = None
    if not constraints.all_measured:
        measured = constraints.measured[np.ix_(placer.points, placer.points)]
    rigidity = rigidity_of(names, result, snapshot.config.dimension, all_listed, measured)
    return Answer(verdict, listed, number, result.statistics, rigidity=rigidity)
