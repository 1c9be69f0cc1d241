# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Whom a window makes suspect that tolerates wrong readings."""

from __future__ import annotations

from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKind
from dg_localization.fleet.window.allowance import Allowance
from dg_localization.fleet.window.carry import WORLD
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.pairs import find_suspects
from dg_localization.solver.options import Cancel


def suspects_in_window(
    snapshot: Snapshot, pose_sets: PoseSets, cancel: Cancel | None = None
) -> tuple[Suspect, ...]:
    """
    Return the observations of a window that explain why it does not agree with itself.

    Parameters
    ----------
    snapshot : Snapshot
    pose_sets : PoseSets
        What the window leaves, outliers tolerated.
    cancel : Cancel, optional
        Ends the search when set.

    Returns
    -------
    tuple of Suspect
        Those of each pair of bodies that is proved to contradict itself.

    """
    if not snapshot.config.window_outliers:
        return ()
    allowance = Allowance(snapshot.config.memory_max_seconds, cancel)
    covers = {
        **{(WORLD, robot): cover for robot, cover in pose_sets.covers.items()},
        **pose_sets.relative,
    }
    found = []
    for number, (pair, cover) in enumerate(covers.items()):
        stopped = allowance.part(len(covers) - number)
        if stopped():
            continue
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
