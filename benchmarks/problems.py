# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The problems, each with the placements known to solve it."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from itertools import combinations
import json
import math
import os
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dg_localization import Chirality, Problem, Side, SideConstraint

FloatArray = NDArray[np.float64]
Pair = tuple[int, int]

DATA = Path(os.environ.get('DG_SHARED_DATA', Path(__file__).parents[2] / 'shared' / 'data'))
"""Recordings and published problems that are no part of the repository."""

ROUNDING = 1e-12
"""Relative half-width of a range that is exact up to the rounding of its computation."""


def squared_distances(positions: FloatArray) -> FloatArray:
    """Return the matrix of squared distances of placed points, in m^2."""
    differences = positions[:, None, :] - positions[None, :, :]
    return np.einsum('ijk,ijk->ij', differences, differences)


def problem_of(
    ranges: Mapping[Pair, tuple[float, float]],
    n_points: int,
    dimension: int,
    sides: Sequence[SideConstraint] = (),
    chiralities: Sequence[Chirality] = (),
) -> Problem:
    """Return the problem with the given ranges of squared distance, in m^2, and no others."""
    lower = np.zeros((n_points, n_points))
    upper = np.where(np.eye(n_points, dtype=bool), 0.0, np.inf)
    for (i, j), (low, high) in ranges.items():
        lower[i, j] = lower[j, i] = low
        upper[i, j] = upper[j, i] = high
    return Problem(lower, upper, dimension, sides, chiralities)


def known_to(relative_error: float, squared: float) -> tuple[float, float]:
    """Return the range of a squared distance whose root is known to a relative error."""
    return squared * (1.0 - relative_error) ** 2, squared * (1.0 + relative_error) ** 2


# The paper's fleet (Section 5.1), points P1..P6 as 0..5.

FLEET_SQUARED_M2: dict[Pair, float] = {
    (0, 1): 58.0,
    (0, 2): 53.0,
    (1, 2): 41.0,
    (1, 3): 53.0,
    (1, 4): 52.0,
    (1, 5): 53.0,
    (2, 3): 58.0,
    (3, 5): 50.0,
    (4, 5): 37.0,
}
FLEET_HALF_WIDTH_M2 = 0.01
FLEET_SIDES = tuple(
    SideConstraint(face, first, second, Side.OPPOSITE)
    for face, first, second in (((1, 2), 0, 3), ((1, 3), 2, 5), ((1, 5), 3, 4))
)


def _apex(a: FloatArray, b: FloatArray, s_ap: float, s_bp: float, sign: int) -> FloatArray:
    """Return the point p with these squared distances to a and b and chi(a, b, p) = sign."""
    axis = b - a
    length = math.hypot(*axis)
    along = (s_ap - s_bp) / (2.0 * length) + 0.5 * length
    height = sign * math.sqrt(s_ap - along**2)
    along_axis = axis / length
    return a + along * along_axis + height * np.array([-along_axis[1], along_axis[0]])


def fleet_placements() -> tuple[FloatArray, ...]:
    """Return the eight placements at the middle of the paper's data; the first is the paper's."""
    s = FLEET_SQUARED_M2
    placements = []
    for sides in np.ndindex(2, 2, 2):
        turns = [1 - 2 * side for side in sides]
        p = np.zeros((6, 2))
        p[2] = (math.sqrt(s[1, 2]), 0.0)
        p[0] = _apex(p[1], p[2], s[0, 1], s[0, 2], 1)
        p[3] = _apex(p[1], p[2], s[1, 3], s[2, 3], -turns[0])
        p[5] = _apex(p[1], p[3], s[1, 5], s[3, 5], -turns[0] * turns[1])
        p[4] = _apex(p[1], p[5], s[1, 4], s[4, 5], -math.prod(turns))
        placements.append(p)
    return tuple(placements)


