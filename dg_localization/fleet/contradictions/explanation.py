# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Why a snapshot contradicts itself, in words and names."""

from __future__ import annotations

from collections.abc import Callable, Collection
import math

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.contradictions.conflicts import Explanation, Limits, explain
from dg_localization.fleet.contradictions.oracle import ContradictionOracle, small_parts
from dg_localization.fleet.contradictions.suspects import (
    Observations,
    Suspect,
    SuspectKind,
    Suspects,
    line_up,
)
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import Conflict, LinkKind
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.fleet.window.tables import WORLD
from dg_localization.poses import find_suspects
from dg_localization.solver.options import Cancel

OF_SETTINGS = (
    'the settings contradict each other, whatever is measured: anchors, mounts, elevations or '
    'min_separation'
)


def observations_of(snapshot: Snapshot) -> Observations:
    """Return who can be wrong in a snapshot."""
    config = snapshot.config
    return line_up(snapshot.keys, snapshot.detections, config.sensors, config.anchors)


def explain_snapshot(
    snapshot: Snapshot,
    observed: Observations,
    cancel: Cancel | None = None,
    refuted: Collection[Suspects] = (),
) -> Explanation:
    """
    Return which observations of a snapshot contradict each other, and who explains it.

    `refuted` are known to be no corrections.
    """
    config = snapshot.config
    kinds = list(SuspectKind)
    return explain(
        observed.observations,
        small_parts(snapshot, observed),
        [observed.covered_by(kind) for kind in kinds[kinds.index(config.outlier_unit) :]],
        ContradictionOracle(snapshot, observed, cancel),
        Limits(
            config.max_outliers, config.max_conflict_solves, config.max_conflict_seconds, cancel
        ),
        refuted,
        {one: observed.robots[one] for one in sorted(observed.of_anchors)},
    )


def suspects_of(observed: Observations, explanation: Explanation) -> tuple[Suspect, ...]:
    """Return whom an explanation makes suspect, with one name for what is of one sensor."""
    found: Suspects = frozenset()
    if explanation.corrections:
        found = found.union(*map(observed.in_short, explanation.corrections))
    elif explanation.culprits or explanation.together:
        found = frozenset(explanation.culprits).union(*explanation.together)
    else:
        found = explanation.among.union(*explanation.conflicts)
    return tuple(sorted(found))


def links_of_conflicts(observed: Observations, explanation: Explanation) -> tuple[Conflict, ...]:
    """Return the conflicts of an explanation as links, without those that need none."""
    links = (observed.links_of(conflict) for conflict in explanation.conflicts if conflict)
    return tuple(tuple(sorted(keys)) for keys in links)


def not_searched(config: FleetConfig, explanation: Explanation) -> str:
    """Return that limits ended the search before corrections of `max_outliers`, if they did."""
    if explanation.searched >= config.max_outliers:
        return ''
    return (
        f'; not searched: whether dropping more than {explanation.searched} explains it '
        f'(max_outliers is {config.max_outliers}; raise max_conflict_solves)'
    )


def reason_of(
    snapshot: Snapshot, observed: Observations, explanation: Explanation, frame: str
) -> str:
    """
    Return why a contradiction leaves no placements.

    `frame` says why there is none for what is left without the corrections; empty if there is one.
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
    Return the observations that explain why pairs of bodies do not agree with themselves.

    `pose_sets` are what the window leaves, outliers tolerated. Once `stopped` is true no other
    pair is looked at.
    """
    if not snapshot.config.window_outliers:
        return ()
    covers = {
        **{(WORLD, robot): cover for robot, cover in pose_sets.covers.items()},
        **pose_sets.relative,
    }
    found: set[Suspect] = set()
    for pair in snapshot.carried.pairs:
        if pair in covers and not stopped():
            sources = snapshot.carried.sources(pair)
            rows = find_suspects(snapshot.carried.readings(pair), covers[pair], stopped=stopped)
            found.update(_suspect(*sources[row]) for row in rows)
    return tuple(sorted(found))


def _suspect(observer: str, target: str, observation: Observation) -> Suspect:
    """Return an observation as a suspect."""
    measures = []
    if observation.direction is not None:
        measures.append(LinkKind.BEARING)
    if observation.has_distance:
        measures.append(LinkKind.RANGE)
    if observation.most_m < math.inf:
        measures.append(LinkKind.RANGE_DIFFERENCE)
    return Suspect(SuspectKind.OBSERVATION, observer, target, tuple(measures), observation.stamp_s)
