"""The fixed frame: what defines its axes, and which points have coordinates in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
import math

from dg_localization.fleet.bodies import MAX_CORES
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.directions import angles_rad
from dg_localization.fleet.estimate import FixedFrame, FrameKind
from dg_localization.fleet.snapshot import Snapshot


@dataclass(frozen=True)
class FramePlan:
    """
    How the points that are connected to the fixed frame get their coordinates.

    Parameters
    ----------
    frame : FixedFrame
    points : tuple of int
        The connected points, ascending.
    cores : tuple of tuple of int
        Choices of q of them whose place in the fixed frame is known, best first.

    """

    frame: FixedFrame
    points: tuple[int, ...]
    cores: tuple[tuple[int, ...], ...]


def plan_frames(
    snapshot: Snapshot, constraints: Constraints, alternatives: Sequence[Constraints]
) -> list[FramePlan] | str:
    """
    Choose one fixed frame for all alternatives.

    Parameters
    ----------
    snapshot : Snapshot
    constraints : Constraints
        What all links of a snapshot say, contradictions included.
    alternatives : sequence of Constraints
        What they say when some are left out.

    Returns
    -------
    list of FramePlan or str
        One plan for each alternative, or a sentence that says why there is no frame.

    """
    if snapshot.anchors.cores:
        return _plan_from_anchors(snapshot, alternatives)
    return _plan_from_reference(snapshot.config, constraints, alternatives)


def _plan_from_anchors(
    snapshot: Snapshot, alternatives: Sequence[Constraints]
) -> list[FramePlan] | str:
    """Return plans in the coordinates of the anchors, or why there are none."""
    config, anchors = snapshot.config, snapshot.anchors
    names = tuple(config.anchors)
    frame = FixedFrame(FrameKind.ANCHORS, names)
    origin = anchors.cores[0][0]
    plans = [
        FramePlan(frame, alternative.component_of(origin), anchors.cores)
        for alternative in alternatives
    ]
    free = {i for i, robot in enumerate(config.robots) if robot not in config.anchors}
    if free and not any(free & set(plan.points) for plan in plans):
        return f'no robot is connected to the anchors {", ".join(names)} by a usable range'
    return plans


def _plan_from_reference(
    config: FleetConfig, constraints: Constraints, alternatives: Sequence[Constraints]
) -> list[FramePlan] | str:
    """Return plans in the frame of the reference robot, or why there are none."""
    origin = config.robots.index(config.reference_robot)
    components = [alternative.component_of(origin) for alternative in alternatives]
    if all(len(points) == 1 for points in components):
        return (
            f'reference robot {config.reference_robot} is not connected to any other by a usable '
            'range: nothing fixes the frame'
        )
    headed = [
        _heading_cores(alternative, origin, points)
        for alternative, points in zip(alternatives, components, strict=True)
    ]
    if all(headed):
        frame = FixedFrame(FrameKind.HEADING, (config.reference_robot,))
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
    Return the reference robot and the next ones that every alternative connects to it.

    A robot that may be in the same place as the reference robot gives no direction: such robots
    are chosen only when there are no others. What is left out to resolve a contradiction does not
    count here: the frame should not turn because of it.
    """
    n_robots, n_points = len(config.robots), len(config.points)
    in_order = [*range(origin + 1, n_robots), *range(origin), *range(n_robots, n_points)]
    shared = set.intersection(*(set(component) for component in components))
    connected = [point for point in in_order if point in shared]
    connected.sort(key=lambda point: constraints.lower[origin, point] <= 0.0)
    return (origin, *connected[: config.dimension - 1])
