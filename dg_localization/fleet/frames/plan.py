# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The fixed frame: the choice of its axes and of the points with coordinates in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations
import math
from typing import NamedTuple

from dg_localization.fleet.bodies import MAX_CORES
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.estimate import FixedFrame, FrameKind
from dg_localization.fleet.rotations import angles_rad
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.arrays import Interval


class FramePlan(NamedTuple):
    """
    The points connected to the fixed frame, and the cores that give them coordinates.

    Parameters
    ----------
    frame : FixedFrame
    points : tuple of int
        The connected points, ascending.
    cores : tuple of tuple of int
        Choices of q points with a known place in the fixed frame, best first.

    """

    frame: FixedFrame
    points: tuple[int, ...]
    cores: tuple[tuple[int, ...], ...]

    @property
    def held(self) -> tuple[int, ...]:
        """The row of the robot whose body frame is the fixed frame, if there is one."""
        if self.frame.kind is not FrameKind.HEADING:
            return ()
        return (self.points.index(self.cores[0][0]),)

    def by_row(self, boxes: Mapping[int, Interval]) -> dict[int, Interval]:
        """Return the boxes of the points of the plan by row."""
        row_of = {point: row for row, point in enumerate(self.points)}
        return {row_of[point]: box for point, box in boxes.items() if point in row_of}


class Plans(NamedTuple):
    """
    The frames of a fleet.

    Parameters
    ----------
    main : FramePlan or None
        The plan of the points that fix the frame; None if nothing fixes it.
    reason : str
        A sentence that says why there is no main plan, or that another robot than the reference
        robot has the origin; empty otherwise.
    others : tuple of FramePlan
        One plan for each group of robots that is not connected to the fixed frame.

    """

    main: FramePlan | None
    reason: str
    others: tuple[FramePlan, ...]

    @property
    def all(self) -> tuple[FramePlan, ...]:
        """The plans of all frames, the main one last."""
        return self.others if self.main is None else (*self.others, self.main)


def plan_frames(
    snapshot: Snapshot, constraints: Constraints, alternatives: Sequence[Constraints]
) -> list[Plans]:
    """Choose one fixed frame for all alternatives, and frames for groups not connected to it."""
    reason = ''
    if snapshot.anchors.cores:
        plans = _plans_from_anchors(snapshot, alternatives)
        if not plans:
            names = ', '.join(snapshot.config.anchors)
            reason = f'no robot is connected to the anchors {names} by a usable range'
    else:
        plans, reason = _plans_from_reference(snapshot.config, constraints, alternatives)
    mains: Sequence[FramePlan | None] = plans or [None] * len(alternatives)
    return [
        Plans(main, reason, _plans_of_others(snapshot.config, alternative, main))
        for main, alternative in zip(mains, alternatives, strict=True)
    ]


def _plans_of_others(
    config: FleetConfig, constraints: Constraints, main: FramePlan | None
) -> tuple[FramePlan, ...]:
    """Return a plan for each further group of at least two points that has a robot."""
    visited = set(() if main is None else main.points)
    plans = []
    for robot in range(len(config.robots)):
        if robot not in visited:
            component = constraints.component_of(robot)
            visited.update(component)
            if _joins_others(config, component):
                plans += _plans_from_robot(config, robot, constraints, [constraints])
    return tuple(plans)


def _plans_from_anchors(
    snapshot: Snapshot, alternatives: Sequence[Constraints]
) -> list[FramePlan]:
    """Return plans in the coordinates of the anchors; empty if no robot is connected to them."""
    config, anchors = snapshot.config, snapshot.anchors
    frame = FixedFrame(FrameKind.ANCHORS, tuple(config.anchors))
    origin = anchors.cores[0][0]
    plans = [
        FramePlan(frame, alternative.component_of(origin), anchors.cores)
        for alternative in alternatives
    ]
    free = {i for i, robot in enumerate(config.robots) if robot not in config.anchors}
    if free and not any(free & set(plan.points) for plan in plans):
        return []
    return plans


