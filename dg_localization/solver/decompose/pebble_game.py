# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The pebble game: which points of a fleet in the plane are rigid together.

Every point has two pebbles, its degrees of freedom in the plane. A pair that is independent of
those before it takes one of them, and three that stay free on a pair are the motions of a rigid
body (Jacobs, Hendrickson, J. Comput. Phys. 137(2), 1997). What holds is generic: it is true of
almost all placements with this graph.

Searches undo what they wrote down, so that each takes as long as the part of the fleet that it
reaches. The caller looks at the clock between them (`look_after`).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import Graph, graph_of

FREE = -1


class _Game(NamedTuple):
    """The state of a game."""

    pebbles: IntArray  # (n, 2), the other end of the pair that each one holds, FREE for none
    parent: IntArray  # (n,), from where a search came, FREE everywhere between two searches
    reached: IntArray  # (n,), the points of a search in its order


@kernel
def _new_game(n_points: int) -> _Game:
    """Return a game in which all pebbles are free."""
    free = np.full(n_points, FREE)
    return _Game(np.full((n_points, 2), FREE), free, np.empty(n_points, dtype=np.int64))


@kernel(borrows=True)
def _n_free(pebbles: IntArray, point: int) -> int:
    """Return how many pebbles lie on a point."""
    return int(pebbles[point, 0] == FREE) + int(pebbles[point, 1] == FREE)


@kernel(borrows=True)
def _move_pebble(game: _Game, there: int, point: int) -> None:
    """Move a free pebble along the way of a search: its pairs are held from their other ends."""
    pebbles, parent = game.pebbles, game.parent
    taken = 0 if pebbles[there, 0] == FREE else 1
    while there != point:
        above = parent[there]
        pebbles[there, taken] = above
        taken = 0 if pebbles[above, 0] == there else 1
        there = above
    pebbles[point, taken] = FREE


@kernel(borrows=True)
def _fetch_pebble(game: _Game, point: int, other: int) -> bool:
    """Bring a free pebble to `point` from any point but `other`; tell whether there was one."""
    pebbles, parent, reached = game.pebbles, game.parent, game.reached
    parent[point] = point
    parent[other] = other
    reached[0] = point
    n_reached, n_done = 1, 0
    found = FREE
    while n_done < n_reached and found == FREE:
        here = reached[n_done]
        n_done += 1
        for slot in range(2):
            there = pebbles[here, slot]
            if there == FREE or parent[there] != FREE:
                continue
            parent[there] = here
            reached[n_reached] = there
            n_reached += 1
            if _n_free(pebbles, there) > 0:
                found = there
                break
    if found != FREE:
        _move_pebble(game, found, point)
    for x in range(n_reached):
        parent[reached[x]] = FREE
    parent[other] = FREE
    return found != FREE


@kernel(borrows=True)
def _gather(game: _Game, i: int, j: int, wanted: int) -> bool:
    """Bring so many pebbles to two points; tell whether that is possible."""
    pebbles = game.pebbles
    while _n_free(pebbles, i) + _n_free(pebbles, j) < wanted:
        if _n_free(pebbles, i) < 2 and _fetch_pebble(game, i, j):
            continue
        if _n_free(pebbles, j) < 2 and _fetch_pebble(game, j, i):
            continue
        return False
    return True


@kernel(borrows=True)
def _play_some(game: _Game, pairs: IntArray) -> int:
    """Go on with the game over some pairs; return how many of them are independent."""
    pebbles = game.pebbles
    rank = 0
    for x in range(len(pairs)):
        i, j = pairs[x, 0], pairs[x, 1]
        if _gather(game, i, j, 4):
            pebbles[i, 0 if pebbles[i, 0] == FREE else 1] = j
            rank += 1
    return rank


def _play(n_points: int, pairs: IntArray) -> tuple[_Game, int]:
    """Play the game over all pairs; return how it stands, and the number of independent pairs."""
    game = _new_game(n_points)
    rank = 0
    at_once = 1 + WORK_PER_LOOK // (2 * n_points)
    for first in range(0, len(pairs), at_once):
        some = pairs[first : first + at_once]
        rank += int(_play_some(game, some))
        look_after(len(some) * n_points)
    return game, rank


def rank_2d(n_points: int, pairs: IntArray) -> int:
    """Return how many pairs are independent in the plane."""
    return _play(n_points, pairs)[1]


@kernel(borrows=True)
def _hold(game: _Game, graph: Graph, i: int, j: int) -> None:
    """Write 0 as the parent of all points that are rigid with a measured pair, FREE elsewhere."""
    pebbles, parent, reached = game.pebbles, game.parent, game.reached
    _gather(game, i, j, 3)
    parent[:] = 0
    n_reached, n_done = 0, 0
    # Whatever can fetch a pebble from elsewhere moves against the pair.
    for point in range(len(parent)):
        if point != i and point != j and _n_free(pebbles, point) > 0:
            parent[point] = FREE
            reached[n_reached] = point
            n_reached += 1
    while n_done < n_reached:
        here = reached[n_done]
        n_done += 1
        for x in range(graph.start[here], graph.start[here + 1]):
            other = graph.neighbors[x]
            holds = pebbles[other, 0] == here or pebbles[other, 1] == here
            if holds and parent[other] != FREE and other != i and other != j:
                parent[other] = FREE
                reached[n_reached] = other
                n_reached += 1


@kernel
def _components_of_some(
    game: _Game, graph: Graph, pairs: IntArray, some: tuple[int, int], of_pair: IntArray
) -> IntArray:
    """Return the components of some pairs that are in none so far: (number, point) in rows."""
    found = np.empty((2 * len(pairs) + 1, 2), dtype=np.int64)
    count = 0
    for x in range(some[0], some[1]):
        if of_pair[x] != FREE:
            continue
        _hold(game, graph, pairs[x, 0], pairs[x, 1])
        for y in range(len(pairs)):
            if game.parent[pairs[y, 0]] == 0 and game.parent[pairs[y, 1]] == 0:
                of_pair[y] = x
        for point in range(len(game.parent)):
            if game.parent[point] == 0:
                found[count, 0], found[count, 1] = x, point
                count += 1
        game.parent[:] = FREE
    return found[:count].copy()


def rigid_components_2d(n_points: int, pairs: IntArray) -> list[IntArray]:
    """
    Return the maximal sets of points in the plane that are rigid together.

    Two components share one point at most; every pair lies in one, and each component has at most
    one point more than pairs.
    """
    game, _ = _play(n_points, pairs)
    graph = graph_of(n_points, pairs)
    of_pair = np.full(len(pairs), FREE)
    components: list[IntArray] = []
    at_once = 1 + WORK_PER_LOOK // (n_points + 2 * len(pairs))
    for first in range(0, len(pairs), at_once):
        some = first, min(first + at_once, len(pairs))
        found = _components_of_some(game, graph, pairs, some, of_pair)
        ends = np.flatnonzero(np.diff(found[:, 0])) + 1
        components += np.split(found[:, 1], ends) if len(found) else []
        look_after(at_once * (n_points + 2 * len(pairs)))
    return components
