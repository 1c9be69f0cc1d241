"""
From a snapshot to what the solver is asked: squared distances and handedness.

Every step only ever intersects with something the true fleet satisfies, rounded outward.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.estimate import LinkKey
from dg_localization.fleet.intervals import (
    ROUNDING_RAD,
    Interval,
    cosine_of_angle,
    determinant,
)
from dg_localization.fleet.snapshot import RayEvidence, Snapshot
from dg_localization.solver.problem import Chirality, Problem

Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Ray:
    """
    The direction of one point from another in the body frame of the observer.

    Parameters
    ----------
    target : int
    direction : numpy.ndarray, shape (3,)
        Unit vector.
    half_width_rad : float
        Greatest angle to the true direction.

    """

    target: int
    direction: np.ndarray
    half_width_rad: float


@dataclass(frozen=True)
class Constraints:
    """
    What is known of the points at the time of a snapshot.

    Parameters
    ----------
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2.
    chiralities : tuple of Chirality
    rays : dict of int to tuple of Ray
        By observer, in its body frame at the time of the snapshot.
    dimension : int

    """

    lower: Matrix
    upper: Matrix
    chiralities: tuple[Chirality, ...]
    rays: dict[int, tuple[Ray, ...]]
    dimension: int

    @property
    def contradictory(self) -> bool:
        """Whether some distance is left without any value."""
        return bool((self.lower > self.upper).any())

    def component_of(self, point: int) -> tuple[int, ...]:
        """Return the points that bounded distances join to `point`, itself included, in order."""
        reached = {point}
        pending = [point]
        while pending:
            bounded = np.flatnonzero(np.isfinite(self.upper[pending.pop()]))
            new = set(bounded.tolist()) - reached
            reached |= new
            pending.extend(new)
        return tuple(sorted(reached))

    def problem(self, points: tuple[int, ...]) -> Problem:
        """Return the problem of some of the points, numbered as they are listed."""
        index = {point: i for i, point in enumerate(points)}
        chosen = np.ix_(points, points)
        return Problem(
            self.lower[chosen],
            self.upper[chosen],
            dimension=self.dimension,
            chiralities=[
                Chirality(tuple(index[p] for p in chirality.points), chirality.sign)
                for chirality in self.chiralities
                if all(p in index for p in chirality.points)
            ],
        )


def constrain(snapshot: Snapshot, dropped: frozenset[LinkKey] = frozenset()) -> Constraints:
    """
    Return what a snapshot says about the points, some links left out.

    Parameters
    ----------
    snapshot : Snapshot
    dropped : frozenset of LinkKey
        Links that do not count.

    Returns
    -------
    Constraints

    """
    config = snapshot.config
    n_points = len(config.points)
    lower = np.zeros((n_points, n_points))
    upper = np.full((n_points, n_points), np.inf)
    np.fill_diagonal(upper, 0.0)
    for i, j, low_m2, high_m2 in _given_distances(snapshot, dropped):
        _tighten(lower, upper, i, j, low_m2, high_m2)
    rays = [ray for ray in snapshot.rays if ray.key not in dropped]
    chiralities = list(_anchor_chirality(config))
    by_observer: dict[int, list[RayEvidence]] = {}
    for ray in rays:
        by_observer.setdefault(ray.observer, []).append(ray)
    swings = {ray.key: _swing_rad(ray, lower) for ray in rays}
    for observer, seen in by_observer.items():
        bundle = _Bundle(snapshot, seen, swings)
        chiralities.extend(bundle.chiralities(observer, config.dimension))
        for first, second, low_rad, high_rad in bundle.angles():
            _apply_angle(lower, upper, (observer, first, second), low_rad, high_rad)
    now = {
        observer: tuple(_Bundle(snapshot, seen, swings).at(snapshot.stamp_s))
        for observer, seen in by_observer.items()
    }
    return Constraints(lower, upper, tuple(chiralities), now, config.dimension)


def _tighten(lower: Matrix, upper: Matrix, i: int, j: int, low: float, high: float) -> None:
    """Intersect the bounds of one pair with [low, high]."""
    lower[i, j] = lower[j, i] = max(lower[i, j], low)
    upper[i, j] = upper[j, i] = min(upper[i, j], high)


def _given_distances(
    snapshot: Snapshot, dropped: frozenset[LinkKey]
) -> Iterator[tuple[int, int, float, float]]:
    """Yield pairs of points with bounds of their squared distance: links, anchors, sizes."""
    for evidence in snapshot.distances:
        if evidence.key not in dropped:
            yield evidence.first, evidence.second, *_squared(evidence.lower_m, evidence.upper_m)
    yield from _anchor_distances(snapshot.config)
    separation_m2 = _squared(snapshot.config.min_separation_m, math.inf)
    if separation_m2[0] > 0.0:
        for i, j in combinations(range(len(snapshot.config.robots)), 2):
            yield i, j, *separation_m2


def _squared(lower_m: float, upper_m: float) -> tuple[float, float]:
    """Return bounds of the square of a distance; below zero there is none."""
    low = math.nextafter(lower_m * lower_m, -math.inf) if lower_m > 0.0 else 0.0
    if upper_m < 0.0:
        # No distance is negative. An empty interval that starts at the least possible number.
        return max(low, math.ulp(0.0)), 0.0
    return max(0.0, low), math.nextafter(upper_m * upper_m, math.inf)


def anchor_boxes(config: FleetConfig) -> dict[int, Interval]:
    """Return the coordinates of every anchor within its bound, by point."""
    index = {point: i for i, point in enumerate(config.points)}
    return {
        index[name]: Interval.around(np.array(anchor.coordinates_m), anchor.bound_m)
        if anchor.bound_m > 0.0
        else Interval.point(anchor.coordinates_m)
        for name, anchor in config.anchors.items()
    }


def _anchor_distances(config: FleetConfig) -> Iterator[tuple[int, int, float, float]]:
    """Yield the squared distances of all pairs of anchors within their bounds."""
    index = {point: i for i, point in enumerate(config.points)}
    for (a, first), (b, second) in combinations(config.anchors.items(), 2):
        gap = Interval.point(first.coordinates_m) - Interval.point(second.coordinates_m)
        squares = gap.square()
        total = squares[0]
        for k in range(1, config.dimension):
            total = total + squares[k]
        slack = first.bound_m + second.bound_m
        if slack > 0.0:
            slack = math.nextafter(slack, math.inf)
            distance = total.sqrt()
            lower_m = math.nextafter(float(distance.lower) - slack, -math.inf)
            upper_m = math.nextafter(float(distance.upper) + slack, math.inf)
            yield index[a], index[b], *_squared(lower_m, upper_m)
        else:
            yield index[a], index[b], max(0.0, float(total.lower)), float(total.upper)


def _anchor_chirality(config: FleetConfig) -> Iterator[Chirality]:
    """
    Yield the handedness of the q + 1 anchors that span most, when their bounds leave it certain.

    One is enough: the mutual distances of the anchors fix the others.
    """
    boxes = anchor_boxes(config)
    best = 0.0
    chirality = None
    for points in combinations(boxes, config.dimension + 1):
        edges = [boxes[point] - boxes[points[0]] for point in points[1:]]
        volume = determinant(Interval.stack(edges, axis=0))
        margin = max(float(volume.lower), -float(volume.upper))
        if margin > best:
            best, chirality = margin, Chirality(points, volume.sign())
    if chirality is not None:
        yield chirality


def _swing_rad(ray: RayEvidence, lower: Matrix) -> float:
    """
    Return by how much the motion of both ends can have turned the line between them.

    A vector of length d whose tip moves by D < d turns by at most asin(D / d), and the same
    holds looking back from the new vector: the distance may be that of either time.
    """
    moved_m = ray.displacement_m
    if moved_m == 0.0:
        return 0.0
    nearest_m = math.nextafter(math.sqrt(lower[ray.observer, ray.target]), 0.0)
    if moved_m >= nearest_m:
        return math.pi
    return math.asin(min(1.0, math.nextafter(moved_m / nearest_m, 2.0))) + ROUNDING_RAD


class _Bundle:
    """The newest rays of one observer, seen as one picture."""

    def __init__(
        self, snapshot: Snapshot, rays: list[RayEvidence], swings: dict[LinkKey, float]
    ) -> None:
        self._motion = snapshot.motion
        self._planar = snapshot.config.dimension == 2
        self._observer = rays[0].key.observer
        self._rays = rays
        self._swings = swings

    def at(self, stamp_s: float) -> list[Ray]:
        """Return all rays in the body frame of the observer at another time."""
        return [self._seen_at(ray, stamp_s) for ray in self._rays]

    def _seen_at(self, ray: RayEvidence, stamp_s: float) -> Ray:
        """
        Return the ray turned into the body frame of the observer at another time.

        What the ray says about is the line between the two points at the time of the snapshot:
        their motion until then is in its width.
        """
        half_width_rad = ray.half_width_rad + self._swings[ray.key] + ROUNDING_RAD
        if ray.stamp_s == stamp_s:
            return Ray(ray.target, ray.ray, half_width_rad)
        rotation, turn_rad = self._motion.turn(self._observer, ray.stamp_s, stamp_s)
        direction = rotation @ ray.ray
        if self._planar:
            direction = direction * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(direction))
        if length < 1e-6:
            return Ray(ray.target, ray.ray, math.pi)
        return Ray(ray.target, direction / length, half_width_rad + turn_rad)

    def angles(self) -> Iterator[tuple[int, int, float, float]]:
        """Yield pairs of targets with bounds in [0, pi] of the angle between their directions."""
        for first, second in combinations(self._rays, 2):
            a, b = self._seen_at(first, second.stamp_s), self._seen_at(second, second.stamp_s)
            width = a.half_width_rad + b.half_width_rad + ROUNDING_RAD
            if width < math.pi:
                angle = angle_rad(a.direction, b.direction)
                low, high = max(0.0, angle - width), min(math.pi, angle + width)
                yield a.target, b.target, low, high

    def chiralities(self, observer: int, dimension: int) -> Iterator[Chirality]:
        """Yield the handedness of the observer with q of its targets where it is certain."""
        for chosen in combinations(self._rays, dimension):
            reference_s = chosen[-1].stamp_s
            rays = [self._seen_at(ray, reference_s) for ray in chosen]
            sign = _planar_sign(rays) if dimension == 2 else _spatial_sign(rays)
            if sign != 0:
                yield Chirality((observer, *(ray.target for ray in rays)), sign)


def angle_rad(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between two unit vectors, in [0, pi]."""
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))


