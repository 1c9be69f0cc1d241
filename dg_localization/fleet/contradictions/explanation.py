# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Detection and explanation of contradictions between the observations of a snapshot."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import replace
from functools import partial
import math
from typing import NamedTuple

import numpy as np

from dg_localization.fleet.answers import Answer, answer_of, shared_time
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints, constrain
from dg_localization.fleet.contradictions.conflicts import Effort, Explanation, Limits, explain
from dg_localization.fleet.contradictions.suspects import (
    Links,
    Observations,
    Suspect,
    SuspectKind,
    Suspects,
)
from dg_localization.fleet.frames.plan import Plans, plan_frames
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import Conflict, LinkKey, LinkKind
from dg_localization.fleet.window.memory import Table
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.interval.arrays import Interval
from dg_localization.poses import NO_RAY_RAD, find_suspects
from dg_localization.solver.options import Cancel
from dg_localization.solver.result import Verdict
from dg_localization.solver.solve import solve

BRIEF_BOXES = 32
"""Most boxes of one brief solve: a contradiction shows early or rarely at all."""


MOST_SEARCHES = 3
"""Most searches for corrections, plus one per tolerated outlier. If all of them find corrections
that are wrong or not proved, there is no answer."""

OF_SETTINGS = (
    'the settings contradict each other, whatever is measured: anchors, mounts, elevations or '
    'min_separation'
)


