# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From a snapshot to an estimate: solve it, or explain its contradictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
import time
from typing import Any

from dg_localization import SolverOptions
from dg_localization.fleet.answers import (
    Answer,
    Part,
    answer_of,
    open_remedies,
    worst_of,
    would_fix,
)
from dg_localization.fleet.best_point.stated_way import carried_on
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints, constrain
from dg_localization.fleet.contradictions.explanation import (
    corrected,
    links_of_conflicts,
    not_searched,
    observations_of,
    reason_of,
    suspects_in_window,
    suspects_of,
)
from dg_localization.fleet.estimate import Estimate, FrameKind, Group
from dg_localization.fleet.frames.finders import fit_with_past
from dg_localization.fleet.frames.plan import Plans, plan_frames
from dg_localization.fleet.rigidity import NOT_RIGID
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import Conflict, LinkKey
from dg_localization.fleet.window.earlier_sets import EarlierSets
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.memory import Ends
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import Recollection, narrow_answer, recall
from dg_localization.interval.environment import default_environment
from dg_localization.interval.rounding import down, up
from dg_localization.solver.options import Cancel
from dg_localization.solver.result import Statistics, Verdict


@default_environment()
def estimate_snapshot(
    snapshot: Snapshot,
    cancel: Cancel | None = None,
    proved: Sequence[Proved] = (),
    earlier: EarlierSets | None = None,
) -> tuple[Estimate, tuple[Proved, ...]]:
    """Find every placement that agrees with a snapshot, or the reason why there is none."""
    began_s = time.perf_counter()
    earlier = earlier or EarlierSets()
    recalled = recall(snapshot, proved, cancel, earlier)
    if recalled.forgotten or recalled.in_doubt or snapshot.config.memory_s <= 0.0:
        # A robot may have been carried away: what was likely is not any more.
        earlier.likely = {}
    if recalled.forgotten:
        # Readings that contradict each other prove nothing about the memory.
        contradiction = _contradiction_of_moment(snapshot, recalled, cancel)
        if contradiction is not None:
            return contradiction, ()
    snapshot, by_memory = recalled.snapshot, recalled.forgotten
    # Without a measurement of now, the odometry of a robot that has a set must be young.
    if not snapshot.keys and not any(map(snapshot.odometry_is_young, recalled.carried_robots)):
        return _without_data(snapshot, recalled.forgotten), ()
    in_window = suspects_in_window(snapshot, recalled.pose_sets, recalled.budget.has_passed(0.5))
    recalled_s = time.perf_counter()
    # The solver comes next; it has its own time limit.
    recalled.clock.pause()
    remembered = recalled.pose_sets.distances(snapshot)
    constraints = constrain(snapshot, recalled.replaced, remembered)
    options = _solver_options(snapshot, recalled)
    found, plans = _solve(snapshot, constraints, options, cancel=cancel)
    if found.verdict is Verdict.INFEASIBLE:
        earlier.likely = {}
    if found.verdict is Verdict.INFEASIBLE and recalled.pose_sets.sets:
        recalled = recalled.without_pose_sets()
        if not snapshot.keys:
            return _without_data(snapshot, recalled.forgotten), ()
        constraints = constrain(snapshot)
        found, plans = _solve(snapshot, constraints, snapshot.solver, cancel=cancel)
    if found.verdict is Verdict.INFEASIBLE:
        estimate = _explained(snapshot, constraints, found.statistics, cancel)
        # The moment contradicts itself: that proves nothing about the rest of the memory.
        forgotten = (*by_memory, *estimate.forgotten)
        return replace(estimate, suspects_in_window=in_window, forgotten=forgotten), ()
    solved_s = time.perf_counter()
    alone = [part.plan for part in found.parts if part.n_hypotheses == 1]
    refit = partial(fit_with_past, snapshot, constraints, alone)
    narrowed = narrow_answer(found, recalled, refit)
    found_now, main = narrowed.answer, found.main
    if found_now is found and main is not None and len(main.placements) == 1:
        found_now = found._replace(main=main.leaving((refit(main.plan, main.placements[0]),)))
    if snapshot.config.memory_s > 0.0:
        found_now = _with_likely_poses(snapshot, found_now, earlier)
    estimate = _answered(snapshot, found_now, [plans])
    doubts = [f'what {robot} remembers is in doubt' for robot in recalled.in_doubt]
    if estimate.misfits:
        doubts.append(f'bounds look too narrow: {", ".join(estimate.misfits)}')
    estimate = replace(
        estimate,
        reason='; '.join([estimate.reason, *dict.fromkeys(narrowed.ruled_out), *doubts]),
        suspects_in_window=in_window,
        ruled_out=narrowed.ruled_out,
        forgotten=narrowed.forgotten,
        seconds={
            'memory_s': recalled_s - began_s,
            'moment_s': solved_s - recalled_s,
            'narrow_and_fit_s': time.perf_counter() - solved_s,
        },
    )
    return estimate, narrowed.proved


