# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which observations a window makes suspect that tolerates wrong readings."""

from __future__ import annotations

from collections.abc import Callable

from dg_localization.fleet.contradictions.suspects import Suspect, SuspectKind
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKind
from dg_localization.fleet.window.carry import WORLD
from dg_localization.fleet.window.memory import Observation
from dg_localization.fleet.window.pose_sets import PoseSets
from dg_localization.poses import find_suspects


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
    return Suspect(SuspectKind.OBSERVATION, observer, target, tuple(measures), observation.stamp_s)
