# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Joint poses: what the readings of several bodies say together, not pair by pair.

Tables of headings (`headings`) take the pairs one by one, and each with all places there are. Here
a box of the poses of a few bodies is narrowed by linear programs over all their readings, and
halved along its widest heading: so headings and places narrow each other. Bodies are taken in
parties of three, since the work grows with a high power of their number.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.pairs.cover import arc_around
from dg_localization.pairs.cuts import B_RADIUS, A
from dg_localization.pairs.half_spaces import HIGH, LOW
from dg_localization.pairs.headings import Headings, Pair
from dg_localization.pairs.joint_kernels import HEADING, POSSIBLE, narrow_boxes
from dg_localization.pairs.readings import PairReadings
from dg_localization.pairs.turns import TURN

Party = tuple[int, ...]

PARTY = 3
"""Bodies whose poses are narrowed together."""

PAIR_FACTOR = 4
"""So many times the boxes for two bodies, since each takes that much less time."""

PASSES = 6
"""How often a box is narrowed at most before it is halved."""

FRUITLESS = 12
"""When so many boxes narrow nothing, twice as many hardly ever do."""

BATCH = 16
"""
Boxes narrowed between two looks at the clock, in about 1 ms: where other threads wait for the
interpreter, each return to it may cost more than a box.
"""


@dataclass(frozen=True)
class JointPoses:
    """
    The poses of bodies that agree with their readings.

    Parameters
    ----------
    lower_m, upper_m : numpy.ndarray, shape (n, 3)
        Bounds of the places.
    arcs_rad : numpy.ndarray, shape (n, 2)
        Bounds of the headings, counterclockwise from the first to the second.
    ruled_out_by : tuple of int, or None
        The pair of bodies that weighs most in the proof that nothing is left; None while the
        hypothesis is possible.

    """

    lower_m: np.ndarray
    upper_m: np.ndarray
    arcs_rad: np.ndarray
    ruled_out_by: Pair | None = None

    @classmethod
    def of(cls, headings: Headings) -> JointPoses:
        """Return what tables of headings have left of a hypothesis that is possible."""
        arcs = [headings.arc_rad(body) for body in range(len(headings.allowed))]
        return cls(headings.lower_m, headings.upper_m, np.array(arcs))

    @property
    def possible(self) -> bool:
        """Whether any poses agree with all readings."""
        return self.ruled_out_by is None


@default_environment()
def narrow_jointly(
    poses: JointPoses,
    readings: Mapping[Pair, PairReadings],
    max_boxes: int,
    *,
    stopped: Callable[[], bool] = lambda: False,
) -> JointPoses:
    """
    Narrow the poses of bodies in the plane by the distances of their readings.

    Parameters
    ----------
    poses : JointPoses
        Bounds of all poses, in one frame; places may be unbounded.
    readings : mapping of (int, int) to PairReadings
        What two bodies, A and B of the readings, measured of each other in the window. No outlier
        is tolerated.
    max_boxes : int
        Into how many boxes the poses of a party of bodies are divided at most.
    stopped : callable, optional
        Asked between bounded steps; once it is true the poses are returned as they are.

    Returns
    -------
    JointPoses
        Whatever was not proved impossible.

    """
    box = np.stack([poses.lower_m, poses.upper_m])
    box[:, :, HEADING] = poses.arcs_rad.T
    if np.any(poses.lower_m[:, 2]) or np.any(poses.upper_m[:, 2]):
        return poses
    for party in _parties(box, readings, stopped):
        if stopped():
            break
        search = _Party(party, readings, max_boxes, stopped)
        left, ruled_out_by = search.run(box[:, party])
        if ruled_out_by is not None:
            return JointPoses(poses.lower_m, poses.upper_m, poses.arcs_rad, ruled_out_by)
        box[:, party] = left
    lower_m, upper_m = poses.lower_m.copy(), poses.upper_m.copy()
    lower_m[:, :2], upper_m[:, :2] = box[LOW, :, :2], box[HIGH, :, :2]
    return JointPoses(lower_m, upper_m, box[:, :, HEADING].T.copy())