def _with_likely_poses(snapshot: Snapshot, found: Answer, earlier: EarlierSets) -> Answer:
    """Return an answer with the likeliest poses of its robots, and keep them for the next."""
    kept, earlier.likely = earlier.likely, {}
    main = found.main
    if main is None or snapshot.config.dimension != 2 or len(main.placements) != 1:
        return found
    if main.plan.frame.kind is not FrameKind.ANCHORS:
        return found
    placement, earlier.likely = carried_on(snapshot, main.placements[0], kept)
    return found._replace(main=main.leaving((placement,)))


def _contradiction_of_moment(
    snapshot: Snapshot, recalled: Recollection, cancel: Cancel | None
) -> Estimate | None:
    """Return the explained contradiction between readings of now; None if they agree."""
    recalled.clock.pause()
    constraints = constrain(snapshot)
    found, _ = _solve(snapshot, constraints, snapshot.solver, cancel=cancel)
    if found.verdict is Verdict.INFEASIBLE:
        return _explained(snapshot, constraints, found.statistics, cancel)
    recalled.clock.resume()
    return None


def _solver_options(snapshot: Snapshot, recalled: Recollection) -> SolverOptions:
    """
    Return the options of the solver.

    In the plane, pose sets of all robots narrow the answer more than tightened bounds, which take
    twice as long as all the rest.
    """
    config = snapshot.config
    placed = {config.robots[robot] for robot in recalled.pose_sets.covers} | config.anchors.keys()
    if config.dimension == 2 and placed >= {*config.robots}:
        return replace(snapshot.solver, tighten_seconds=0.0)
    return snapshot.solver


def _solve(
    snapshot: Snapshot,
    constraints: Constraints,
    options: SolverOptions,
    dropped: frozenset[LinkKey] = frozenset(),
    cancel: Cancel | None = None,
) -> tuple[Answer, Plans]:
    """Return the answer in newly planned frames, and the plans."""
    (plans,) = plan_frames(snapshot, constraints, [constraints])
    return answer_of(snapshot, constraints, plans, options, dropped, cancel), plans


def _without_data(snapshot: Snapshot, forgotten: tuple[Forgotten, ...]) -> Estimate:
    """Return the estimate if there is nothing to solve, with the reason."""
    ages_s = [link.age_s for link in snapshot.links if link.age_s >= 0.0]
    if not snapshot.links:
        reason = 'no usable measurement has arrived yet'
    elif any(link.contradicts for link in snapshot.links):
        reason = 'all fresh measurements contradict what was measured before, and are left out'
    elif not all(link.stale for link in snapshot.links):
        reason = 'range differences alone place no robot without young odometry and a memory'
    elif not ages_s:
        reason = (
            'all measurements are later than the answer, which is for the time of the odometry'
        )
    else:
        reason = (
            f'all measurements are stale: the youngest is {min(ages_s):.2f} s old, '
            f'max_age is {snapshot.config.max_age_s:g} s'
        )
    return _estimate(snapshot, None, reason, forgotten=forgotten)


def _estimate(
    snapshot: Snapshot,
    verdict: Verdict | None,
    reason: str,
    conflicts: tuple[Conflict, ...] = (),
    **answer: Any,
) -> Estimate:
    """Return an estimate of a snapshot, with the links in conflicts marked."""
    guilty = {key for conflict in conflicts for key in conflict}
    return Estimate(
        stamp_s=snapshot.stamp_s,
        robots=snapshot.config.robots,
        verdict=verdict,
        reason=reason,
        links=tuple(
            replace(link, contradicts=True) if link.key in guilty else link
            for link in snapshot.links
        ),
        conflicts=conflicts,
        landmarks=snapshot.config.landmarks,
        **answer,
    )


def _answered(
    snapshot: Snapshot, found: Answer, plans: Sequence[Plans], conflicts: tuple[Conflict, ...] = ()
) -> Estimate:
    """
    Return the estimate of an answer, with as many placements as may be listed.

    The plans belong to alternatives; all have the same frame, or none.
    """
    config, main, most = snapshot.config, found.main, snapshot.config.max_hypotheses
    apart: dict[str, Any] = {
        'groups': tuple(
            Group(one.robots(config), one.plan.frame, one.placements[:most], one.n_hypotheses)
            for one in found.groups
        ),
        'rigid_groups': found.rigidity.pieces,
        'would_fix': would_fix(config, found),
    }
    if main is None:
        reason = '; '.join(filter(None, [plans[0].reason, *_open_texts(config, found)]))
        return _estimate(snapshot, None, reason, **apart)
    return _estimate(
        snapshot,
        found.verdict,
        _reason(snapshot, found, main, plans),
        conflicts,
        placements=main.placements[:most],
        n_hypotheses=main.n_hypotheses,
        statistics=found.statistics,
        frame=main.plan.frame,
        frame_doubt=plans[0].reason,
        **apart,
    )


