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

from dg_localization.fleet.anchors import squared_bounds
from dg_localization.fleet.cartesian import ANGLE_SWEEPS, tighten_by_angles
from dg_localization.fleet.estimate import LinkKey
from dg_localization.fleet.snapshot import RayEvidence, Snapshot
from dg_localization.interval.arrays import ROUNDING_RAD
from dg_localization.solver.problem import Chirality, Problem

Matrix = NDArray[np.float64]
IntArray = NDArray[np.int64]


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
class Angles:
    """
    Angles under which observers see pairs of points.

    Parameters
    ----------
    corners : numpy.ndarray of int, shape (m, 3)
        The observer, and the two points.
    low_rad, high_rad : numpy.ndarray, shape (m,)
        Bounds in [0, pi].

    """

    corners: IntArray
    low_rad: np.ndarray
    high_rad: np.ndarray

    def cosines(self) -> np.ndarray:
        """Return bounds of the cosines, shape (m, 2)."""
        return np.stack(
            [
                np.maximum(np.cos(self.high_rad) - ROUNDING_RAD, -1.0),
                np.minimum(np.cos(self.low_rad) + ROUNDING_RAD, 1.0),
            ],
            axis=1,
        )


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
    angles : Angles
        Angles under which pairs of points are seen.
    dimension : int

    """

    lower: Matrix
    upper: Matrix
    chiralities: tuple[Chirality, ...]
    rays: dict[int, tuple[Ray, ...]]
    angles: Angles
    dimension: int

    @property
    def contradictory(self) -> bool:
        """Whether some distance is left without any value."""
        return bool((self.lower > self.upper).any())

    def component_of(self, point: int) -> tuple[int, ...]:
        """Return the points that bounded distances join to `point`, itself included, in order."""
        return tuple(sorted(_reached(np.isfinite(self.upper), point)))

    def loose_points(self, component: tuple[int, ...], kept: set[int]) -> list[int]:
        """
        Return the points of a connected part that hang on fewer than q distances.

        Parameters
        ----------
        component : tuple of int
            The connected part.
        kept : set of int
            Points that do not count as loose.

        Returns
        -------
        list of int
            Each hangs on at least one and on fewer than q of the points not listed before it.

        """
        bounded = np.isfinite(self.upper)
        np.fill_diagonal(bounded, False)
        left = list(component)
        loose: list[int] = []
        while True:
            # One at a time, the last in the list first: they may hang on each other.
            for point in reversed(left):
                rest = [other for other in left if other != point]
                if point in kept or bounded[point, rest].sum() >= self.dimension:
                    continue
                # What joins two parts of the fleet is not loose.
                if len(_reached(bounded[np.ix_(rest, rest)], 0)) == len(rest):
                    break
            else:
                return loose
            loose.append(point)
            left = rest

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


def _reached(joined: NDArray[np.bool_], start: int) -> set[int]:
    """Return the points that a chain of joined pairs leads to from one of them."""
    reached = {start}
    pending = [start]
    while pending:
        new = set(np.flatnonzero(joined[pending.pop()]).tolist()) - reached
        reached |= new
        pending.extend(new)
    return reached


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
    chiralities = list(snapshot.anchors.chiralities)
    by_observer: dict[int, list[RayEvidence]] = {}
    for ray in rays:
        by_observer.setdefault(ray.observer, []).append(ray)
    swings = {ray.key: _swing_rad(ray, lower) for ray in rays}
    now = {}
    angles = []
    for observer, seen in by_observer.items():
        bundle = _Bundle(snapshot, seen, swings)
        now[observer] = tuple(bundle.at(snapshot.stamp_s))
        pairs = bundle.pairs()
        angles.append(_angles_at(observer, *pairs))
        chiralities.extend(
            _planar_chiralities(observer, *pairs)
            if config.dimension == 2
            else _spatial_chiralities(observer, bundle)
        )
    seen_angles = _joined(angles)
    _triangulate(lower, upper, seen_angles)
    tighten_by_angles(lower, upper, seen_angles.corners, seen_angles.cosines(), ANGLE_SWEEPS)
    return Constraints(lower, upper, tuple(chiralities), now, seen_angles, config.dimension)


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
            yield (
                evidence.first,
                evidence.second,
                *squared_bounds(evidence.lower_m, evidence.upper_m),
            )
    yield from snapshot.anchors.distances
    separation_m2 = squared_bounds(snapshot.config.min_separation_m, math.inf)
    if separation_m2[0] > 0.0:
        for i, j in combinations(range(len(snapshot.config.robots)), 2):
            yield i, j, *separation_m2


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
        self._name = rays[0].key.observer
        self._rays = rays
        self._swings = swings

    def at(self, stamp_s: float) -> list[Ray]:
        """Return all rays in the body frame of the observer at another time."""
        turns = {s: self._motion.turn(self._name, s, stamp_s) for s in self._stamps_s()}
        return [self._turned(ray, stamp_s, *turns[ray.stamp_s]) for ray in self._rays]

    def pairs(self) -> tuple[IntArray, Matrix, Matrix]:
        """
        Return all pairs of targets and the angle from the first to the second.

        Returns
        -------
        targets : numpy.ndarray of int, shape (m, 2)
        angles : numpy.ndarray, shape (m,)
            In the plane counterclockwise, in (-pi, pi]; in space in [0, pi].
        half_widths : numpy.ndarray, shape (m,)
            Greatest error of each.

        """
        pictures = self._pictures()
        # Both rays of a pair in the body frame in which the later listed one was measured.
        chosen = [
            (pictures[second.stamp_s][i], pictures[second.stamp_s][j])
            for (i, _), (j, second) in combinations(enumerate(self._rays), 2)
        ]
        targets = np.array([(a.target, b.target) for a, b in chosen], dtype=np.int64)
        first = np.array([a.direction for a, _ in chosen]).reshape(-1, 3)
        other = np.array([b.direction for _, b in chosen]).reshape(-1, 3)
        widths = np.array([a.half_width_rad + b.half_width_rad for a, b in chosen])
        angles = angles_rad(first, other)
        if self._planar:
            turns_left = first[:, 0] * other[:, 1] - first[:, 1] * other[:, 0]
            angles = np.where(turns_left < 0.0, -angles, angles)
        return targets.reshape(-1, 2), angles, widths + ROUNDING_RAD

    def triples(self) -> Iterator[list[Ray]]:
        """Yield all triples of rays, each in one body frame."""
        pictures = self._pictures()
        for chosen in combinations(enumerate(self._rays), 3):
            picture = pictures[chosen[-1][1].stamp_s]
            yield [picture[i] for i, _ in chosen]

    def _stamps_s(self) -> set[float]:
        """Return the different stamps of the rays."""
        return {ray.stamp_s for ray in self._rays}

    def _pictures(self) -> dict[float, list[Ray]]:
        """Return all rays in the body frame at each of their stamps."""
        return {stamp_s: self.at(stamp_s) for stamp_s in self._stamps_s()}

    def _turned(
        self, ray: RayEvidence, stamp_s: float, rotation: np.ndarray, turn_rad: float
    ) -> Ray:
        """
        Return the ray turned into the body frame of the observer at another time.

        What the ray says about is the line between the two points at the time of the snapshot:
        their motion until then is in its width.
        """
        half_width_rad = ray.half_width_rad + self._swings[ray.key] + ROUNDING_RAD
        if ray.stamp_s == stamp_s:
            return Ray(ray.target, ray.ray, half_width_rad)
        direction = rotation @ ray.ray
        if self._planar:
            direction = direction * (1.0, 1.0, 0.0)
        length = float(np.linalg.norm(direction))
        if length < 1e-6:
            return Ray(ray.target, ray.ray, math.pi)
        return Ray(ray.target, direction / length, half_width_rad + turn_rad)


def angles_rad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between unit vectors along the last axis, in [0, pi]."""
    # Exact to rounding for all angles, unlike the arccosine near 0 and pi.
    difference = np.linalg.norm(first - second, axis=-1)
    total = np.linalg.norm(first + second, axis=-1)
    return np.asarray(2.0 * np.arctan2(difference, total))


