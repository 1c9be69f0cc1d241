# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From the constraints of a snapshot to placements: solve, and place the hypotheses in a frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
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
    What the solver found for connected points.

    Parameters
    ----------
    plan : FramePlan
        Of the frame of the placements.
    placements : tuple of Placement
        At most `max_hypotheses` of them, or of the solver where a window will narrow them.
    n_hypotheses : int
        How many there are; those not listed are not checked against the headings.

    """

    plan: FramePlan
    placements: tuple[Placement, ...]
    n_hypotheses: int

    def leaving(self, placements: tuple[Placement, ...]) -> Part:
        """Return the part with the placements that are left of those listed."""
        count = self.n_hypotheses - len(self.placements) + len(placements)
        return self._replace(placements=placements, n_hypotheses=count)

    def robots(self, config: FleetConfig) -> tuple[str, ...]:
        """Return the names of its robots."""
        points = self.plan.points
        return tuple(config.robots[point] for point in points if point < len(config.robots))


@dataclass(frozen=True)
class Answer:
    """
    What the solver found for one choice of links.

    Parameters
    ----------
    verdict : Verdict
    statistics : Statistics
        Of all problems solved.
    groups : tuple of Part
        What is connected, but not to the fixed frame.
    main : Part or None
        What is connected to the fixed frame.
    rigidity : Rigidity
        The rigid pieces of all of them.

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
        return replace(self, groups=tuple(parts[:count]), main=main)


_OF_ALL = (Verdict.INFEASIBLE, Verdict.OUT_OF_BUDGET, Verdict.COVERED)
"""The first of these that is the verdict of some parts is that of all together."""


def open_remedies(config: FleetConfig, found: Answer) -> tuple[str, ...]:
    """Return what would join pieces, without what the placements that are left have decided."""
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
    """Return what would join the pieces of a fleet, those that nothing joins last."""
    joining = []
    for group in found.groups:
        robots = group.robots(config)
        n_group = len(robots)
        n_others = len(config.robots) + len(config.landmarks) - n_group
        missing = missing_ranges(n_group, n_others, 0, config.dimension)
        # Either side may be flexible in itself: then it takes more to hold all of it.
        ranges = f'at least {missing} ranges to other robots or anchors'
        joining.append(f'{ranges} would join {", ".join(robots)} to the rest')
    return (*open_remedies(config, found), *joining)


SHORTEST_S = 1e-3
"""A solve for which no time is left gets this much: what is short still makes an answer."""


def shared_time(options: SolverOptions, n_solves: int) -> Iterator[SolverOptions]:
    """Yield the options of solves one after another, which together take the time of one."""
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

    The constraints are without the `dropped` links. A contradiction anywhere contradicts the whole
    fleet, and a limit anywhere leaves some of it open.
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
        ordered = (found.rigidity, rigidity) if plan is plans.main else (rigidity, found.rigidity)
        rigidity = ordered[0] + ordered[1]
    main = None if plans.main is None else parts.pop()
    verdict = next(verdict for verdict in _OF_ALL if verdict in verdicts)
    return Answer(verdict, statistics, tuple(parts), main, rigidity)


def _answer_group(
    snapshot: Snapshot,
    constraints: Constraints,
    plan: FramePlan,
    options: SolverOptions,
    dropped: frozenset[LinkKey],
    cancel: Cancel | None,
) -> Answer:
    """Return every placement of connected points, in the frame of their plan, as one group."""
    placer = Placer(snapshot, constraints, plan, dropped)
    most_placements = snapshot.config.max_hypotheses
    if snapshot.window.observations:
        # What is remembered may rule out the first ones.
        most_placements = max(most_placements, options.max_hypotheses)
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
    part = Part(plan, tuple(placements[:most_placements]), number)
    names = [snapshot.config.points[point] for point in placer.points]
    measured = None
    if not constraints.all_measured:
        measured = constraints.measured[np.ix_(placer.points, placer.points)]
    rigidity = rigidity_of(names, result, snapshot.config.dimension, all_listed, measured)
    return Answer(verdict, result.statistics, (part,), rigidity=rigidity)
