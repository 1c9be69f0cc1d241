# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Rigid components: the maximal sets of points that measured pairs hold rigid, generically.

Points with q distances to a rigid cluster belong to it; that finds most of every component. The
rest is decided by the rigidity matrix at random coordinates modulo a large prime. Its rank never
exceeds the generic rank, so rigidity is certain; it is lower with a probability of about one over
the prime. With the same confidence, a random motion that keeps all measured distances keeps only
the distances that they imply.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from itertools import combinations

import numpy as np

from dg_localization.interval.kernels import WORK_OF_A_STEP, look_after
from dg_localization.solver.box import FloatArray, IntArray
from dg_localization.solver.decompose.graph import BoolArray, Pair, Points
from dg_localization.solver.pair_bounds import pairs_among

PRIME = 2**31 - 1
"""The sum of two products of residues fits into 64 bits."""

RANK_TOLERANCE = 1e-6
"""Relative tolerance of the ranks of rigidity matrices and faces."""

SEED = 1
"""Seed of the random coordinates, which are the same in every run."""


def rigid_rank(n_points: int, dimension: int) -> int:
    """Return the rank of the rigidity matrix of rigid points in general position."""
    span = min(n_points - 1, dimension)
    return n_points * dimension - dimension - span * (2 * dimension - span - 1) // 2


def is_rigid(n_points: int, pairs: IntArray, dimension: int) -> bool:
    """Return whether pairs hold all points rigid at generic coordinates."""
    if len(pairs) == n_points * (n_points - 1) // 2:
        return True
    if len(pairs) < rigid_rank(n_points, dimension):
        return False
    return any(len(c) == n_points for c in rigid_components(n_points, pairs, dimension))