def _planar_chiralities(
    observer: int, targets: IntArray, angles: np.ndarray, half_widths: np.ndarray
) -> Iterator[Chirality]:
    """Yield the handedness of an observer with two targets where the sign is certain."""
    sizes = np.abs(angles)
    certain = (half_widths < sizes) & (sizes + half_widths < math.pi)
    for row in np.flatnonzero(certain):
        first, second = targets[row].tolist()
        yield Chirality((observer, first, second), 1 if angles[row] > 0.0 else -1)


def _spatial_chiralities(observer: int, bundle: _Bundle) -> Iterator[Chirality]:
    """Yield the handedness of an observer with three targets where the sign is certain."""
    for rays in bundle.triples():
        sign = _spatial_sign(rays)
        if sign != 0:
            yield Chirality((observer, *(ray.target for ray in rays)), sign)


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
    vw, uw, uv = angles_rad(np.array([v, u, u]), np.array([w, w, v])).tolist()
    change = (
        2.0 * math.sin(e_u / 2.0) * _greatest_sine(vw, 0.0)
        + 2.0 * math.sin(e_v / 2.0) * _greatest_sine(uw, e_u)
        + 2.0 * math.sin(e_w / 2.0) * _greatest_sine(uv, e_u + e_v)
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


def _angles_at(
    observer: int, targets: IntArray, angles: np.ndarray, half_widths: np.ndarray
) -> Angles:
    """Return the angles under which one observer sees pairs of points, where they say anything."""
    known = half_widths < math.pi
    sizes, widths = np.abs(angles[known]), half_widths[known]
    corners = np.column_stack([np.full(known.sum(), observer), targets[known]])
    low, high = np.maximum(sizes - widths, 0.0), np.minimum(sizes + widths, math.pi)
    return Angles(corners.astype(np.int64), low, high)


def _joined(parts: list[Angles]) -> Angles:
    """Return all angles in one."""
    return Angles(
        np.concatenate([np.empty((0, 3), dtype=np.int64), *(part.corners for part in parts)]),
        np.concatenate([np.empty(0), *(part.low_rad for part in parts)]),
        np.concatenate([np.empty(0), *(part.high_rad for part in parts)]),
    )


def _triangulate(lower: Matrix, upper: Matrix, angles: Angles) -> None:
    """
    Bound the distances to a point that is only seen, never ranged, by the law of sines, in place.

    With the angles A at a and B at b, the third is pi - A - B, and the sides are as the sines:
    d_ac = d_ab sin B / sin(A + B).
    """
    unranged = np.isinf(upper)
    if not unranged.any():
        return
    known = {
        (corner[0], frozenset(corner[1:])): (low, high)
        for corner, low, high in zip(
            angles.corners.tolist(), angles.low_rad.tolist(), angles.high_rad.tolist(), strict=True
        )
    }
    for (a, ends), at_a in known.items():
        for b in ends:
            (c,) = ends - {b}
            if not unranged[a, c] or unranged[a, b] or lower[a, b] > upper[a, b]:
                continue
            at_b = known.get((b, frozenset((a, c))))
            if at_b is None:
                continue
            base = (math.sqrt(lower[a, b]), math.sqrt(upper[a, b]))
            _tighten(lower, upper, a, c, *_third_side_m2(base, at_a, at_b))


def _third_side_m2(
    base: tuple[float, float], at_a: tuple[float, float], at_b: tuple[float, float]
) -> tuple[float, float]:
    """Return bounds of the square of d_ac from d_ab and the angles at a and b."""
    low_sum, high_sum = at_a[0] + at_b[0], min(math.pi, at_a[1] + at_b[1])
    low_b, high_b = _sine_range(*at_b)
    low_c, high_c = _sine_range(min(low_sum, math.pi), high_sum)
    # A handful of roundings, each below 1.2e-16 of its result, besides those of the sines.
    low_m = base[0] * low_b / high_c * (1.0 - 1e-14)
    high_m = base[1] * high_b / low_c * (1.0 + 1e-14) if low_c > 0.0 else math.inf
    return squared_bounds(low_m, high_m)


def _sine_range(low_rad: float, high_rad: float) -> tuple[float, float]:
    """Return bounds of the sine over a part of [0, pi]."""
    ends = (math.sin(low_rad), math.sin(high_rad))
    low = max(0.0, min(ends) - ROUNDING_RAD)
    high = 1.0 if low_rad <= math.pi / 2 <= high_rad else max(ends) + ROUNDING_RAD
    return low, high