def fleet(relative_error: float | None = None, sides: bool = False) -> Problem:
    """Return the paper's fleet with its own errors or relative ones."""
    if relative_error is None:
        h = FLEET_HALF_WIDTH_M2
        ranges = {pair: (s - h, s + h) for pair, s in FLEET_SQUARED_M2.items()}
    else:
        ranges = {pair: known_to(relative_error, s) for pair, s in FLEET_SQUARED_M2.items()}
    return problem_of(ranges, 6, 2, sides=FLEET_SIDES if sides else ())


# The octahedral manipulator (Section 5.2), points P1..P6 as 0..5.

BASE_M, PLATFORM_M = 12.0, 6.0
LEGS_M: dict[Pair, float] = {
    (0, 3): 19.8,
    (1, 3): 18.0,
    (1, 4): 18.0,
    (2, 4): 17.0,
    (2, 5): 14.9,
    (0, 5): 17.8,
}
OCTAHEDRAL_UNKNOWN_M2 = (
    (269.2450856245431, 245.48679174318272, 398.04814364619716),
    (328.73643083220406, 192.17080377910528, 215.17662758252516),
    (359.52750169140614, 386.5201842432715, 196.8660605028093),
    (463.5657696137072, 318.21562482038985, 356.8618328856255),
    (497.9021511372001, 165.2784399907597, 314.751903937815),
    (513.0332444598268, 242.72987165066036, 177.6436268098073),
)
"""Squared distances of pairs 15, 26, 34 in the six solutions."""
OCTAHEDRAL_SIDES = tuple(
    SideConstraint(face, first, second, Side.SAME)
    for face, first, second in (
        ((0, 1, 3), 4, 5),
        ((1, 3, 4), 0, 2),
        ((1, 2, 4), 3, 5),
        ((2, 4, 5), 0, 1),
        ((0, 2, 5), 3, 4),
        ((0, 3, 5), 1, 2),
    )
)
"""The six of the paper; two of the six solutions satisfy them (numbers 1 and 3)."""
CONVEX = SideConstraint((0, 1, 3), 2, 4, Side.SAME)
"""Leaves the convex octahedron alone (number 3)."""


def _octahedral_squared_m2() -> dict[Pair, float]:
    squared = dict.fromkeys(combinations((0, 1, 2), 2), BASE_M**2)
    squared |= dict.fromkeys(combinations((3, 4, 5), 2), PLATFORM_M**2)
    return squared | {pair: leg**2 for pair, leg in LEGS_M.items()}


def placement_of(squared: FloatArray, dimension: int) -> FloatArray:
    """Return coordinates for a complete matrix of squared distances (classical scaling)."""
    centring = np.eye(len(squared)) - 1.0 / len(squared)
    values, vectors = np.linalg.eigh(-0.5 * centring @ squared @ centring)
    return vectors[:, -dimension:] * np.sqrt(np.maximum(values[-dimension:], 0.0))


def octahedral_placements() -> tuple[FloatArray, ...]:
    """Return the six solutions, each as one of its two mirror images."""
    placements = []
    for unknown in OCTAHEDRAL_UNKNOWN_M2:
        squared = np.zeros((6, 6))
        ranges = _octahedral_squared_m2() | dict(
            zip(((0, 4), (1, 5), (2, 3)), unknown, strict=True)
        )
        for (i, j), s in ranges.items():
            squared[i, j] = squared[j, i] = s
        placements.append(placement_of(squared, 3))
    return tuple(placements)


def octahedral(sides: Sequence[SideConstraint] = ()) -> Problem:
    """Return the octahedral manipulator; its lengths are exact up to rounding."""
    ranges = {pair: known_to(ROUNDING, s) for pair, s in _octahedral_squared_m2().items()}
    return problem_of(ranges, 6, 3, sides=sides)


# Random trilaterable fleets.

SPACING_M, CLEARANCE_M = 5.0, 2.0


def _scattered(n_points: int, dimension: int, random: np.random.Generator) -> FloatArray:
    """Return points in a square or cube, one per `SPACING_M` on average, none too close."""
    edge = SPACING_M * n_points ** (1.0 / dimension)
    points: list[FloatArray] = []
    while len(points) < n_points:
        point = random.uniform(0.0, edge, dimension)
        if all(np.linalg.norm(point - other) >= CLEARANCE_M for other in points):
            points.append(point)
    return np.array(points)


