# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Robots as bodies: their sensors are points with known mutual distances and directions.

The ray from one sensor of a robot to another follows from their mounts. It is not measured, does
not age, and is exact within the bounds of the mounts. Together with it, a measured ray gives an
angle at the sensor and, where certain, a chirality; the places of two sensors give a heading.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from dg_localization.fleet.bodies import boxes_around, squared_distances
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.sensors import Mount
from dg_localization.fleet.vocabulary import LinkKey, LinkKind, RayReading
from dg_localization.interval.angles import angle_up, arcsine_up
from dg_localization.interval.arrays import Interval
from dg_localization.interval.bounds import quotient_up, sqrt_down, sqrt_up, sum_up
from dg_localization.poses import PairReadings


class MountGeometry(NamedTuple):
    """
    The sensors of all robots.

    Parameters
    ----------
    members : mapping of str to tuple of str
        The points of each robot with sensors: the robot itself, then its sensors.
    distances : tuple of (str, str, float, float)
        All pairs of points of one robot with bounds of their squared distance in m^2.
    rays : mapping of str to tuple of RayReading
        For each of these points, the directions to the others of its robot, in the body frame.
    arms_m : mapping of str to numpy.ndarray, shape (3,)
        The lever arms of the sensors in the body frame.
    reach_m : mapping of str to float
        Bound of the distance of each sensor from the origin of its robot.

    """

    members: Mapping[str, tuple[str, ...]]
    distances: tuple[tuple[str, str, float, float], ...]
    rays: Mapping[str, tuple[RayReading, ...]]
    arms_m: Mapping[str, np.ndarray]
    reach_m: Mapping[str, float]


NO_MOUNTS = MountGeometry({}, (), {}, {}, {})


def mount_geometry(config: FleetConfig) -> MountGeometry:
    """Return the geometry of the sensors from their places."""
    members = {robot: config.points_on(robot) for robot, own in config.mounts.items() if own}
    distances: list[tuple[str, str, float, float]] = []
    rays: dict[str, list[RayReading]] = {}
    for points in members.values():
        mounts = _mounts_of(config, points)
        places_m = np.array([mount.position_m for mount in mounts])
        distances += squared_distances(points, places_m, [mount.bound_m for mount in mounts])
    for first, second, s_lower_m2, _ in distances:
        for ends in ((first, second), (second, first)):
            ray = _ray(ends, _mounts_of(config, ends), s_lower_m2)
            if ray is not None:
                rays.setdefault(ends[0], []).append(ray)
    return MountGeometry(
        members,
        tuple(distances),
        {observer: tuple(known) for observer, known in rays.items()},
        {point: _in_space(mount.position_m) for point, mount in config.sensors.items()},
        {second: sqrt_up(s_m2) for first, second, _, s_m2 in distances if first in members},
    )


def _mounts_of(config: FleetConfig, points: Sequence[str]) -> list[Mount]:
    """Return the mounts of points; robots are at the origins of their body frames."""
    origin = Mount((0.0,) * config.dimension)
    return [config.sensors.get(point, origin) for point in points]


def places_on_body(config: FleetConfig, points: Sequence[str]) -> Interval:
    """Return the places of points in the body frames of their robots."""
    mounts = _mounts_of(config, points)
    places_m = np.array([_in_space(mount.position_m) for mount in mounts]).reshape(-1, 3)
    bounds_m = np.zeros((len(mounts), 3))
    bounds_m[:, : config.dimension] = np.array([[mount.bound_m] for mount in mounts])
    return boxes_around(places_m, bounds_m)


Sight: TypeAlias = tuple[str, Interval, tuple[float, float], ArrayLike, float]
"""A point, the place (q,) of another, bounds of their distance, a ray, and its error in rad."""

AHEAD = (1.0, 0.0, 0.0)
"""A placeholder for a ray that was not measured."""


def readings_of(config: FleetConfig, sights: Sequence[Sight]) -> PairReadings:
    """Return the readings from points of one robot to places in the plane."""
    points, places, bounds_m, rays, errors_rad = zip(*sights, strict=True)
    there, flat = Interval.stack([*places], axis=0), ((0, 0), (0, 1))
    return PairReadings.of(
        Interval(np.pad(there.lower, flat), np.pad(there.upper, flat)),
        places_on_body(config, points),
        Interval(*np.array(bounds_m).T),
        np.array(rays),
        np.array(errors_rad),
        True,
    )


def _ray(ends: tuple[str, str], mounts: Sequence[Mount], s_lower_m2: float) -> RayReading | None:
    """Return the direction from one sensor to another; None if it is unbounded."""
    observer, target = mounts
    line_m = _in_space(target.position_m) - _in_space(observer.position_m)
    bound_m = sum_up(observer.bound_m, target.bound_m)
    # The line between the nominal places is longer than the least distance with errors.
    d_lower_m = sqrt_down(s_lower_m2)
    if not 0.0 <= bound_m < d_lower_m:
        return None
    half_width_rad = 0.0 if bound_m == 0.0 else arcsine_up(quotient_up(bound_m, d_lower_m))
    key = LinkKey(LinkKind.BEARING, *ends)
    direction = line_m / np.linalg.norm(line_m)
    return RayReading(key, 0.0, direction, angle_up(half_width_rad))


def _in_space(position_m: tuple[float, ...]) -> np.ndarray:
    """Return a position with three coordinates."""
    # `np.pad` takes ten times as long.
    return np.array([*position_m, 0.0][:3])
