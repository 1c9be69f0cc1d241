# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whom a window makes suspect that tolerates wrong readings."""

from __future__ import annotations

from collections.abc import Callable

from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKind
from dg_localization.fleet.window.carry import WORLD
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.pairs import find_suspects


def suspects_in_window(
    snapshot: Snapshot, pose_sets: PoseSets, stopped: Callable[[], bool]
) -> tuple[Suspect, ...]:
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
    tuple of Suspect
        Those of each pair of bodies that is proved to contradict itself.

    """
    if not snapshot.config.window_outliers:
        return ()
    covers = {
        **{(WORLD, robot): cover for robot, cover in pose_sets.covers.items()},
        **pose_sets.relative,
    }
    found = []
    for pair, cover in covers.items():
        if stopped():
            break
        sources = snapshot.carried.sources(pair)
        for index in find_suspects(snapshot.carried.readings(pair), cover, stopped=stopped):
            found.append(_suspect(*sources[index]))
    return tuple(sorted(found))


def _suspect(observer: str, target: str, observation: Observation) -> Suspect:
    """Return an observation as a suspect."""
    measures = []
    if observation.direction is not None:
        measures.append(LinkKind.BEARING)
    if observation.has_distance:
        measures.append(LinkKind.RANGE)
    return Suspect(SuspectKind.OBSERVATION, observer, target, tuple(measures), observation.stamp_s)
