# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Joint poses of several bodies, by all their readings together instead of pair by pair.

A hypothesis of the moment gives the places of all bodies in its own frame, a shape without
headings. The readings of a window, carried to now in body frames, restrict the joint poses of a
few bodies: by set inversion over all of them at once, and, if no outlier is tolerated, by linear
programs over all their distances. If no joint pose is left, the hypothesis is impossible, as most
mirror images are, since odometry distinguishes left from right. Bodies are taken in parties of
three, since the work grows with a high power of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.interval.pave import Examined, pave
from dg_localization.poses.cover import arc_around
from dg_localization.poses.cuts import A_BODY, A_RADIUS, B_BODY, B_RADIUS, GROUP
from dg_localization.poses.half_spaces import HIGH, LOW, YAW
from dg_localization.poses.joint_kernels import POSSIBLE, narrow_box
from dg_localization.poses.readings import PairReadings
from dg_localization.poses.search import PairOptions, find_poses
from dg_localization.poses.turns import TURN

Pair = tuple[int, int]
Party = tuple[int, ...]

PARTY_SIZE = 3
"""Bodies whose poses are narrowed together."""

PASSES = 5
"""
Most times that linear programs narrow a box before it is halved. With 3, six robots take 3 ms
less, and the tutorial's recording has one hypothesis in 111 answers in place of 132.
"""

FRUITLESS = 12
"""The search ends after this many boxes without a gain: twice as many rarely gain anything."""


@dataclass(frozen=True)
class JointPoses:
    """
    The poses of bodies that agree with their readings.

    Parameters
    ----------
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the places.
    arcs_rad : numpy.ndarray, shape (n, 2)
        Bounds of the headings, counterclockwise from the first angle to the second.
    ruled_out_by : tuple of int, or None
        The pair of bodies that ruled out most if no pose is left; None if the hypothesis is
        possible.

    """

    lower_m: np.ndarray
    upper_m: np.ndarray
    arcs_rad: np.ndarray
    ruled_out_by: Pair | None = None