def is_flexible(positions: FloatArray, measured: BoolArray) -> bool:
    """
    Return whether the measured distances leave a placement free to move, at least to first order.

    If the rank of the rigidity matrix is lower than in general position, there are motions besides
    those of the whole fleet that change no measurement to first order: a flex.
    """
    n_points, dimension = positions.shape
    rows, columns = pairs_among(n_points)
    i, j = rows[measured[rows, columns]], columns[measured[rows, columns]]
    rank = rigid_rank(n_points, dimension)
    if len(i) == len(rows):
        return False
    if len(i) < rank:
        return True
    look_after(len(i) * positions.size**2 // 10)
    # Squares must not overflow; coincident points give zero rows.
    arms = (positions[i] - positions[j]) / (np.abs(positions).max() or 1.0)
    lengths = np.sqrt((arms * arms).sum(axis=1))
    units = arms / np.where(lengths > 0.0, lengths, 1.0)[:, None]
    rows_of_pairs, number = np.zeros((len(i), n_points, dimension)), np.arange(len(i))
    rows_of_pairs[number, i], rows_of_pairs[number, j] = units, -units
    matrix = rows_of_pairs.reshape(len(i), positions.size)
    strengths = np.linalg.eigvalsh(matrix.T @ matrix)
    return bool(np.count_nonzero(strengths > RANK_TOLERANCE**2) < rank)


def rigid_components(n_points: int, pairs: IntArray, dimension: int) -> list[Points]:
    """Return the maximal sets of points that are rigid together at generic coordinates."""
    components = _clusters(n_points, pairs, dimension)
    held: list[set[int]] = [set() for _ in range(n_points)]
    for number, component in enumerate(components):
        for point in component:
            held[point].add(number)
    bars = [(i, j) for i, j in pairs.tolist() if held[i].isdisjoint(held[j])]
    fewer = _without_interiors(components, held, bars, dimension)
    if len(fewer):
        points, ends = np.unique(fewer, return_inverse=True)
        implied = implied_pairs(len(points), ends.reshape(fewer.shape), dimension)
        found = [{*points[c].tolist()} for c in _components_of_implied(implied, dimension)]
        components = joined_bodies([*components, *found], dimension)
        number_of = {p: {x for x, c in enumerate(components) if p in c} for b in bars for p in b}
        bars = [(i, j) for i, j in bars if number_of[i].isdisjoint(number_of[j])]
    alone = set(range(n_points)) - {*pairs.ravel().tolist()}
    every = [*components, *bars, *((point,) for point in alone)]
    return sorted(tuple(sorted(component)) for component in every)


def _cluster(neighbors: list[set[int]], i: int, j: int, dimension: int) -> list[int]:
    """Return the cluster grown from a measured pair: each point has q distances to others."""
    order, inside, n_links = [i, j], {i, j}, Counter[int]()
    for point in order:
        for other in neighbors[point] - inside:
            n_links[other] += 1
            # The third point in space needs two distances, all others three.
            if n_links[other] >= min(len(order), dimension):
                inside.add(other)
                order.append(other)
    return order


def _clusters(n_points: int, pairs: IntArray, dimension: int) -> list[set[int]]:
    """Return rigid clusters of more than two points, or of more than one on the line."""
    neighbors: list[set[int]] = [set() for _ in range(n_points)]
    listed = pairs.tolist()
    for i, j in listed:
        neighbors[i].add(j)
        neighbors[j].add(i)
    clusters: list[list[int]] = []
    clusters_of: list[set[int]] = [set() for _ in range(n_points)]
    for i, j in listed:
        if clusters_of[i].isdisjoint(clusters_of[j]):
            grown = _cluster(neighbors, i, j, dimension)
            look_after(len(grown))
            if len(grown) > 2 or dimension == 1:
                for point in grown:
                    clusters_of[point].add(len(clusters))
                clusters.append(grown)
    return joined_bodies(clusters, dimension)


def _without_interiors(
    bodies: list[set[int]], held: list[set[int]], bars: list[Pair], dimension: int
) -> IntArray:
    """
    Return pairs among fewer points that give the same joins of bodies and bars, shape (m, 2).

    A body is replaced by q of its points and its shared points; a point with one bar adds nothing.
    """
    n_bars = Counter(point for bar in bars for point in bar)
    while loose := [b for b in bars if any(not held[p] and n_bars[p] == 1 for p in b)]:
        n_bars.subtract(point for bar in loose for point in bar)
        bars = [bar for bar in bars if bar not in loose]
    if dimension == 1 or len(bodies) + len(bars) < 3:
        # Two bodies that share fewer than q points rotate about them.
        return np.empty((0, 2), dtype=np.int64)
    kept = {(min(bar), max(bar)) for bar in bars}
    for body in bodies:
        shared = [point for point in body if len(held[point]) > 1 or n_bars[point] > 0]
        base = [*shared, *(body - {*shared})][:dimension]
        kept.update((min(a, b), max(a, b)) for a, b in combinations(base, 2))
        kept.update((min(a, b), max(a, b)) for a in base for b in shared if b not in base)
    return np.array(sorted(kept), dtype=np.int64)


def joined_bodies(parts: Sequence[Collection[int]], n_common: int) -> list[set[int]]:
    """Return the unions of rigid parts that are joined by `n_common` common points."""
    bodies: dict[int, set[int]] = {}
    holders: dict[int, set[int]] = {}
    for number, part in enumerate(parts):
        bodies[number] = set(part)
        for point in part:
            holders.setdefault(point, set()).add(number)
        changed, new = number, set(part)
        while new:
            others = set().union(*(holders[point] for point in new)) - {changed}
            new = set()
            for other in sorted(others):
                if len(bodies[changed] & bodies[other]) >= n_common:
                    small, large = sorted((changed, other), key=lambda x: len(bodies[x]))
                    moved = bodies.pop(small)
                    for point in moved:
                        holders[point].discard(small)
                        holders[point].add(large)
                    new |= moved if large == other else moved - bodies[large]
                    bodies[large] |= moved
                    changed = large
    return list(bodies.values())


def implied_pairs(n_points: int, pairs: IntArray, dimension: int) -> BoolArray:
    """Return which distances the measured ones imply, generically up to finitely many values."""
    positions, motion = np.random.default_rng(SEED).integers(1, PRIME, (2, n_points, dimension))
    # Points with few pairs come first: eliminating them causes little fill-in.
    order = np.argsort(np.bincount(pairs.ravel(), minlength=n_points), kind='stable')
    i, j = np.argsort(order)[pairs].T
    places, number = positions[order], np.arange(len(pairs))
    rows = np.zeros((len(pairs), n_points, dimension), dtype=np.int64)
    rows[number, i], rows[number, j] = places[i] - places[j], places[j] - places[i]
    speeds = _kept_motion(rows.reshape(len(pairs), -1) % PRIME, motion.ravel())
    total = np.zeros((n_points, n_points), dtype=np.int64)
    for x, v in zip(places.T, speeds.reshape(n_points, dimension).T, strict=True):
        total += (x[:, None] - x) % PRIME * ((v[:, None] - v) % PRIME) % PRIME
    implied = np.empty((n_points, n_points), dtype=np.bool_)
    implied[np.ix_(order, order)] = total % PRIME == 0
    return implied


def _kept_motion(rows: IntArray, motion: IntArray) -> IntArray:
    """Return a motion in the null space of rows modulo the prime; its free entries are given."""
    pivots: list[int] = []
    for column in range(rows.shape[1]):
        rank = len(pivots)
        found = rank + np.flatnonzero(rows[rank:, column])
        if not len(found):
            continue
        pivots.append(column)
        rows[[rank, found[0]]] = rows[[found[0], rank]]
        rows[rank] = rows[rank] * pow(int(rows[rank, column]), -1, PRIME) % PRIME
        below = found[1:]
        rows[below] = (rows[below] - rows[below, column, None] * rows[rank]) % PRIME
        look_after(WORK_OF_A_STEP + found.size * rows.shape[1])
    for row, column in reversed(list(enumerate(pivots))):
        after = slice(column + 1, None)
        motion[column] = -(rows[row, after] * motion[after] % PRIME).sum() % PRIME
    return motion


def _components_of_implied(implied: BoolArray, dimension: int) -> list[IntArray]:
    """
    Return the sets of more than q points all of whose distances are implied, q being 2 or 3.

    q points whose distances are implied lie in one such set, and in no other.
    """
    found: list[IntArray] = []
    known: list[set[int]] = [set() for _ in implied]
    for i, j in np.argwhere(np.triu(implied, 1)).tolist():
        near = implied[i] & implied[j]
        if dimension == 3:
            near[[i, j]] = False
        for number in known[i] & known[j]:
            near[found[number]] = False
        look_after(len(implied))
        while near.any():
            third = int(np.argmax(near))
            points = np.flatnonzero(implied[i] & implied[j] & implied[third])
            near[points] = False
            for point in points.tolist():
                known[point].add(len(found))
            found.append(points)
    return [points for points in found if len(points) >= dimension]
