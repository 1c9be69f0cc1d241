# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Snapshots: the measurements at one time, each reading aged to it, without later ones.

A distance measured dt ago holds now within the displacement of its two ends since. A ray keeps
its stamp: the solver uses angles between rays, and rays of one image turn together.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
import math
from types import MappingProxyType
from typing import TypeAlias

from dg_localization.fleet.best_point.terms import LEAST_HALF_WIDTH
from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.measurements import MeasurementStore
from dg_localization.fleet.motion import Motion
from dg_localization.fleet.mounts import NO_MOUNTS, MountGeometry
from dg_localization.fleet.vocabulary import (
    DistanceReading,
    LinkKey,
    LinkKind,
    LinkState,
    RayReading,
)
from dg_localization.fleet.window.carry import CarriedWindow
from dg_localization.fleet.window.memory import NO_WINDOW, Ends, Spans, Window
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import product_up, sum_down, sum_up
from dg_localization.solver.options import SolverOptions

Displacement: TypeAlias = Callable[[str, float], float]
"""Returns the greatest displacement in m of a point since a time in s."""


@dataclass(frozen=True)
class Snapshot:
    """
    All inputs of an estimate at one time; later measurements do not change it.

    Parameters
    ----------
    config : FleetConfig
    stamp_s : float
    distances : tuple of DistanceReading
        One for each range link in use: the intersection of its readings at `stamp_s`.
    rays : tuple of RayReading
        The newest ray of each bearing link in use, with the displacement since.
    motion : Motion
    anchors : AnchorGeometry
    links : tuple of LinkState
        Every link of ranges, bearings or range differences that has ever delivered a reading.
    window : Window
        The observations of the last `memory_s`.
    mounts : MountGeometry
    detections : frozenset of (str, str)
        The observers and targets whose ray in use shares its stamp with one of their ranges: both
        come from one detection, and are wrong together or not at all.
    tighten_seconds : float
        Limit of `SolverOptions.tighten_seconds`; the smaller value counts.
    number : int
        The serial number among the snapshots of its localizer.
    warnings : tuple of str
        Warnings about the inputs, one sentence each.

    """

    config: FleetConfig
    stamp_s: float
    distances: tuple[DistanceReading, ...]
    rays: tuple[RayReading, ...]
    motion: Motion
    anchors: AnchorGeometry
    links: tuple[LinkState, ...]
    window: Window = NO_WINDOW
    mounts: MountGeometry = NO_MOUNTS
    detections: frozenset[Ends] = frozenset()
    tighten_seconds: float = math.inf
    number: int = 0
    warnings: tuple[str, ...] = ()

    @cached_property
    def carried(self) -> CarriedWindow:
        """The window carried to the poses of the robots now; made on first use."""
        return CarriedWindow(self.stamp_s, self.window, self.motion, self.anchors)

    @property
    def solver(self) -> SolverOptions:
        """The options of the solver."""
        options = self.config.solver
        seconds = min(options.tighten_seconds, self.tighten_seconds)
        return replace(options, tighten_seconds=seconds)

    def odometry_is_young(self, robot: str) -> bool:
        """Return whether the newest odometry of a robot is no older than `max_age_s`."""
        readings = self.motion.odometry.get(robot, ())
        return bool(readings) and self.stamp_s - readings[-1].stamp_s <= self.config.max_age_s

    def without(self, forgotten: Spans, left_out: Collection[Ends]) -> Snapshot:
        """
        Return the snapshot without some observations.

        The window loses `forgotten` observations, the moment the links between `left_out` points.
        """

        def counts(key: LinkKey) -> bool:
            return key.ends not in left_out and key.ends[::-1] not in left_out

        return replace(
            self,
            distances=tuple(distance for distance in self.distances if counts(distance.key)),
            rays=tuple(ray for ray in self.rays if counts(ray.key)),
            links=tuple(
                link if counts(link.key) else replace(link, contradicts=not link.stale)
                for link in self.links
            ),
            window=self.window.without(forgotten),
        )

    @property
    def keys(self) -> tuple[LinkKey, ...]:
        """The links in use."""
        return (*(d.key for d in self.distances), *(r.key for r in self.rays))

    def ranges_of_anchors(
        self, points: Collection[str]
    ) -> Iterator[tuple[str, Interval, DistanceReading]]:
        """Yield the ranges of now between points and anchors: a point, a place and the reading."""
        for distance in self.distances:
            for end, other in (distance.key.ends, distance.key.ends[::-1]):
                if end in points and (row := self.config.rows[other]) in self.anchors.boxes:
                    yield end, self.anchors.boxes[row], distance


