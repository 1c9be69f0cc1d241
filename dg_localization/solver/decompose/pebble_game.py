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

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from dg_localization.interval.kernels import WORK_PER_LOOK, kernel, look_after
from dg_localization.solver.box import IntArray
from dg_localization.solver.decompose.graph import Graph, numbered_graph_of

FREE = -1


class _Game(NamedTuple):
    """
    The state of a game.

    Attributes
    ----------
    pebbles : ndarray of int, shape (n, 2)
        The pair that each pebble holds, by the point at its other end; FREE for none.
    parent : ndarray of int, shape (n,)
        From where a search reached each point; FREE everywhere between two searches.
    reached : ndarray of int, shape (n,)
        The points of a search, in its order.

    """

    pebbles: IntArray
    parent: IntArray
    reached: IntArray


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


def _pairs_at_once(n_points: int) -> int:
    """Return over how many pairs to play between two looks at the clock."""
    return 1 + WORK_PER_LOOK // (2 * n_points)


def _play(n_points: int, pairs: IntArray) -> tuple[_Game, int]:
    """Play the game over all pairs; return how it stands, and the number of independent pairs."""
    game = _new_game(n_points)
    rank = 0
    at_once = _pairs_at_once(n_points)
    for first in range(0, len(pairs), at_once):
        some = pairs[first : first + at_once]
        rank += int(_play_some(game, some))
        look_after(len(some) * n_points)
    return game, rank


def rank_2d(n_points: int, pairs: IntArray) -> int:
    """
    Return how many pairs are independent in the plane.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    int
        The rank; 2 n - 3 when all points are rigid together.

    """
    return _play(n_points, pairs)[1]


class _Found(NamedTuple):
    """
    What is known of rigid components.

    Attributes
    ----------
    of_pair : ndarray of int, shape (m,)
        The component of each pair, FREE where it is not known yet.
    rigid_in, moves_in : ndarray of int, shape (n,)
        The last component that each point was found to belong to, or to move against.
    offsets : ndarray of int, shape (m + 1,)
        Where the members of each component begin.
    members : ndarray of int, shape (2 m + 1,)
        The points of all components. They share points but no pairs, of which each has at least
        one less than points.

    """

    of_pair: IntArray
    rigid_in: IntArray
    moves_in: IntArray
    offsets: IntArray
    members: IntArray


@kernel
def _nothing_found(n_points: int, n_pairs: int) -> _Found:
    """Return that no component is known."""
    return _Found(
        np.full(n_pairs, FREE),
        np.full(n_points, FREE),
        np.full(n_points, FREE),
        np.zeros(n_pairs + 1, dtype=np.int64),
        np.empty(2 * n_pairs + 1, dtype=np.int64),
    )


@kernel(borrows=True)
def _n_held_with(game: _Game, found: _Found, number: int, point: int) -> int:
    """
    Return how many points are held with a point by a component: those reached first, from it.

    It is none where the point can reach a free pebble: then it moves against the component.
    """
    pebbles, parent, reached = game.pebbles, game.parent, game.reached
    parent[point] = point
    reached[0] = point
    n_reached, n_done = 1, 0
    moving = point if _n_free(pebbles, point) > 0 else FREE
    while n_done < n_reached and moving == FREE:
        here = reached[n_done]
        n_done += 1
        for slot in range(2):
            there = pebbles[here, slot]
            if parent[there] != FREE or found.rigid_in[there] == number:
                continue
            parent[there] = here
            reached[n_reached] = there
            n_reached += 1
            if found.moves_in[there] == number or _n_free(pebbles, there) > 0:
                moving = there
                break
    n_held = n_reached if moving == FREE else 0
    # What leads to a free pebble moves, too. Of what else was reached nothing is known.
    while moving != FREE:
        found.moves_in[moving] = number
        moving = parent[moving] if moving != point else FREE
    for x in range(n_reached):
        parent[reached[x]] = FREE
    return n_held


@kernel(borrows=True)
def _write_component(
    game: _Game, found: _Found, graph: Graph, pair_of_arc: IntArray, number: int, i: int, j: int
) -> None:
    """Write the points that are rigid with a measured pair, and which pairs they hold."""
    of_pair, rigid_in, members = found.of_pair, found.rigid_in, found.members
    _gather(game, i, j, 3)
    begin = found.offsets[number]
    rigid_in[i] = rigid_in[j] = number
    members[begin], members[begin + 1] = i, j
    n_done, end = begin, begin + 2
    while n_done < end:
        here = members[n_done]
        n_done += 1
        for x in range(graph.start[here], graph.start[here + 1]):
            there = graph.neighbors[x]
            if rigid_in[there] == number or found.moves_in[there] == number:
                continue
            # Two components have one point in common at most.
            if of_pair[pair_of_arc[x]] != FREE:
                continue
            for y in range(_n_held_with(game, found, number, there)):
                rigid_in[game.reached[y]] = number
                members[end] = game.reached[y]
                end += 1
    found.offsets[number + 1] = end
    for z in range(begin, end):
        for x in range(graph.start[members[z]], graph.start[members[z] + 1]):
            if rigid_in[graph.neighbors[x]] == number:
                of_pair[pair_of_arc[x]] = number


@kernel
def _components_of_some(
    game: _Game,
    found: _Found,
    graph: Graph,
    pair_of_arc: IntArray,
    pairs: IntArray,
    some: tuple[int, int],
    count: int,
) -> int:
    """Write the components of some pairs; return how many there are by now."""
    for x in range(some[0], some[1]):
        if found.of_pair[x] == FREE:
            _write_component(game, found, graph, pair_of_arc, count, pairs[x, 0], pairs[x, 1])
            count += 1
    return count


@kernel
def _components_at_once(n_points: int, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Return where the members of each component begin and end, and the members."""
    game, found = _new_game(n_points), _nothing_found(n_points, len(pairs))
    _play_some(game, pairs)
    graph, pair_of_arc = numbered_graph_of(n_points, pairs)
    every = 0, len(pairs)
    count = _components_of_some(game, found, graph, pair_of_arc, pairs, every, 0)
    return found.offsets[: count + 1].copy(), found.members


def _components_in_turns(n_points: int, pairs: IntArray) -> tuple[IntArray, IntArray]:
    """Return the same, with looks at the clock."""
    game, _ = _play(n_points, pairs)
    found = _nothing_found(n_points, len(pairs))
    graph, pair_of_arc = numbered_graph_of(n_points, pairs)
    count = 0
    at_once = _pairs_at_once(n_points)
    for first in range(0, len(pairs), at_once):
        some = first, min(first + at_once, len(pairs))
        count = int(_components_of_some(game, found, graph, pair_of_arc, pairs, some, count))
        look_after(at_once * n_points)
    return found.offsets[: count + 1], found.members


def rigid_components_2d(n_points: int, pairs: IntArray) -> list[IntArray]:
    """
    Return the maximal sets of points in the plane that are rigid together.

    Parameters
    ----------
    n_points : int
        The number of points.
    pairs : ndarray of int, shape (m, 2)
        The measured pairs.

    Returns
    -------
    list of ndarray of int
        The points of each component, in any order. Two components share one point at most; every
        pair lies in one.

    """
    is_small = n_points * len(pairs) <= WORK_PER_LOOK
    components = _components_at_once if is_small else _components_in_turns
    offsets, members = components(n_points, pairs)
    return [members[a:b] for a, b in pairwise(offsets.tolist())]