class ContradictionOracle:
    """
    Decides whether observations of a snapshot contradict each other.

    Parameters
    ----------
    snapshot : Snapshot
    observed : Observations
        The observations of the snapshot.
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
        """Return whether no placement agrees with observations; true is a proof."""
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
        """Return the points of links, with the other points of their bodies that may help."""
        config, rows = self._snapshot.config, constraints.rows
        members = self._snapshot.mounts.members
        points = set()
        for key in links:
            for point in key.ends:
                robot = config.robot_of(point)
                points |= {rows[member] for member in members.get(robot, (point,))}
        if points & self._snapshot.anchors.boxes.keys():
            # These points decide the mirror image of the anchors.
            for known in self._snapshot.anchors.chiralities:
                points.update(known.points)
        return tuple(sorted(points))


def _triangles_hold(constraints: Constraints) -> bool:
    """Return whether all distances meet the triangle inequality over one other point."""
    distance = Interval(constraints.lower, constraints.upper).sqrt()
    return all(
        np.all(distance.lower <= (distance[:, point, None] + distance[None, point]).upper)
        for point in range(len(constraints.points))
    )


def _small_parts(snapshot: Snapshot, observed: Observations) -> Iterator[Suspects]:
    """
    Yield parts of the observations that concern few robots, small ones first.

    First single robots with the anchors, then pairs of robots, then robots with their neighbors.
    """
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


def observations_of(snapshot: Snapshot) -> Observations:
    """Return the observations of a snapshot that can be wrong, with their sensors and robots."""
    config, links = snapshot.config, _links_by_observation(snapshot)
    # All readings of a mounted point belong to one sensor; so do ranges and rays of detections.
    kinds: dict[str, set[LinkKind]] = {}
    for observation in links:
        if len(observation.measures) > 1 or observation.name in config.sensors:
            kinds.setdefault(observation.name, set()).update(observation.measures)
    sensors: dict[Suspect, set[Suspect]] = {}
    robots: dict[Suspect, set[Suspect]] = {}
    for observation in links:
        joined = kinds.get(observation.name, set())
        together = joined if joined & set(observation.measures) else observation.measures
        sensor = Suspect(SuspectKind.SENSOR, observation.name, measures=tuple(sorted(together)))
        sensors.setdefault(sensor, set()).add(observation)
        for point in (observation.name, observation.target):
            robot = Suspect(SuspectKind.ROBOT, config.robot_of(point))
            robots.setdefault(robot, set()).add(observation)
    return Observations(
        links,
        {suspect: frozenset(sensors[suspect]) for suspect in sorted(sensors)},
        {suspect: frozenset(robots[suspect]) for suspect in sorted(robots)},
        frozenset(suspect for suspect in robots if suspect.name in config.anchors),
    )


def _links_by_observation(snapshot: Snapshot) -> dict[Suspect, Links]:
    """Return the observations of a snapshot with their links; a detection has two."""
    parts: dict[tuple[str, ...], list[LinkKey]] = {}
    for key in sorted(snapshot.keys):
        part = key.ends if key.ends in snapshot.detections else (*key.ends, key.kind)
        parts.setdefault(part, []).append(key)
    links: dict[Suspect, Links] = {}
    for keys in parts.values():
        measures = tuple(key.kind for key in keys)
        links[Suspect(SuspectKind.OBSERVATION, *keys[0].ends, measures)] = frozenset(keys)
    return links


class Corrected(NamedTuple):
    """The explanation of a contradiction, and the answer of each correction in its frames."""

    explanation: Explanation
    plans: list[Plans]
    answers: list[Answer]

    def without(self, wrong: Collection[Suspects]) -> Corrected:
        """Return a copy without wrong corrections; the frames stay even if none is left."""
        corrections = self.explanation.corrections
        rows = [row for row, dropped in enumerate(corrections) if dropped not in wrong]
        return Corrected(
            self.explanation._replace(corrections=tuple(corrections[row] for row in rows)),
            [self.plans[row] for row in rows] or self.plans,
            [self.answers[row] for row in rows],
        )


def corrected(
    snapshot: Snapshot, constraints: Constraints, observed: Observations, cancel: Cancel | None
) -> Corrected:
    """
    Return the corrections of a contradiction, with their answers.

    The search for corrections uses less effort than an answer. If the answer of a correction shows
    a contradiction, the correction is refuted and the search is repeated with larger ones. If the
    answer does not prove that the rest agree, the correction is kept beside larger ones.
    """
    config, kinds = snapshot.config, list(SuspectKind)
    search = partial(
        explain,
        observed.observations,
        list(dict.fromkeys(_small_parts(snapshot, observed))),
        [observed.covered_by(kind) for kind in kinds[kinds.index(config.outlier_unit) :]],
        ContradictionOracle(snapshot, observed, cancel),
        Limits(
            config.max_outliers, config.max_conflict_solves, config.max_conflict_seconds, cancel
        ),
        anchors={one: observed.robots[one] for one in sorted(observed.of_anchors)},
    )
    refuted: frozenset[Suspects] = frozenset()
    unsure: frozenset[Suspects] = frozenset()
    for _ in range(MOST_SEARCHES + config.max_outliers):
        explanation = search(refuted | unsure)
        every = unsure.union(explanation.corrections)
        ordered = sorted(every, key=lambda dropped: (len(dropped), sorted(dropped)))
        explanation = explanation._replace(corrections=tuple(ordered))
        found = _with_answers(snapshot, constraints, observed, explanation, cancel)
        if not found.answers:
            return found
        answers = dict(zip(explanation.corrections, found.answers, strict=True))
        # The empty correction was refuted before, perhaps with more time than now.
        wrong = {d for d, a in answers.items() if a.verdict is Verdict.INFEASIBLE or not d}
        smaller = {d for d in answers if len(d) < explanation.searched}
        doubtful = {d for d in smaller - wrong if not _is_proved(snapshot, answers[d])}
        if smaller & wrong <= refuted and doubtful <= unsure:
            return found.without(wrong)
        refuted |= smaller & wrong
        unsure = (unsure | doubtful) - refuted
    stopped = explanation._replace(corrections=(), searched=0, stopped=True)
    return Corrected(stopped, found.plans, [])


def _with_answers(
    snapshot: Snapshot,
    constraints: Constraints,
    observed: Observations,
    explanation: Explanation,
    cancel: Cancel | None,
) -> Corrected:
    """Return an explanation with the answers of its corrections; no answers without a frame."""
    named = observed.covered_by(snapshot.config.outlier_unit)
    corrections = [
        observed.links_of(one for suspect in correction for one in named[suspect])
        for correction in explanation.corrections
    ]
    alternatives = [constrain(snapshot, dropped) for dropped in corrections]
    plans = plan_frames(snapshot, constraints, alternatives)
    if not plans or plans[0].main is None:
        return Corrected(explanation, plans, [])
    shares = shared_time(snapshot.solver, len(corrections))
    answers = [
        answer_of(snapshot, alternative, planned, options, dropped, cancel)
        for alternative, planned, dropped, options in zip(
            alternatives, plans, corrections, shares, strict=True
        )
    ]
    return Corrected(explanation, plans, answers)


def _is_proved(snapshot: Snapshot, found: Answer) -> bool:
    """Return whether some placement is proved to agree, or no proof is possible here."""
    if any(mount.bound_m == 0.0 for mount in snapshot.config.sensors.values()):
        return True
    return all(any(placement.proved for placement in part.placements) for part in found.parts)


def suspects_of(observed: Observations, explanation: Explanation) -> tuple[Suspect, ...]:
    """Return the suspects of an explanation; observations of one sensor share its name."""
    found: Suspects = frozenset()
    if explanation.corrections:
        found = found.union(*map(observed.in_short, explanation.corrections))
    elif explanation.culprits or explanation.together:
        found = frozenset(explanation.culprits).union(*explanation.together)
    else:
        found = explanation.among.union(*explanation.conflicts)
    return tuple(sorted(found))


def links_of_conflicts(observed: Observations, explanation: Explanation) -> tuple[Conflict, ...]:
    """Return the conflicts of an explanation as links, without the empty conflict."""
    links = (observed.links_of(conflict) for conflict in explanation.conflicts if conflict)
    return tuple(tuple(sorted(keys)) for keys in links)


def not_searched(config: FleetConfig, explanation: Explanation) -> str:
    """Return a note if limits ended the search before corrections of size `max_outliers`."""
    if explanation.searched >= config.max_outliers:
        return ''
    return (
        f'; not searched: whether dropping more than {explanation.searched} explains it '
        f'(max_outliers is {config.max_outliers}; the limits of the search ended it)'
    )


def reason_of(
    snapshot: Snapshot, observed: Observations, explanation: Explanation, frame: str
) -> str:
    """
    Return the reason why a contradiction leaves no placements.

    `frame` says why no frame is left after the corrections; it is empty if there is one.
    """
    config, links = snapshot.config, {link.key: link for link in snapshot.links}

    def listed(observations: Suspects) -> str:
        keys = sorted(observed.links_of(observations))
        return ', '.join(str(links.get(key, key)) for key in keys)

    if frozenset() in explanation.conflicts:
        return OF_SETTINGS
    text = 'the measurements contradict each other'
    conflicts = [listed(conflict) for conflict in explanation.conflicts]
    if explanation.among:
        conflicts.append(f'among {listed(explanation.among)}')
    if conflicts:
        text += ': ' + '; '.join(conflicts)
    if explanation.stopped:
        text += ' (the search for the cause stopped at its budget)'
    if frame and explanation.corrections:
        text += f'; without them, {frame}'
    elif explanation.searched:
        units = f'{config.outlier_unit}{"s" if explanation.searched > 1 else ""}'
        text += f'; dropping {explanation.searched} {units} does not make the rest agree'
    text += not_searched(config, explanation)
    if explanation.culprits:
        text += f'; each alone explains it: {", ".join(map(str, explanation.culprits))}'
    if explanation.together:
        pairs = ', or '.join(f'{first} and {second}' for first, second in explanation.together)
        text += f'; together these explain it: {pairs}'
    return text


def suspects_in_window(
    snapshot: Snapshot, pose_sets: PoseSets, stopped: Callable[[], bool]
) -> tuple[Suspect, ...]:
    """
    Return the observations that explain contradictions within pairs of bodies.

    `pose_sets` are the sets of the window with tolerated outliers. When `stopped` becomes true, no
    other pair is examined.
    """
    if not snapshot.config.window_outliers:
        return ()
    found: set[Suspect] = set()
    for pair, seen in snapshot.carried.tables.items():
        if pair in pose_sets.sets and not stopped():
            rows = find_suspects(
                snapshot.carried.readings(pair), pose_sets.sets[pair], stopped=stopped
            )
            found.update(_suspects_among(snapshot.config, seen.some(np.array(rows, dtype=int))))
    return tuple(sorted(found))


def _suspects_among(config: FleetConfig, seen: Table) -> Iterator[Suspect]:
    """Yield the rows of a table as suspects."""
    measured = {
        LinkKind.BEARING: seen.errors_rad < NO_RAY_RAD,
        LinkKind.RANGE: (seen.lower_m > 0.0) | (seen.upper_m < math.inf),
        LinkKind.RANGE_DIFFERENCE: seen.most_m < math.inf,
    }
    for row, (ends, stamp_s) in enumerate(zip(seen.ends, seen.stamps_s.tolist(), strict=True)):
        kinds = tuple(kind for kind, is_so in measured.items() if is_so[row])
        observer, target = (config.points[end] for end in ends)
        yield Suspect(SuspectKind.OBSERVATION, observer, target, kinds, stamp_s)
