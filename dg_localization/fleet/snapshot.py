"""
What the measurements say at one time: every reading aged to it, nothing later.

A distance measured dt ago holds now within what its two ends can have moved since. A ray keeps
its stamp, because what counts is the angle between two rays, and rays of one image turn together.
"""

from __future__ import annotations

from dataclasses import dataclass
import math

import numpy as np

from dg_localization.fleet.anchors import AnchorGeometry
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import LinkKey, LinkState
from dg_localization.fleet.measurements import DistanceReading, MeasurementStore, RayReading
from dg_localization.fleet.motion import Motion


@dataclass(frozen=True)
class DistanceEvidence:
    """
    Bounds of a distance at the time of the snapshot, from all young readings of one link.

    Parameters
    ----------
    key : LinkKey
    first, second : int
        The two points, as indices into the points of the configuration.
    lower_m, upper_m : float
        Rounded outward. ``lower_m > upper_m`` when the readings contradict each other.

    """

    key: LinkKey
    first: int
    second: int
    lower_m: float
    upper_m: float


@dataclass(frozen=True)
class RayEvidence:
    """
    The newest ray of one link.

    Parameters
    ----------
    key : LinkKey
    observer, target : int
        Indices into the points of the configuration.
    stamp_s : float
    ray : numpy.ndarray, shape (3,)
        Unit vector in the body frame of the observer at the time of the stamp.
    half_width_rad : float
        Its error bound at that time.
    displacement_m : float
        How far the two ends can have moved since, together.

    """

    key: LinkKey
    observer: int
    target: int
    stamp_s: float
    ray: np.ndarray
    half_width_rad: float
    displacement_m: float


@dataclass(frozen=True)
class Snapshot:
    """
    Everything an estimate depends on, at one time; later measurements do not change it.

    Parameters
    ----------
    config : FleetConfig
    stamp_s : float
    distances : tuple of DistanceEvidence
    rays : tuple of RayEvidence
    motion : Motion
    anchors : AnchorGeometry
    links : tuple of LinkState
        Every range and bearing link that has ever delivered.

    """

    config: FleetConfig
    stamp_s: float
    distances: tuple[DistanceEvidence, ...]
    rays: tuple[RayEvidence, ...]
    motion: Motion
    anchors: AnchorGeometry
    links: tuple[LinkState, ...]

    @property
    def keys(self) -> tuple[LinkKey, ...]:
        """The links in use."""
        return (*(d.key for d in self.distances), *(r.key for r in self.rays))


def take_snapshot(
    store: MeasurementStore, config: FleetConfig, anchors: AnchorGeometry, now_s: float
) -> Snapshot:
    """Return what the measurements of `store` say at `now_s`."""
    motion = Motion(
        max_speed_m_s={point: config.speed_m_s(point) for point in config.points},
        max_turn_rate_rad_s=config.max_turn_rate_rad_s,
        relative_error=config.odometry_relative_error,
        tracks=store.odometry_samples(),
    )
    index = {point: i for i, point in enumerate(config.points)}
    distances, rays, links = [], [], []
    for key, readings in store.young_readings(now_s).items():
        first, second = index[key.observer], index[key.target]
        lower_m, upper_m = 0.0, math.inf
        ranges = [reading for reading in readings if isinstance(reading, DistanceReading)]
        if ranges:
            lower_m, upper_m = _aged_bounds_m(key, ranges, motion, now_s)
            distances.append(DistanceEvidence(key, first, second, lower_m, upper_m))
        elif readings and isinstance(readings[-1], RayReading):
            rays.append(_aged_ray(key, first, second, readings[-1], motion, now_s))
        age_s = now_s - store.newest_stamp_s(key)
        links.append(
            LinkState(key.kind, key.observer, key.target, lower_m, upper_m, age_s, not readings)
        )
    return Snapshot(config, now_s, tuple(distances), tuple(rays), motion, anchors, tuple(links))


def _aged_bounds_m(
    key: LinkKey, readings: list[DistanceReading], motion: Motion, now_s: float
) -> tuple[float, float]:
    """Return the common part of all readings after the motion since each."""
    lower_m, upper_m = 0.0, math.inf
    for reading in readings:
        moved_m = _moved_m(key, reading.stamp_s, motion, now_s)
        lower_m = max(lower_m, math.nextafter(reading.lower_m - moved_m, -math.inf))
        upper_m = min(upper_m, math.nextafter(reading.upper_m + moved_m, math.inf))
    return lower_m, upper_m


def _aged_ray(
    key: LinkKey, observer: int, target: int, reading: RayReading, motion: Motion, now_s: float
) -> RayEvidence:
    """Return the reading with the motion since."""
    moved_m = _moved_m(key, reading.stamp_s, motion, now_s)
    return RayEvidence(
        key, observer, target, reading.stamp_s, reading.ray, reading.half_width_rad, moved_m
    )


def _moved_m(key: LinkKey, stamp_s: float, motion: Motion, now_s: float) -> float:
    """Return how far both ends of a link can have moved since `stamp_s`, together."""
    ends = (key.observer, key.target)
    total = sum(motion.displacement_m(point, stamp_s, now_s) for point in ends)
    return math.nextafter(total, math.inf) if total > 0.0 else 0.0