def take_snapshot(
    store: MeasurementStore,
    bodies: tuple[AnchorGeometry, MountGeometry],
    now_s: float,
    forgotten: Spans = MappingProxyType({}),
    left_out: Mapping[Ends, float] = MappingProxyType({}),
) -> Snapshot:
    """
    Return a snapshot of the measurements of `store` at `now_s`; see `Memory.view`.

    Readings up to the stamps in `left_out` do not count.
    """
    anchors, mounts = bodies
    config = store.config_for_clocks()
    motion = Motion(config, store.odometry_readings(now_s))

    @cache
    def displacement_m(point: str, stamp_s: float) -> float:
        origin_m = motion.displacement_m(point, stamp_s, now_s)
        if point not in mounts.reach_m:
            return origin_m
        turn_rad = motion.turn_up_rad(point, stamp_s, now_s)
        return sum_up(origin_m, product_up(mounts.reach_m[point], turn_rad))

    distances, rays, links = [], [], []
    young = {}
    for key, all_young in store.young_readings(now_s).items():
        until_s = max(left_out.get(ends, -math.inf) for ends in (key.ends, key.ends[::-1]))
        readings = [reading for reading in all_young if reading.stamp_s > until_s]
        young[key] = readings
        lower_m, upper_m = 0.0, math.inf
        measured = [reading for reading in readings if isinstance(reading, DistanceReading)]
        if measured and not key.reference:
            distance = _distance_at(now_s, key, measured, displacement_m, motion)
            lower_m, upper_m = distance.lower_m, distance.upper_m
            distances.append(distance)
        elif readings and isinstance(readings[-1], RayReading):
            ray = readings[-1]
            moved_m = _sum_up_m([displacement_m(end, ray.stamp_s) for end in key.ends])
            rays.append(replace(ray, displacement_m=moved_m))
        age_s = now_s - store.newest_stamp_s(key)
        contradicts = bool(all_young) and not readings
        state = LinkState(key, lower_m, upper_m, age_s, not all_young, contradicts)
        links.append(state)
    return Snapshot(
        config,
        now_s,
        tuple(distances),
        tuple(rays),
        motion,
        anchors,
        tuple(links),
        store.memory.view(now_s, forgotten),
        mounts,
        # The observers and targets of rays measured together with a range.
        frozenset(
            ray.key.ends
            for ray in rays
            for reading in young.get(ray.key._replace(kind=LinkKind.RANGE), ())
            if reading.stamp_s == ray.stamp_s
        ),
        warnings=tuple(store.warnings(now_s)),
    )


def _distance_at(
    now_s: float,
    key: LinkKey,
    readings: list[DistanceReading],
    displacement_m: Displacement,
    motion: Motion,
) -> DistanceReading:
    """
    Return the intersection of all readings of a link, each widened by the motion since.

    Readings may contradict each other in space only: in the plane a wide rise hides it.
    """
    lower_m, upper_m, lower_in_space_m, upper_in_space_m = 0.0, math.inf, 0.0, math.inf
    likeliest_m, total_weight = 0.0, 0.0
    for reading in readings:
        moves_m = [displacement_m(end, reading.stamp_s) for end in key.ends]
        moved_m = _sum_up_m(moves_m)
        if reading.in_space_m is not None:
            climbs_m = [motion.by_speed_m(end, reading.stamp_s, now_s) for end in key.ends]
            off_m, (least_m, most_m) = sum_up(*moves_m, *climbs_m), reading.in_space_m
            lower_in_space_m = max(lower_in_space_m, sum_down(least_m, -off_m))
            upper_in_space_m = min(upper_in_space_m, sum_up(most_m, off_m))
        if reading.upper_m < max(0.0, reading.lower_m):
            # The reading is empty: no distance gives it, whatever the motion since.
            moved_m = 0.0
        lower_m = max(lower_m, sum_down(reading.lower_m, -moved_m))
        upper_m = min(upper_m, sum_up(reading.upper_m, moved_m))
        if math.isfinite(reading.likeliest_m):
            half_width_m = 0.5 * (reading.upper_m - reading.lower_m) + moved_m
            # The square of the quotient underflows to zero; the squared width would overflow.
            weight = (1.0 / max(half_width_m, LEAST_HALF_WIDTH)) ** 2
            likeliest_m += weight * reading.likeliest_m
            total_weight += weight
    likeliest_m = likeliest_m / total_weight if total_weight else math.nan
    if lower_in_space_m > upper_in_space_m:
        lower_m, upper_m = lower_in_space_m, upper_in_space_m
    return DistanceReading(key, now_s, lower_m, upper_m, likeliest_m)


def _sum_up_m(moves_m: list[float]) -> float:
    """Return an upper bound of the sum of displacements; zero if there are none."""
    return sum_up(*moves_m) if any(moves_m) else 0.0
