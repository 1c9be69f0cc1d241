# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Whom a window makes suspect that tolerates wrong readings.

What the boxes of pose sets show takes milliseconds. Ranges of two robots are explained besides:
which smallest sets have to be wrong so that a motion of both agrees with the rest. That takes a
tenth of a second and more, and shows nearly all that the ranges and odometries of a pair tell.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
import math
from typing import TypeAlias

import numpy as np

from dg_localization.fleet.contradictions.conflicts import Effort, Limits, explain
from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind, Suspects
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKind
from dg_localization.fleet.window.carry import WORLD, Pair
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.mutual_walk import MutualWalk
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.interval.kernels import COMPILED
from dg_localization.pairs import PairOptions, cover_poses, find_suspects

SuspectsByPair: TypeAlias = Mapping[Pair, Suspects]
"""Of pairs with pose sets; those that are not shown to contradict themselves have none."""

MOST_EXPLAINED = 50
"""The newest observations of a pair: those of a contradiction are mostly near to each other."""

GLANCE = PairOptions(resolution_m=0.1, max_boxes=64)
"""Poses that all of some readings allow: where there are none, that shows in few boxes."""


def suspects_in_window(
    snapshot: Snapshot, pose_sets: PoseSets, stopped: Callable[[], bool]
) -> SuspectsByPair:
    """
    Return the observations of a window that explain why it does not agree with itself.

    Parameters
    ----------
    snapshot : Snapshot
    pose_sets : PoseSets
        What the window leaves, outliers tolerated.
    stopped : callable
        Once it is true nobody else is looked at.

    Returns
    -------
    mapping of (int, int) to frozenset of Suspect
        Those of each pair of bodies that is proved to contradict itself.

    """
    if not snapshot.config.window_outliers:
        return {}
    covers = {
        **{(WORLD, robot): cover for robot, cover in pose_sets.covers.items()},
        **pose_sets.relative,
    }
    found: dict[Pair, Suspects] = {}
    for pair, cover in covers.items():
        found[pair] = frozenset()
        if not stopped():
            sources = snapshot.carried.sources(pair)
            readings = snapshot.carried.readings(pair)
            rows = find_suspects(readings, cover, stopped=stopped)
            found[pair] = frozenset(_suspect(*sources[row]) for row in rows)
    return found


def explain_window(
    snapshot: Snapshot, suspects: SuspectsByPair, stopped: Callable[[], bool]
) -> SuspectsByPair:
    """
    Return whom a window makes suspect where two robots are followed by their ranges.

    Parameters
    ----------
    snapshot : Snapshot
    suspects : mapping of (int, int) to frozenset of Suspect
        Whom the pose sets make suspect: pairs with suspects come first. Other pairs mostly agree,
        and are tried only where there is no limit of time (`memory_max_seconds`).
    stopped : callable
        Once it is true, other pairs keep the suspects they have. The limits `max_conflict_solves`
        and `max_conflict_seconds` are of each pair.

    Returns
    -------
    mapping of (int, int) to frozenset of Suspect
        In the plane, the observations of every smallest set without which a motion of the two
        robots may agree with the rest. Where no set that is tolerated does, everything in a
        conflict.

    """
    found = dict(suspects)
    if not COMPILED or snapshot.config.dimension != 2:
        return found
    is_unlimited = math.isinf(snapshot.config.memory_max_seconds)
    for pair in sorted(suspects, key=lambda pair: (not suspects[pair], pair)):
        is_worth_it = is_unlimited or bool(suspects[pair])
        if pair[0] != WORLD and is_worth_it and not stopped():
            found[pair] = _explained(snapshot, pair, suspects[pair], stopped)
    return found


def _explained(
    snapshot: Snapshot, pair: Pair, suspects: Suspects, stopped: Callable[[], bool]
) -> Suspects:
    """
    Return whom the ranges of two robots make suspect, and their pose set where that is not enough.

    Where the search ends before all smallest sets are found, those of the pose set stay; in each
    conflict somebody is wrong.
    """
    config, oracle = snapshot.config, _PairOracle(snapshot, pair, stopped)
    observations = frozenset(oracle.rows)
    explanation = explain(
        observations,
        [],
        [{one: frozenset([one]) for one in observations}],
        oracle,
        Limits(
            config.window_outliers,
            config.max_conflict_solves,
            config.max_conflict_seconds,
            _Stop(stopped),
        ),
    )
    corrected = frozenset().union(*explanation.corrections)
    if corrected and explanation.searched == config.window_outliers:
        return corrected | (suspects - observations)
    return corrected | (suspects or frozenset().union(*explanation.conflicts))


@dataclass(frozen=True)
class _Stop:
    """Cancels a search once `stopped` is true."""

    stopped: Callable[[], bool]

    def is_set(self) -> bool:
        """Return whether to stop."""
        return self.stopped()


class _PairOracle:
    """
    Decides whether observations of two robots contradict each other.

    Parameters
    ----------
    snapshot : Snapshot
        In the plane.
    pair : (int, int)
    stopped : callable
        Once it is true, what is not proved by then is not said.

    Attributes
    ----------
    rows : dict of Suspect to int
        The newest observations, and which of the window's they are.

    """

    def __init__(self, snapshot: Snapshot, pair: Pair, stopped: Callable[[], bool]) -> None:
        carried = snapshot.carried
        sources = carried.sources(pair)[:MOST_EXPLAINED]
        self.rows = {_suspect(*source): row for row, source in enumerate(sources)}
        self._distances = carried.distances(pair)
        self._readings = carried.readings_on_tracks(pair)
        self._paths = carried.path(pair[0]), carried.path(pair[1])
        self._memory_s, self._stopped = snapshot.config.memory_s, stopped

    def __call__(self, observations: Suspects, effort: Effort) -> bool:
        """Return whether no motion of both agrees with observations: true is a proof."""
        rows = sorted(self.rows[one] for one in observations)
        if effort is Effort.GLANCE:
            readings = self._readings[np.array(rows, np.intp)]
            return cover_poses(readings, GLANCE, stopped=self._stopped).empty
        if effort is Effort.BRIEF:
            seen = [self._distances[row] for row in rows]
            return MutualWalk(self._paths, seen, self._memory_s).contradicts(self._stopped)
        # Nothing shows more than that.
        return False


def _suspect(observer: str, target: str, observation: Observation) -> Suspect:
    """Return an observation as a suspect."""
    measures = []
    if observation.direction is not None:
        measures.append(LinkKind.BEARING)
    if observation.has_distance:
        measures.append(LinkKind.RANGE)
    return Suspect(SuspectKind.OBSERVATION, observer, target, tuple(measures), observation.stamp_s)