@default_environment()
def narrow_jointly(
    poses: JointPoses,
    readings: Mapping[Pair, PairReadings],
    options: PairOptions,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> JointPoses:
    """
    Narrow the poses of bodies by readings between pairs of them (A and B of the readings).

    `poses` bound all bodies in one frame; places may be unbounded. `options` apply to each party,
    with the outliers of each pair. When `stopped` becomes true, the poses found so far are
    returned.
    """
    by_programs = options.max_programs > 0 and options.max_outliers == 0
    box = np.zeros((2, len(poses.arcs_rad), 4))
    box[LOW, :, :YAW], box[HIGH, :, :YAW] = poses.lower_m, poses.upper_m
    box[:, :, YAW] = poses.arcs_rad.T
    for party in _parties(box, readings, stopped):
        if stopped():
            break
        named = [pair for pair in readings if {*pair} <= {*party}]
        table = _joint_table(party, [(pair, readings[pair]) for pair in named])
        found = find_poses(table, box[:, party].reshape(1, 2, -1), options, stopped)
        if not len(found.boxes):
            worst = named[int(np.argmax(found.guilty))]
            return JointPoses(poses.lower_m, poses.upper_m, poses.arcs_rad, worst)
        box[:, party] = _hull(found.boxes, box[:, party])
        if by_programs:
            left, guilty = _narrow_by_programs(box[:, party], table, options, stopped)
            if guilty != POSSIBLE:
                return JointPoses(poses.lower_m, poses.upper_m, poses.arcs_rad, named[guilty])
            box[:, party] = left
    places = box[:, :, :YAW].copy()
    return JointPoses(places[LOW], places[HIGH], box[:, :, YAW].T.copy())


def _joint_table(party: list[int], readings: list[tuple[Pair, PairReadings]]) -> np.ndarray:
    """Return the table of the readings of some pairs for the kernels; each pair is a group."""
    table = np.concatenate([part.table for _, part in readings])
    bodies = [[party.index(body) for body in pair] for pair, _ in readings]
    groups = np.repeat(np.arange(len(readings)), [len(part.table) for _, part in readings])
    table[:, [A_BODY, B_BODY]], table[:, GROUP] = np.array(bodies)[groups], groups
    return table


def _parties(
    box: np.ndarray, readings: Mapping[Pair, PairReadings], stopped: Callable[[], bool]
) -> list[list[int]]:
    """
    Return parties of bodies that together hold every body with a reading.

    Parties with the best known headings come first: they narrow the headings of later ones.
    """
    known = np.all(np.isfinite(box), axis=(0, 2))
    pairs = [pair for pair in readings if known[pair[0]] and known[pair[1]]]
    bodies = sorted({body for pair in pairs for body in pair})
    if len(bodies) <= PARTY_SIZE:
        return [bodies] if pairs else []
    width = box[HIGH, :, YAW] - box[LOW, :, YAW]
    linked = {(min(pair), max(pair)) for pair in pairs}
    candidates = [
        (-_n_links(party, linked), width[list(party)].sum(), party)
        for party in _connected_parties(linked, stopped)
    ]
    candidates.sort()
    parties: list[list[int]] = []
    met = dict.fromkeys(bodies, 0)
    for fewest in (1, 2):
        for *_, party in candidates:
            if any(met[body] < fewest for body in party) and list(party) not in parties:
                parties.append(list(party))
                for body in party:
                    met[body] += 1
    return parties


def _connected_parties(linked: Collection[Pair], stopped: Callable[[], bool]) -> set[Party]:
    """Return all connected parties of three bodies, and of two if no third one is linked."""
    neighbors: dict[int, set[int]] = {}
    for pair in linked:
        for body, other in (pair, pair[::-1]):
            neighbors.setdefault(body, set()).add(other)
    parties: set[Party] = set()
    for pair in linked:
        if stopped():
            break
        others = neighbors[pair[0]].union(neighbors[pair[1]]).difference(pair)
        parties |= {tuple(sorted((*pair, other))) for other in others} or {pair}
    return parties


def _n_links(party: Party, linked: Collection[Pair]) -> int:
    """Return the number of linked pairs of a party."""
    return sum(pair in linked for pair in combinations(party, 2))


def _hull(boxes: np.ndarray, before: np.ndarray) -> np.ndarray:
    """Return the hull (2, n, 4) of boxes (k, 2, 4 n), with the shortest arcs of headings."""
    boxes = boxes.reshape(-1, *before.shape)
    hull = np.stack([boxes[:, LOW].min(axis=0), boxes[:, HIGH].max(axis=0)])
    for body in range(hull.shape[1]):
        arc = arc_around(boxes[:, LOW, body, YAW], boxes[:, HIGH, body, YAW])
        if arc[1] - arc[0] < min(TURN, hull[HIGH, body, YAW] - hull[LOW, body, YAW]):
            hull[:, body, YAW] = arc
    return hull


def _narrow_by_programs(
    box: np.ndarray, table: np.ndarray, options: PairOptions, stopped: Callable[[], bool]
) -> tuple[np.ndarray, int]:
    """Return the hull (2, n, 4) of the remaining poses, and the pair that leaves none."""
    levers_m = _levers_m(table, box.shape[1])
    guilty = POSSIBLE

    def examine(boxes: np.ndarray) -> Examined[np.ndarray]:
        nonlocal guilty
        possible = np.ones(len(boxes), dtype=np.bool_)
        reach = _outward(boxes)
        hull = np.full_like(reach[0], -np.inf)
        for number in _farthest_first(boxes):
            if options.hull_only and (reach[number] <= hull).all():
                continue
            if stopped():
                return Examined(rest=[boxes[possible]])
            ruled_out_by = narrow_box(boxes[number], table, PASSES)
            if ruled_out_by == POSSIBLE:
                hull = np.maximum(hull, _outward(boxes[number]))
            else:
                possible[number], guilty = False, ruled_out_by
        left = boxes[possible]
        if len(left) == 0:
            return Examined()
        nothing_left_out = len(left) == len(boxes) >= FRUITLESS
        fruitless = nothing_left_out and np.array_equal(_hull(left, box), box)
        if fruitless or 2 * len(left) > options.max_programs:
            return Examined(kept=[left])
        return Examined(parts=[_halves(left, levers_m)])

    # All boxes of one depth are examined together: whether more of them help shows in their hull.
    found = pave([box.reshape(1, 2, -1).copy()], examine, lambda *_: not stopped())
    left = [*found.kept, *found.pending]
    return (_hull(left[0], box), POSSIBLE) if left else (box, int(guilty))


def _levers_m(table: np.ndarray, n_bodies: int) -> np.ndarray:
    """Return the typical lever arm of a rotation of each body."""
    levers_m = np.zeros(n_bodies)
    for group in np.unique(table[:, GROUP]):
        own = table[table[:, GROUP] == group]
        for column, radius in ((A_BODY, A_RADIUS), (B_BODY, B_RADIUS)):
            body = int(own[0, column])
            levers_m[body] = max(levers_m[body], np.median(own[:, radius]))
    return levers_m


def _outward(boxes: np.ndarray) -> np.ndarray:
    """Return all bounds of boxes (..., 2, n), of which the greater ones reach farther."""
    return np.concatenate([-boxes[..., LOW, :], boxes[..., HIGH, :]], axis=-1)


def _farthest_first(boxes: np.ndarray) -> np.ndarray:
    """Return the numbers of boxes, those with headings farthest from the mean first."""
    headings = boxes[..., YAW::4].sum(axis=1)
    squares = np.square(headings - headings.mean(axis=0)).sum(axis=1)
    return np.argsort(-squares, kind='stable')


def _halves(boxes: np.ndarray, levers_m: np.ndarray) -> np.ndarray:
    """Return both halves of boxes, each split along the heading that moves points most."""
    headings = boxes[..., YAW::4]
    body = np.argmax(levers_m * (headings[:, HIGH] - headings[:, LOW]), axis=1)
    number, axis = np.arange(len(boxes)), 4 * body + YAW
    middle = 0.5 * boxes[number, LOW, axis] + 0.5 * boxes[number, HIGH, axis]
    halves = np.repeat(boxes, 2, axis=0)
    halves[2 * number, HIGH, axis] = middle
    halves[2 * number + 1, LOW, axis] = middle
    return halves
