"""From one reading of a snapshot to its placements: constraints, frame, solver, coordinates."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

from dg_localization.fleet.constraints import Constraints
from dg_localization.fleet.estimate import LinkKey, Placement
from dg_localization.fleet.frames import FramePlan, Placer
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.solver.result import SolverOptions, Statistics, Verdict
from dg_localization.solver.solve import solve


class Cancel(Protocol):
    """Something that can be set to stop a computation, such as `threading.Event`."""

    def is_set(self) -> bool:
        """Return whether to stop."""


@dataclass(frozen=True)
class Answer:
    """
    What one choice of links gives.

    Parameters
    ----------
    verdict : Verdict
    placements : tuple of Placement
        At most `max_hypotheses` of them.
    n_hypotheses : int
        How many there are; those not listed are not checked against the headings.
    statistics : Statistics
        Of all problems solved.

    """

    verdict: Verdict
    placements: tuple[Placement, ...]
    n_hypotheses: int
    statistics: Statistics


NO_WORK = Statistics(processed=0, empty=0, split=0, kept=0, pending=0, seconds=0.0)
CONTRADICTION = Answer(Verdict.INFEASIBLE, (), 0, NO_WORK)


def answer(
    snapshot: Snapshot,
    constraints: Constraints,
    plan: FramePlan,
    options: SolverOptions,
    dropped: frozenset[LinkKey] = frozenset(),
    cancel: Cancel | None = None,
) -> Answer:
    """
    Return every placement that agrees with the constraints, in the frame of the plan.

    Parameters
    ----------
    snapshot : Snapshot
    constraints : Constraints
        What the snapshot says without the dropped links.
    plan : FramePlan
    options : SolverOptions
    dropped : frozenset of LinkKey
    cancel : Cancel, optional
        Stops the search when set; what was not examined is part of the answer.

    Returns
    -------
    Answer

    """
    elsewhere = check_elsewhere(constraints, plan.points, options, cancel)
    if elsewhere.verdict is Verdict.INFEASIBLE:
        return elsewhere
    result = solve(constraints.problem(plan.held), options, cancel)
    statistics = add_statistics(elsewhere.statistics, result.statistics)
    placer = Placer(snapshot, constraints, plan, dropped)
    placements: list[Placement] = []
    n_unlisted = 0
    for hypothesis in result.hypotheses:
        if len(placements) < snapshot.config.max_hypotheses:
            placements += placer.placements(hypothesis)
        else:
            n_unlisted += placer.most_placements(hypothesis)
    # A hypothesis whose headings contradict the rays is no placement after all.
    verdict = result.verdict if placements else Verdict.INFEASIBLE
    return Answer(verdict, tuple(placements), len(placements) + n_unlisted, statistics)


def check_elsewhere(
    constraints: Constraints,
    points: tuple[int, ...],
    options: SolverOptions,
    cancel: Cancel | None = None,
) -> Answer:
    """
    Return whether the parts of the fleet that some points do not belong to contradict themselves.

    Parameters
    ----------
    constraints : Constraints
    points : tuple of int
        One connected part, or nothing.
    options : SolverOptions
    cancel : Cancel, optional

    Returns
    -------
    Answer
        Without placements: those parts have no place in the fixed frame.

    """
    if constraints.contradictory:
        return CONTRADICTION
    done = set(points)
    statistics = NO_WORK
    for point in range(len(constraints.lower)):
        if point in done:
            continue
        component = constraints.component_of(point)
        done |= set(component)
        if len(component) < 3:
            continue
        result = solve(constraints.problem(component), options, cancel)
        statistics = add_statistics(statistics, result.statistics)
        if result.verdict is Verdict.INFEASIBLE:
            return replace(CONTRADICTION, statistics=statistics)
    return Answer(Verdict.COVERED, (), 0, statistics)


def add_statistics(first: Statistics, second: Statistics) -> Statistics:
    """Return the work of two searches together."""
    return Statistics(
        processed=first.processed + second.processed,
        empty=first.empty + second.empty,
        split=first.split + second.split,
        kept=first.kept + second.kept,
        pending=first.pending + second.pending,
        seconds=first.seconds + second.seconds,
    )
