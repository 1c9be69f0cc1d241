# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses: the connected components of a cover, each with a placement."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import cached_property, partial
import math
from typing import TypeAlias

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.interval.kernels import until
from dg_localization.solver.box import LOWER, UPPER, FloatArray, component_hulls, sub_box
from dg_localization.solver.decompose.rigid_components import is_flexible
from dg_localization.solver.place.existence import settled
from dg_localization.solver.place.placements import MOST_STEPS, place, scaled, sought
from dg_localization.solver.place.proofs import with_known_chirality
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis
from dg_localization.solver.subproblem import MOST_TOGETHER

MAX_ATTEMPTS = 16
"""Most boxes of a component in which a placement is sought."""

LARGEST_M2 = 1e150
"""Squared distances below this can be squared once more."""

MOST_STARTS = 4
"""Most starts of each search for a placement that is proved to agree."""

AT_ONCE = 60
"""Up to this many coordinates are placed regardless of time: that takes a millisecond or two."""

Placement: TypeAlias = tuple[FloatArray | None, bool]
"""A placement in m, None where none could be computed, and whether it is proved."""

Seek: TypeAlias = Callable[[], Placement]
Stopped: TypeAlias = Callable[[], bool]


def never() -> bool:
    """Return False: a clock that never stops."""
    return False


def no_clock() -> Stopped:
    """Return a clock that never stops a placement."""
    return never


def place_everywhere(box: FloatArray, dimension: int) -> FloatArray:
    """Return a placement for a box, with its unconnected parts far enough apart."""
    positions = np.zeros((box.shape[1], dimension))
    placed = np.zeros(len(positions), dtype=np.bool_)
    edge_m, clearance_m = 0.0, 1.0 + 2.0 * math.sqrt(box[LOWER].max())
    for seed in range(len(positions)):
        if placed[seed]:
            continue
        # After smoothing, all pairs that a chain connects have upper bounds.
        island = np.flatnonzero(box[UPPER, seed] < np.inf)
        local = np.asarray(place(sub_box(box, island), dimension, MOST_STEPS))
        local[:, 0] += edge_m - local[:, 0].min()
        positions[island], placed[island] = local, True
        edge_m = float(local[:, 0].max()) + clearance_m
    return positions


def place_problem(problem: Problem, box: FloatArray) -> FloatArray:
    """Return a placement for a box of a problem, with the known chirality."""
    return with_known_chirality(problem, place_everywhere(box, problem.dimension))