def _parties(
    box: np.ndarray, readings: Mapping[Pair, PairReadings], stopped: Callable[[], bool]
) -> list[list[int]]:
    """
    Return parties of bodies, so that every body that measured anything is in one at least.

    Those whose headings are known best come first: they narrow those of the next ones.
    """
    known = np.all(np.isfinite(box), axis=(0, 2))
    pairs = [pair for pair in readings if known[pair[0]] and known[pair[1]]]
    bodies = sorted({body for pair in pairs for body in pair})
    if len(bodies) <= PARTY:
        return [bodies] if pairs else []
    width = box[HIGH, :, HEADING] - box[LOW, :, HEADING]
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
    """Return all parties that are linked in themselves; of two bodies where no third one is."""
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
    """Return how many pairs of a party measured each other."""
    return sum(pair in linked for pair in combinations(party, 2))


class _Party:
    """The search for the joint poses of a few bodies."""

    def __init__(
        self,
        bodies: list[int],
        readings: Mapping[Pair, PairReadings],
        max_boxes: int,
        stopped: Callable[[], bool],
    ) -> None:
        self._max_boxes = max_boxes * (PAIR_FACTOR if len(bodies) == 2 else 1)
        self._stopped = stopped
        self._named = [pair for pair in readings if pair[0] in bodies and pair[1] in bodies]
        rows = [readings[pair].table for pair in self._named]
        self._pairs = np.array([[bodies.index(a), bodies.index(b)] for a, b in self._named])
        self._starts = np.cumsum([0, *(len(part) for part in rows)])
        self._table = np.concatenate(rows)
        self._levers = self._lengths(len(bodies))

    def run(self, box: np.ndarray) -> tuple[np.ndarray, Pair | None]:
        """Return the hull of all poses that are left, and the pair that leaves none."""
        boxes = np.array([box])
        while True:
            found = np.full(len(boxes), POSSIBLE)
            for first in range(0, len(boxes), BATCH):
                if self._stopped():
                    return _hull(boxes[found == POSSIBLE]), None
                batch = slice(first, first + BATCH)
                narrow_boxes(
                    boxes[batch], self._pairs, self._starts, self._table, PASSES, found[batch]
                )
            left = boxes[found == POSSIBLE]
            if len(left) == 0:
                return box, self._named[found[-1]]
            fruitless = len(left) == len(boxes) >= FRUITLESS and np.array_equal(_hull(left), box)
            if fruitless or 2 * len(left) > self._max_boxes:
                return _hull(left), None
            boxes = self._halves(left)

    def _lengths(self, count: int) -> np.ndarray:
        """Return how far the points of each body are from it, mostly: what a turn moves them."""
        lengths = np.zeros(count)
        for number, (a, b) in enumerate(self._pairs):
            rows = self._table[self._starts[number] : self._starts[number + 1]]
            of_a = np.hypot(rows[:, A], rows[:, A + 1])
            lengths[a] = max(lengths[a], np.median(of_a))
            lengths[b] = max(lengths[b], np.median(rows[:, B_RADIUS]))
        return lengths

    def _halves(self, boxes: np.ndarray) -> np.ndarray:
        """Return both halves of boxes, each along the heading that moves points most."""
        headings = boxes[:, :, :, HEADING]
        body = np.argmax(self._levers * (headings[:, HIGH] - headings[:, LOW]), axis=1)
        number = np.arange(len(boxes))
        middle = 0.5 * headings[number, LOW, body] + 0.5 * headings[number, HIGH, body]
        halves = np.repeat(boxes, 2, axis=0)
        halves[2 * number, HIGH, body, HEADING] = middle
        halves[2 * number + 1, LOW, body, HEADING] = middle
        return halves


def _hull(boxes: np.ndarray) -> np.ndarray:
    """Return the smallest box around some: of headings the shortest arcs."""
    hull = np.stack([boxes[:, LOW].min(axis=0), boxes[:, HIGH].max(axis=0)])
    for body in range(hull.shape[1]):
        ends = boxes[:, LOW, body, HEADING], boxes[:, HIGH, body, HEADING]
        arc = arc_around(*ends)
        if arc[1] - arc[0] < min(TURN, hull[HIGH, body, HEADING] - hull[LOW, body, HEADING]):
            hull[:, body, HEADING] = arc
    return hull