def _planar_sign(rays: list[Ray]) -> int:
    """Return the sign of the angle from the first ray to the second, or 0 when in doubt."""
    a, b = rays
    width = a.half_width_rad + b.half_width_rad + ROUNDING_RAD
    cross = a.direction[0] * b.direction[1] - a.direction[1] * b.direction[0]
    angle = math.atan2(cross, float(a.direction @ b.direction))
    if width < abs(angle) and abs(angle) + width < math.pi:
        return 1 if angle > 0.0 else -1
    return 0


def _spatial_sign(rays: list[Ray]) -> int:
    """
    Return the sign of the determinant of three rays, or 0 when in doubt.

    With unit vectors u', v', w' within the half widths of u, v, w, the determinant changes by
    det(u'-u, v, w) + det(u', v'-v, w) + det(u', v', w'-w). A difference is at most
    2 sin(half width / 2) long, and the vector product it meets at most the sine of an angle.
    """
    u, v, w = (ray.direction for ray in rays)
    e_u, e_v, e_w = (ray.half_width_rad for ray in rays)
    if max(e_u, e_v, e_w) >= math.pi / 2:
        return 0
    change = (
        2.0 * math.sin(e_u / 2.0) * _greatest_sine(angle_rad(v, w), 0.0)
        + 2.0 * math.sin(e_v / 2.0) * _greatest_sine(angle_rad(u, w), e_u)
        + 2.0 * math.sin(e_w / 2.0) * _greatest_sine(angle_rad(u, v), e_u + e_v)
    )
    volume = float(np.linalg.det(np.stack([u, v, w])))
    if abs(volume) <= change + ROUNDING_RAD:
        return 0
    return 1 if volume > 0.0 else -1


