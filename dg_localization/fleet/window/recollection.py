# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window says at the time of a snapshot, and what it leaves of an answer of the moment."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import FixedFrame, FrameKind, Placement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey
from dg_localization.fleet.window.allowance import Allowance
from dg_localization.fleet.window.carry import WORLD, Pair
from dg_localization.fleet.window.forgetting import Forgotten, also_forgotten
from dg_localization.fleet.window.memory import Ends
from dg_localization.fleet.window.pose_sets import NO_POSE_SETS, PoseSets, place_robots
from dg_localization.fleet.window.shape_headings import (
    COARSE_CELLS,
    FINE_CELLS,
    JOINT_BOXES,
    Narrowed,
    narrow_placement,
)
from dg_localization.pairs import HeadingOptions, PairReadings
from dg_localization.solver.options import Cancel

CONTRADICTS_NOW = 'what was measured before contradicts what is measured now'

MOST_PARTNERS = 4
"""Of each robot: near ones tell most of its heading, since errors of ranges grow with them."""

MOST_IN_TABLE = 40
"""Observations of a pair that narrow headings: more cost time and tell little more."""

MOST_REFINED = 16
"""Of more placements than these, the others get coarse headings only."""


@dataclass(frozen=True)
class Left:
    """
    The placements that a window leaves of some.

    Parameters
    ----------
    placements : tuple of Placement
    ruled_out : tuple of str
        A sentence on each placement that is impossible.

    """

    placements: tuple[Placement, ...]
    ruled_out: tuple[str, ...]


@dataclass(frozen=True)
class Recollection:
    """
    A window, carried to the time of a snapshot.

    Parameters
    ----------
    config : FleetConfig
    stamp_s : float
    allowance : Allowance
    readings : mapping of (int, int) to PairReadings
        What pairs of robots observed of each other.
    spans_s : mapping of (int, int) to float
        For how long they have, the world and a robot included.
    pose_sets : PoseSets
    replaced : frozenset of LinkKey
        The links of the moment that the pose sets stand for: any of them may be an outlier.
    forgotten : tuple of Forgotten
        What contradicts itself.

    """

    config: FleetConfig
    stamp_s: float
    allowance: Allowance
    readings: Mapping[Pair, PairReadings] = field(default_factory=dict)
    spans_s: Mapping[Pair, float] = field(default_factory=dict)
    pose_sets: PoseSets = NO_POSE_SETS
    replaced: frozenset[LinkKey] = frozenset()
    forgotten: tuple[Forgotten, ...] = ()

    def without_pose_sets(self) -> Recollection:
        """Return this without the pose sets, which contradict the moment, and forget them."""
        ends = _ends_of(self.config, [(WORLD, robot) for robot in self.pose_sets.covers])
        ends |= _ends_of(self.config, self.pose_sets.relative)
        forgotten = (*self.forgotten, Forgotten(ends, self.stamp_s, CONTRADICTS_NOW))
        return replace(self, pose_sets=NO_POSE_SETS, replaced=frozenset(), forgotten=forgotten)

    def without_anything(self) -> tuple[Forgotten, ...]:
        """Return what is forgotten where the window leaves no placement of the moment."""
        ends = _ends_of(self.config, self.spans_s)
        return (*self.forgotten, Forgotten(ends, self.stamp_s, CONTRADICTS_NOW))

    @property
    def empty(self) -> bool:
        """Whether there is nothing to narrow placements with."""
        return not self.readings and not self.pose_sets.covers

    def narrow(self, placements: Sequence[Placement], frame: FixedFrame) -> Left:
        """
        Return what the window leaves of placements in one frame.

        Parameters
        ----------
        placements : sequence of Placement
        frame : FixedFrame

        Returns
        -------
        Left

        """
        possible = self._tried(placements, frame, COARSE_CELLS, 0)
        most = possible.placements[:MOST_REFINED]
        refined = self._tried(most, frame, self._cells, JOINT_BOXES)
        others = possible.placements[MOST_REFINED:]
        return Left(refined.placements + others, possible.ruled_out + refined.ruled_out)

    @property
    def _cells(self) -> int:
        """How finely tables resolve headings: joint poses know neither rays nor outliers."""
        rays = any(np.isfinite(part.ray_errors_rad).any() for part in self.readings.values())
        return FINE_CELLS if rays or self.config.window_outliers else COARSE_CELLS

    def _tried(
        self, placements: Sequence[Placement], frame: FixedFrame, cells: int, max_boxes: int
    ) -> Left:
        """Return placements narrowed, those that are impossible left out."""
        left: list[Placement] = []
        ruled_out: list[str] = []
        lone = True
        for number, placement in enumerate(placements):
            options = HeadingOptions(cells, self.config.window_outliers, max_rounds=1)
            tasks = len(placements) - number
            narrowed = self._narrow(placement, frame, options, max_boxes, tasks)
            image = placement.mirrored or any(p.mirrored for p in placements[number + 1 :][:1])
            if narrowed.placement is not None:
                mirrored = placement.mirrored and not lone
                left.append(replace(narrowed.placement, mirrored=mirrored))
            elif narrowed.ruled_out_by is not None:
                ruled_out.append(self._sentence(image, narrowed.ruled_out_by))
            lone = narrowed.placement is None
        return Left(tuple(left), tuple(ruled_out))

    def _narrow(
        self,
        placement: Placement,
        frame: FixedFrame,
        options: HeadingOptions,
        max_boxes: int,
        tasks: int,
    ) -> Narrowed:
        """Return what the window leaves of one of some placements."""
        reference = 0
        if frame.kind is FrameKind.HEADING:
            reference = self.config.robots.index(frame.points[0])
        return narrow_placement(
            placement,
            frame.kind,
            reference,
            self.readings,
            self.pose_sets,
            options,
            max_boxes,
            self.allowance.part(tasks),
        )

    def _sentence(self, image: bool, pair: Pair) -> str:
        """Return what ruled out a placement."""
        first, second = pair
        robots = self.config.robots
        names = f'{"anchors" if first == WORLD else robots[first]} - {robots[second]}'
        what = 'mirror image' if image else 'hypothesis'
        return f'{what} ruled out by {names} over {self.spans_s[pair]:.0f} s'


def _ends_of(config: FleetConfig, pairs: Iterable[Pair]) -> frozenset[Ends]:
    """Return the points that pairs of bodies observe each other by."""
    robots = config.robots
    return frozenset(
        (robots[second], other)
        for first, second in pairs
        for other in (config.anchors if first == WORLD else (robots[first],))
    )


def recall(snapshot: Snapshot, cancel: Cancel | None) -> Recollection:
    """Return what the window of a snapshot says; in space nothing yet."""
    config = snapshot.config
    allowance = Allowance(config.memory_max_seconds, cancel)
    if config.dimension != 2 or not snapshot.window.observations:
        return Recollection(config, snapshot.stamp_s, allowance)
    carried = snapshot.carried
    pose_sets, forgotten = place_robots(snapshot, carried, allowance)
    contradicting = also_forgotten({}, forgotten)
    replaced = frozenset(
        key
        for key in carried.links_among(snapshot.keys)
        if config.window_outliers and not contradicting.keys() & {key.ends, key.ends[::-1]}
    )
    return Recollection(
        config,
        snapshot.stamp_s,
        allowance,
        {
            pair: carried.readings(pair, MOST_IN_TABLE)
            for pair in carried.near_pairs(MOST_PARTNERS)
        },
        {pair: carried.span_s(pair) for pair in carried.pairs},
        pose_sets,
        replaced,
        forgotten,
    )