def is_trilaterable(linked: NDArray[np.bool_], dimension: int) -> bool:
    """Return whether some q + 1 mutually linked points reach all others by trilateration."""
    for seed in combinations(range(len(linked)), dimension + 1):
        if all(linked[pair] for pair in combinations(seed, 2)):
            reached = np.zeros(len(linked), dtype=bool)
            reached[list(seed)] = True
            while True:
                nearer = ~reached & (linked[:, reached].sum(axis=1) > dimension)
                if not nearer.any():
                    break
                reached |= nearer
            if reached.all():
                return True
    return False


def random_fleet(
    n_points: int, dimension: int, relative_error: float, seed: int
) -> tuple[Problem, FloatArray]:
    """
    Return a fleet whose robots measure all others within the least radius that trilaterates it.

    Parameters
    ----------
    n_points : int
        Number of robots.
    dimension : int
        The dimension q of the space, 2 or 3.
    relative_error : float
        Half-width of the distances about the true ones, relative.
    seed : int
        Of the positions.

    Returns
    -------
    problem : Problem
        At least 3n - 6 (q = 2) or 4n - 10 (q = 3) ranges.
    positions : ndarray, shape (n, q)
        The true placement, in m.

    """
    positions = _scattered(n_points, dimension, np.random.default_rng(seed))
    squared = squared_distances(positions)
    order = sorted(combinations(range(n_points), 2), key=lambda pair: squared[pair])
    few = (dimension + 1) * n_points - (dimension + 1) * (dimension + 2) // 2

    def trilaterable(n_links: int) -> bool:
        linked = np.zeros(squared.shape, dtype=bool)
        rows, columns = np.array(order[:n_links]).T
        linked[rows, columns] = linked[columns, rows] = True
        return is_trilaterable(linked, dimension)

    n_links = bisect_left(range(len(order)), True, lo=few, key=trilaterable)
    ranges = {pair: known_to(relative_error, squared[pair]) for pair in order[:n_links]}
    return problem_of(ranges, n_points, dimension), positions


# Dietmaier's platform with forty real postures (ARK 1998).

DIETMAIER_HALF_WIDTH_M = 1e-9
"""Of the legs: the published postures are that good, and no wider legs separate all forty."""


def dietmaier_file() -> Path:
    """Return where the published platform is expected."""
    return DATA / 'dietmaier' / 'dietmaier40.json'


def dietmaier() -> tuple[Problem, tuple[FloatArray, ...]]:
    """Return the platform, with the chiralities of its base and platform, and its postures."""
    published = json.loads(dietmaier_file().read_text())
    base = np.array(published['base_points'])
    platform = np.array(published['platform_points'])
    ranges = {}
    for offset, body in ((0, base), (6, platform)):
        squared = squared_distances(body)
        for i, j in combinations(range(6), 2):
            ranges[i + offset, j + offset] = known_to(ROUNDING, squared[i, j])
    for leg, length in enumerate(published['leg_lengths']):
        low, high = length - DIETMAIER_HALF_WIDTH_M, length + DIETMAIER_HALF_WIDTH_M
        ranges[leg, leg + 6] = (low**2, high**2)
    chiralities = []
    for offset, body in ((0, base), (6, platform)):
        corners = max(combinations(range(6), 4), key=lambda four: abs(_volume(body, four)))
        sign = int(np.sign(_volume(body, corners)))
        chiralities.append(Chirality(tuple(offset + corner for corner in corners), sign))
    postures = []
    for posture in published['solutions']:
        rotation = np.array(posture['rotation_columns_a1_a2_e3_as_matrix'])
        moved = platform @ rotation.T + np.array(posture['translation'])
        postures.append(np.vstack([base, moved]))
    return problem_of(ranges, 12, 3, chiralities=chiralities), tuple(postures)


def _volume(body: FloatArray, corners: Sequence[int]) -> float:
    first, *others = body[list(corners)]
    return float(np.linalg.det(np.array(others) - first))
