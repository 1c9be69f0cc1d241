# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Constraints of a snapshot on its points, and the problem for the solver.

Every step intersects with a constraint that the true fleet satisfies, rounded outward.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.constraints.distances import (
    PairBounds,
    given_distances,
    intersect_pair,
    share_on_robots,
    triangulate,
)
from dg_localization.fleet.constraints.rays import Angles, RayBundle, include_displacement
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.fleet.vocabulary import LinkKey, RayReading
from dg_localization.solver.contract.triangles import contract_by_angles
from dg_localization.solver.decompose.rigid_components import is_flexible
from dg_localization.solver.problem import Chirality, Problem

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class Constraints:
    """
    Constraints on points at the time of a snapshot.

    Parameters
    ----------
    points : tuple of str
        Their names, in the order of the rows.
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2.
    measured : numpy.ndarray of bool, shape (n, n)
        Whether a distance would be known exactly if readings had no errors. Other distances may
        have bounds too, from other points of the same robot (as wide as their lever arm) or from a
        window that does not fix them.
    chiralities : tuple of Chirality
    rays : mapping of str to tuple of RayReading
        Rays by observer, in its body frame at the time of the snapshot.
    angles : Angles
        Angles under which pairs of points are seen.
    dimension : int

    """

    points: tuple[str, ...]
    lower: FloatArray
    upper: FloatArray
    measured: NDArray[np.bool_]
    chiralities: tuple[Chirality, ...]
    rays: Mapping[str, tuple[RayReading, ...]]
    angles: Angles
    dimension: int

    @cached_property
    def rows(self) -> dict[str, int]:
        """The row of each point."""
        return {name: row for row, name in enumerate(self.points)}

    @property
    def contradictory(self) -> bool:
        """Whether the bounds of some distance are empty."""
        return bool((self.lower > self.upper).any())

    @cached_property
    def all_measured(self) -> bool:
        """Whether every distance with bounds is measured."""
        return bool(np.array_equal(self.measured, np.isfinite(self.upper)))

    def is_flexible(self, positions: FloatArray | None, robots: Sequence[str]) -> bool:
        """
        Return whether the measured distances may leave a placement free to move.

        The rotation of a robot about its only measured point does not count.
        """
        if positions is None:
            return True
        names = np.array(robots)
        joins = self.measured & (names[:, None] != names[None])
        held = np.flatnonzero(joins.any(axis=1))
        if len(np.unique(names[held])) < len(np.unique(names)):
            return True
        return is_flexible(positions[held], self.measured[np.ix_(held, held)])

    def component_of(self, point: int) -> tuple[int, ...]:
        """Return the points connected to `point` by bounded distances, with itself, in order."""
        reached, pending = {point}, [point]
        while pending:
            bounded = np.isfinite(self.upper[pending.pop()])
            new = set(np.flatnonzero(bounded).tolist()) - reached
            reached |= new
            pending.extend(new)
        return tuple(sorted(reached))

    def of(self, points: Sequence[int]) -> Constraints:
        """Return the constraints of some of the points, renumbered in the order of the list."""
        row_of = {point: row for row, point in enumerate(points)}
        names = tuple(self.points[point] for point in points)
        chosen = np.ix_(points, points)
        return Constraints(
            points=names,
            lower=self.lower[chosen],
            upper=self.upper[chosen],
            measured=self.measured[chosen],
            chiralities=tuple(
                Chirality(tuple(row_of[p] for p in chirality.points), chirality.sign)
                for chirality in self.chiralities
                if row_of.keys() >= set(chirality.points)
            ),
            rays={
                observer: tuple(ray for ray in rays if ray.key.target in names)
                for observer, rays in self.rays.items()
                if observer in names
            },
            angles=self.angles.of(points, len(self.points)),
            dimension=self.dimension,
        )

    def problem(self) -> Problem:
        """Return the problem for the solver."""
        return Problem(
            self.lower, self.upper, dimension=self.dimension, chiralities=self.chiralities
        )


def constrain(
    snapshot: Snapshot,
    dropped: frozenset[LinkKey] = frozenset(),
    remembered: Iterable[tuple[PairBounds, bool]] = (),
) -> Constraints:
    """
    Return the constraints of a snapshot, without dropped links.

    `remembered` are bounds of distances, and whether they are loose: exact readings would not fix
    a loose distance.
    """
    config = snapshot.config
    known = [*remembered]
    firm = [bounds for bounds, is_loose in known if not is_loose]
    lower, upper = given_distances(snapshot, dropped, firm)
    measured = lower.copy(), upper.copy()
    for bounds, is_loose in known:
        if is_loose:
            intersect_pair(lower, upper, *bounds)
    share_on_robots(snapshot, lower, upper)
    bundles = _bundles(snapshot, dropped, lower)
    by_observer = [bundle.angles() for bundle in bundles.values()]
    chiralities = list(snapshot.anchors.chiralities)
    for seen in by_observer if config.dimension == 2 else bundles.values():
        chiralities.extend(seen.chiralities())
    angles = Angles.joined(by_observer)
    _narrow_by_angles(lower, upper, angles)
    if snapshot.mounts.distances or len(firm) < len(known):
        _narrow_by_angles(*measured, angles)
    else:
        measured = lower, upper
    return Constraints(
        points=config.points,
        lower=lower,
        upper=upper,
        measured=np.isfinite(measured[1]),
        chiralities=tuple(chiralities),
        rays={observer: bundle.now(snapshot.stamp_s) for observer, bundle in bundles.items()},
        angles=angles,
        dimension=config.dimension,
    )


def _narrow_by_angles(lower: FloatArray, upper: FloatArray, angles: Angles) -> None:
    """Bound distances by the angles between rays and by other distances, in place."""
    triangulate(lower, upper, angles)
    contract_by_angles(lower, upper, angles.corners, angles.cosines())


def _bundles(
    snapshot: Snapshot, dropped: frozenset[LinkKey], lower: FloatArray
) -> dict[str, RayBundle]:
    """Return the rays of every observer; their half widths include the displacements since."""
    rows = snapshot.config.rows
    seen: dict[str, list[RayReading]] = {}
    for ray in snapshot.rays:
        if ray.key not in dropped:
            s_lower_m2 = lower[rows[ray.key.observer], rows[ray.key.target]]
            seen.setdefault(ray.key.observer, []).append(include_displacement(ray, s_lower_m2))
    measured = {observer: len(rays) for observer, rays in seen.items()}
    for robot, members in snapshot.mounts.members.items():
        for observer in members:
            if observer == robot or observer in seen:
                # Mounted rays come last: a pair of rays is compared at the time of the second.
                known = snapshot.mounts.rays.get(observer, ())
                now = (replace(ray, stamp_s=snapshot.stamp_s) for ray in known)
                seen.setdefault(observer, []).extend(now)
    return {
        observer: RayBundle(rays, measured.get(observer, 0), snapshot.motion)
        for observer, rays in seen.items()
        if rays
    }