def _greatest_sine(angle_rad: float, half_width_rad: float) -> float:
    """Return the greatest sine of an angle in [0, pi] within the half width."""
    if abs(angle_rad - math.pi / 2) <= half_width_rad:
        return 1.0
    return max(math.sin(angle_rad - half_width_rad), math.sin(angle_rad + half_width_rad))


def _apply_angle(
    lower: Matrix, upper: Matrix, corner: tuple[int, int, int], low_rad: float, high_rad: float
) -> None:
    """
    Tighten the side of a triangle that lies opposite to a known angle.

    Parameters
    ----------
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2; changed in place.
    corner : tuple of int
        The point with the angle, and the two ends of the opposite side.
    low_rad, high_rad : float
        Bounds of the angle, in [0, pi].

    """
    a, b, c = corner
    if lower[a, b] > upper[a, b] or lower[a, c] > upper[a, c]:
        return
    sides = Interval(lower[a, [b, c]], upper[a, [b, c]]).sqrt()
    low_cos, high_cos = cosine_of_angle(low_rad, high_rad)
    low = _least_opposite_m2(sides, high_cos)
    high = _greatest_opposite_m2(sides, low_cos)
    _tighten(lower, upper, b, c, low, high)


def _opposite_m2(x: float, y: float, cosine: float) -> tuple[float, float]:
    """Return bounds of x^2 + y^2 - 2 x y cosine, for sides of at least zero."""
    value = x * x + y * y - 2.0 * x * y * cosine
    # Five operations on parts no larger than (x + y)^2.
    margin = 8.0 * 2.0**-53 * (x + y) * (x + y) + math.ulp(0.0)
    return max(0.0, value - margin), value + margin


def _greatest_opposite_m2(sides: Interval, cosine: float) -> float:
    """Return an upper bound of the squared third side: convex in both, so at a corner."""
    if not np.isfinite(sides.upper).all():
        return math.inf
    return max(
        _opposite_m2(x, y, cosine)[1]
        for x in (float(sides.lower[0]), float(sides.upper[0]))
        for y in (float(sides.lower[1]), float(sides.upper[1]))
    )


def _least_opposite_m2(sides: Interval, cosine: float) -> float:
    """
    Return a lower bound of the squared third side.

    The form is convex and zero only where both sides are, or on the diagonal for cosine 1: its
    minimum over a box of sides lies on an edge, where it is a parabola.
    """
    candidates = []
    for fixed, free in ((0, 1), (1, 0)):
        low, high = float(sides.lower[free]), float(sides.upper[free])
        for x in (float(sides.lower[fixed]), float(sides.upper[fixed])):
            if math.isfinite(x):
                y = min(max(x * cosine, low), high)
                candidates.append(_opposite_m2(x, y, cosine)[0])
    return min(candidates)