def _plans_from_reference(
    config: FleetConfig, constraints: Constraints, alternatives: Sequence[Constraints]
) -> tuple[list[FramePlan], str]:
    """Return plans in the frame of the reference robot, or of the next one that is connected."""
    reference = config.robots.index(config.reference_robot)
    name = f'reference robot {config.reference_robot}'
    for robot in (*range(reference, len(config.robots)), *range(reference)):
        if any(_joins_others(config, other.component_of(robot)) for other in alternatives):
            plans = _plans_from_robot(config, robot, constraints, alternatives)
            if robot == reference:
                return plans, ''
            return plans, f'{name} is not connected: the frame is that of {config.robots[robot]}'
    return [], (
        f'{name} is not connected to any other by a usable range, nor is another robot: nothing '
        'fixes the frame'
    )


def _joins_others(config: FleetConfig, component: tuple[int, ...]) -> bool:
    """Return whether a component holds more than one robot and its sensors."""
    return len({config.robot_of(config.points[point]) for point in component}) > 1


def _plans_from_robot(
    config: FleetConfig,
    origin: int,
    constraints: Constraints,
    alternatives: Sequence[Constraints],
) -> list[FramePlan]:
    """Return plans with a robot at the origin."""
    components = [alternative.component_of(origin) for alternative in alternatives]
    headed = [
        _heading_cores(alternative, origin, points)
        for alternative, points in zip(alternatives, components, strict=True)
    ]
    if all(headed):
        frame = FixedFrame(FrameKind.HEADING, (config.robots[origin],))
        return [
            FramePlan(frame, points, cores)
            for points, cores in zip(components, headed, strict=True)
        ]
    core = _robot_core(config, constraints, origin, components)
    frame = FixedFrame(FrameKind.ROBOTS, tuple(config.points[i] for i in core))
    return [FramePlan(frame, points, (core,)) for points in components]


def _heading_cores(
    constraints: Constraints, origin: int, component: tuple[int, ...]
) -> tuple[tuple[int, ...], ...]:
    """Return sets of the origin and q - 1 of its targets whose rays fix its heading."""
    rows = constraints.rows
    rays = [
        ray
        for ray in constraints.rays.get(constraints.points[origin], ())
        if rows[ray.key.target] in component
        and ray.half_width_rad < math.pi / 2
        and constraints.lower[origin, rows[ray.key.target]] > 0.0
    ]
    if constraints.dimension == 2:
        rays.sort(key=lambda ray: ray.half_width_rad)
        return tuple((origin, rows[ray.key.target]) for ray in rays[:MAX_CORES])
    margins = {}
    for a, b in combinations(rays, 2):
        angle = float(angles_rad(a.direction, b.direction))
        margin = min(angle, math.pi - angle) - a.half_width_rad - b.half_width_rad
        if margin > 0.0:
            margins[origin, rows[a.key.target], rows[b.key.target]] = margin
    return tuple(sorted(margins, key=lambda core: -margins[core])[:MAX_CORES])


def _robot_core(
    config: FleetConfig,
    constraints: Constraints,
    origin: int,
    components: Sequence[tuple[int, ...]],
) -> tuple[int, ...]:
    """
    Return the reference robot and the next robots that every alternative connects to it.

    A robot that may be at the place of the reference robot gives no direction: such robots are
    chosen only if there are no others. This is decided with all links, including those that an
    alternative drops, so that the frame does not turn with them.
    """
    n_robots, n_points = len(config.robots), len(config.robots) + len(config.landmarks)
    in_order = [*range(origin + 1, n_robots), *range(origin), *range(n_robots, n_points)]
    shared = set.intersection(*(set(component) for component in components))
    connected = [point for point in in_order if point in shared]
    connected.sort(key=lambda point: constraints.lower[origin, point] <= 0.0)
    return (origin, *connected[: config.dimension - 1])