def _reason(snapshot: Snapshot, found: Answer, main: Part, plans: Sequence[Plans]) -> str:
    """Return a sentence that describes the placements."""
    config, count = snapshot.config, main.n_hypotheses
    limit, *groups = _open_texts(config, found)
    parts = ['1 placement' if count == 1 else f'{count} placements', limit]
    if count > config.max_hypotheses:
        parts.append(f'only {config.max_hypotheses} are listed (max_hypotheses)')
    if any(placement.flexible for placement in main.placements):
        parts.append('the fleet may still move without any measurement changing')
        parts += open_remedies(config, found)[:1]
    dropped = sorted({str(key) for place in main.placements for key in place.dropped})
    if dropped:
        parts.append(f'contradicting links are left out: {", ".join(dropped)}')
    parts.append(plans[0].reason)
    placed = {config.points[i] for one in plans if one.main is not None for i in one.main.points}
    placed.update(robot for group in found.groups for robot in group.robots(config))
    lost = [robot for robot in config.robots if robot not in placed]
    if lost:
        parts.append(f'not connected: {", ".join(lost)}')
    parts += groups
    # Links with a negative age have measured nothing yet at the time of the answer.
    stale = sum(link.stale and link.age_s >= 0.0 for link in snapshot.links)
    if stale:
        parts.append('1 link is stale' if stale == 1 else f'{stale} links are stale')
    return '; '.join([*filter(None, parts), *snapshot.warnings])


def _open_texts(config: FleetConfig, found: Answer) -> list[str]:
    """Return a text on the effect of a limit, if any, and a text on each separate group."""
    is_open = found.verdict is Verdict.OUT_OF_BUDGET
    limit = 'the search stopped at its budget; what it left open is included' if is_open else ''
    groups = (', '.join(group.robots(config)) for group in found.groups)
    return [limit, *(f'in a frame of their own: {names}' for names in groups)]


def _explained(
    snapshot: Snapshot, constraints: Constraints, statistics: Statistics, cancel: Cancel | None
) -> Estimate:
    """Return the estimate if no placement agrees with all measurements."""
    observed = observations_of(snapshot)
    found = corrected(snapshot, constraints, observed, cancel)
    explanation, plans = found.explanation, found.plans
    conflicts = links_of_conflicts(observed, explanation)
    suspects = suspects_of(observed, explanation)
    blamed = observed.links_of(explanation.among.union(*explanation.conflicts))
    if found.answers:
        union = _union(found.answers, statistics)
        mains = [answer.main for answer in found.answers if answer.main is not None]
        blamed = blamed.union(*(place.dropped for main in mains for place in main.placements))
        estimate = _answered(snapshot, union, plans, conflicts)
        reason = estimate.reason + not_searched(snapshot.config, explanation)
        estimate = replace(estimate, reason=reason)
    else:
        why = plans[0].reason if plans else ''
        reason = reason_of(snapshot, observed, explanation, why)
        estimate = _estimate(
            snapshot, Verdict.INFEASIBLE, reason, conflicts, statistics=statistics
        )
    return replace(
        estimate,
        suspects=suspects,
        suspected_sensors=tuple(sorted(observed.offenders(suspects))),
        forgotten=_forget_guilty(snapshot, blamed),
    )


def _forget_guilty(snapshot: Snapshot, blamed: frozenset[LinkKey]) -> tuple[Forgotten, ...]:
    """
    Return the observations to forget if links contradict each other: one of them is wrong.

    Readings of the moment may be stamped up to `max_future_s` later.
    """
    config, now_s = snapshot.config, snapshot.stamp_s
    ends = frozenset(key.ends for key in blamed or snapshot.keys)
    if not any(_is_remembered(snapshot, pair) for pair in ends):
        return ()
    text = 'contradicting links are not remembered'
    before_s, after_s = up(now_s + config.max_future_s), down(now_s - config.max_age_s)
    return (Forgotten(ends, before_s, text, after_s),)


def _is_remembered(snapshot: Snapshot, ends: Ends) -> bool:
    """Return whether observations between two points are remembered, or will be."""
    config = snapshot.config
    moving = {config.robot_of(point) for point in ends}.difference(config.anchors)
    will_be = config.memory_s > 0.0 and bool(moving) and moving <= snapshot.motion.odometry.keys()
    return ends in snapshot.window.observations or will_be


def _union(answers: list[Answer], statistics: Statistics) -> Answer:
    """Return the union of answers, with their work added to `statistics`."""
    for found in answers:
        statistics += found.statistics
    mains = [found.main for found in answers if found.main is not None]
    placements = tuple(place for main in mains for place in main.placements)
    return Answer(
        verdict=worst_of([found.verdict for found in answers]),
        statistics=statistics,
        main=Part(mains[0].plan, placements, sum(main.n_hypotheses for main in mains)),
        # Corrections that drop different links may have different groups and frames.
        groups=answers[0].groups if len(answers) == 1 else (),
        rigidity=answers[0].rigidity if len(answers) == 1 else NOT_RIGID,
    )