def _placements_sought(
    problem: Problem,
    boxes: list[FloatArray],
    starts: Iterable[FloatArray | None],
    stopped: Callable[[], bool],
) -> Iterator[FloatArray]:
    """Yield placements for a component: the given starts, from boxes, and from known pairs."""
    yield from (start for start in starts if start is not None)
    box = boxes[0]
    is_moderate = box[UPPER].max() < LARGEST_M2
    # All pairs of a box are tried before the known ones alone.
    if problem.n_points <= MOST_TOGETHER or not is_moderate:
        for some in boxes[:: max(1, len(boxes) // MAX_ATTEMPTS)]:
            yield place_everywhere(some, problem.dimension)
    if not is_moderate:
        return
    known, rng = problem.pairs, np.random.default_rng(0)
    for attempt in range(MOST_STARTS):
        # The longest distances first, then random ones (EMBED: Havel, Kuntz, Crippen 1983).
        drawn = np.triu(rng.random(box[UPPER].shape) if attempt else np.ones_like(box[UPPER]), 1)
        squared = box[LOWER] + (drawn + drawn.T) * (box[UPPER] - box[LOWER])
        start = scaled(np.sqrt(squared), np.arange(len(squared)), problem.dimension)
        yield sought(start, known.pairs, known.lower, known.upper, stopped)


def _may_move(problem: Problem, found: Hypothesis) -> bool:
    """Return whether a placement is flexible; an unproved one counts as flexible."""
    measured = np.isfinite(problem.upper)
    if measured.all():
        return False
    placed = found.positions
    return placed is None or not found.proved or is_flexible(placed, measured)


class LazyHypothesis(Hypothesis):
    """
    A hypothesis whose placement is computed at first use.

    Its state is not in its fields, so `dataclasses.replace` cannot copy it.
    """

    _seek: Seek | None
    _may_move: Callable[[Hypothesis], bool] | None

    def __init__(
        self,
        seek: Seek | None,
        may_move: Callable[[Hypothesis], bool] | None,
        **more: object,
    ) -> None:
        # The base class is frozen.
        self.__dict__.update(more, _seek=seek, _may_move=may_move)

    @cached_property
    @default_environment()
    def _placed(self) -> Placement:
        return self._seek() if self._seek else (None, False)

    @property
    def positions(self) -> FloatArray | None:
        """One placement in m, shape (n, q); None if none could be computed."""
        return self._placed[0]

    @property
    def proved(self) -> bool:
        """Whether the placement meets every constraint of the problem and lies in a box."""
        return self._placed[1]

    @cached_property
    @default_environment()
    def flexible(self) -> bool:
        """Whether the placements are a continuum even without measurement errors, or may be."""
        return self._may_move is None or self._may_move(self)


def hypotheses_of(
    problem: Problem,
    kept: list[FloatArray],
    pending: Sequence[FloatArray] = (),
    clock: Callable[[], Stopped] = no_clock,
    start_of: Callable[[int, Stopped], FloatArray | None] | None = None,
) -> list[Hypothesis]:
    """
    Return the hypotheses formed by the boxes of a cover, in the order of their first box.

    Their placements are computed at first use, limited by a clock that starts then. Hypotheses
    with boxes that were not examined count as flexible.
    """
    boxes = [*kept, *pending]
    found: list[Hypothesis] = []
    for hull, indices in hulls_of(boxes):
        inside = [boxes[index] for index in indices]
        seek = partial(_placed_in_time, problem, inside, clock, start_of, indices)
        is_open = any(index >= len(kept) for index in indices)
        may_move = None if is_open else partial(_may_move, problem)
        covers = np.array([box[: UPPER + 1] for box in inside])
        known = {'lower': hull[LOWER], 'upper': hull[UPPER], 'boxes': covers}
        found.append(LazyHypothesis(seek, may_move, **known))
    return found


def _placed_in_time(
    problem: Problem,
    inside: list[FloatArray],
    clock: Callable[[], Stopped],
    start_of: Callable[[int, Stopped], FloatArray | None] | None,
    indices: list[int],
) -> Placement:
    """Return a placement for the boxes of a component; None if there was no time for one."""
    stopped = clock()
    # A first placement and its proof take little time for few points.
    ended = never if problem.n_points * problem.dimension <= AT_ONCE else stopped
    # Starts of further boxes are computed only if earlier ones prove nothing.
    starts = (start_of(index, stopped) for index in indices) if start_of else ()
    attempts = _placements_sought(problem, inside, starts, stopped)
    return first_proved(problem, attempts, inside, stopped, ended)


def first_proved(
    problem: Problem,
    attempts: Iterable[FloatArray],
    boxes: Sequence[FloatArray],
    stopped: Stopped,
    ended: Stopped,
) -> Placement:
    """
    Return the first placement that is proved, else the first one.

    No other one is tried when `stopped`, and none is finished when `ended`.
    """
    first = None
    with until(ended):
        for positions in attempts:
            placed, proved = with_known_chirality(problem, positions), False
            with until(ended):
                placed, proved = settled(problem, placed, boxes)
            if proved:
                return placed, True
            first = placed if first is None else first
            if stopped():
                break
    return first, False


def hulls_of(boxes: list[FloatArray]) -> list[tuple[FloatArray, list[int]]]:
    """Return the hulls of the connected components of a cover, in the order of their first box."""
    if len(boxes) < 2:
        return [(box[: UPPER + 1].copy(), [0]) for box in boxes]
    hulls, members = component_hulls(np.array([box[: UPPER + 1] for box in boxes]))
    return [(hull, some.tolist()) for hull, some in zip(hulls, members, strict=True)]
