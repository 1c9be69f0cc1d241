# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses: the connected components of a cover, each with a placement."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
import math

import numpy as np

from dg_localization.interval.kernels import until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, component_hulls, sub_box
from dg_localization.solver.place.existence import has_exact_pairs, settled
from dg_localization.solver.place.placements import MOST_STEPS, place, scaled, sought
from dg_localization.solver.place.proofs import with_known_chirality
from dg_localization.solver.place.rigidity import is_flexible
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis

MAX_ATTEMPTS = 16
"""Most boxes of a component in which a placement is sought."""

LARGEST_M2 = 1e150
"""Squared distances below this can be squared once more."""

MOST_SMALL, MOST_DENSE = 12, 60
"""Few points, or exact distances of up to `MOST_DENSE`, are placed by known pairs alone where no
box leads to a placement. With 16 few points, fleets of 20 robots take up to 2.5 times as long."""

AT_ONCE = 60
"""Up to this many coordinates are placed whatever the time: that takes a millisecond or two."""


def never() -> bool:
    """Return False: no limit of a call stops a placement that is asked for later."""
    return False


def place_everywhere(box: FloatArray, dimension: int) -> FloatArray:
    """Return a placement for a box, its unconnected parts far enough apart."""
    positions = np.zeros((box.shape[1], dimension))
    placed = np.zeros(len(positions), dtype=np.bool_)
    edge_m, clearance_m = 0.0, 1.0 + 2.0 * math.sqrt(box[LOWER].max())
    for seed in range(len(positions)):
        if placed[seed]:
            continue
        # The triangles bound every distance between points that any chain connects.
        island = np.flatnonzero(box[UPPER, seed] < np.inf)
        local = np.asarray(place(sub_box(box, island), dimension, MOST_STEPS))
        local[:, 0] += edge_m - local[:, 0].min()
        positions[island], placed[island] = local, True
        edge_m = float(local[:, 0].max()) + clearance_m
    return positions


def place_problem(problem: Problem, box: FloatArray) -> FloatArray:
    """Return a placement for a box of a problem, with the chirality that is known."""
    return with_known_chirality(problem, place_everywhere(box, problem.dimension))


def placement_in(
    problem: Problem,
    boxes: list[FloatArray],
    starts: Iterable[FloatArray | None],
    stopped: Callable[[], bool],
) -> tuple[FloatArray, bool]:
    """Return a placement for the boxes of a component, and whether it is proved to agree."""
    ended = _end_of_placing(problem, stopped)
    for start in starts:
        if start is not None:
            found = with_known_chirality(problem, start)
            found, proved = _settled_in_time(problem, found, boxes, ended)
            if proved or stopped():
                return found, proved
    is_moderate = boxes[0][UPPER].max() < LARGEST_M2
    if problem.n_points > MOST_DENSE and is_moderate:
        return _placement_by_known_pairs(problem, boxes, stopped)
    first = None
    for box in boxes[:: max(1, len(boxes) // MAX_ATTEMPTS)]:
        found = place_problem(problem, box)
        found, proved = _settled_in_time(problem, found, boxes, ended)
        if first is None or proved:
            first = found
        if proved or stopped():
            return first, proved
    assert first is not None
    # Parts of a larger problem are placed together with the rest of it.
    is_small = problem.n_points <= MOST_SMALL and stopped is not never
    if is_moderate and (is_small or has_exact_pairs(problem)):
        with until(stopped):
            found, proved = _placement_by_known_pairs(problem, boxes, stopped)
            if proved:
                return found, True
    return first, False


def _settled_in_time(
    problem: Problem, positions: FloatArray, boxes: list[FloatArray], ended: Callable[[], bool]
) -> tuple[FloatArray, bool]:
    """Return what `settled` does; what was given, not proved, where there is no time for it."""
    found = positions, False
    with until(ended):
        found = settled(problem, positions, boxes)
    return found


def _end_of_placing(problem: Problem, stopped: Callable[[], bool]) -> Callable[[], bool]:
    """Return what ends a first placement, its proof and its rank: nothing for few points."""
    return never if problem.n_points * problem.dimension <= AT_ONCE else stopped


def _placement_by_known_pairs(
    problem: Problem, boxes: list[FloatArray], stopped: Callable[[], bool]
) -> tuple[FloatArray, bool]:
    """Return a placement of many points, laid out by the longest distances in a box first."""
    known = problem.pairs
    first, second = known.pairs.T
    start = scaled(boxes[0][UPPER], problem.dimension)
    # There is more room in what was measured, but others may lie there as well.
    in_box = boxes[0][LOWER, first, second], boxes[0][UPPER, first, second]
    for lower, upper in ((known.lower, known.upper), in_box):
        positions = sought(start, known.pairs, lower, upper, stopped)
        positions, proved = settled(problem, with_known_chirality(problem, positions), boxes)
        if proved:
            return positions, True
    return positions, False


@dataclass
class _Placed:
    """What is known of the placements of a hypothesis; nothing where there was no time."""

    positions: FloatArray | None = None
    proved: bool = False
    flexible: bool = True


def hypotheses_of(
    problem: Problem,
    boxes: list[FloatArray],
    stopped: Callable[[], bool] = never,
    start_of: Callable[[int], FloatArray | None] | None = None,
) -> tuple[Hypothesis, ...]:
    """Return the hypotheses that the boxes of a cover form, in the order of their first box."""
    ended = _end_of_placing(problem, stopped)
    measured = np.isfinite(problem.upper)
    parts = hulls_of(boxes)
    placed = [_Placed() for _ in parts]
    for number, (each, (_, indices)) in enumerate(zip(placed, parts, strict=True)):
        if number and ended():
            break
        with until(ended):
            # Those of further boxes are computed only where the first ones prove nothing.
            near = map(start_of, indices) if start_of else ()
            inside = [boxes[index] for index in indices]
            each.positions, each.proved = placement_in(problem, inside, near, stopped)
            each.flexible = not measured.all() and (
                not each.proved or is_flexible(each.positions, measured)
            )
    hypotheses = []
    for each, ((lower, upper), indices) in zip(placed, parts, strict=True):
        bounds = np.array([boxes[index][: UPPER + 1] for index in indices])
        found = each.positions, each.proved, each.flexible
        hypotheses.append(Hypothesis(lower, upper, bounds, *found))
    return tuple(hypotheses)


def hulls_of(boxes: list[FloatArray]) -> list[tuple[FloatArray, list[int]]]:
    """Return the hulls of the connected components of a cover, in the order of their first box."""
    if not boxes:
        return []
    hulls, members = component_hulls(np.array([box[: UPPER + 1] for box in boxes]))
    return [(hull, some.tolist()) for hull, some in zip(hulls, members, strict=True)]
