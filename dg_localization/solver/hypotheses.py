"""Hypotheses: the connected components of a cover, each with a placement."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dg_localization.solver.box import LOWER, UPPER, FloatArray
from dg_localization.solver.placements import agrees, place, with_handedness
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis
from dg_localization.solver.rigidity import is_flexible

MAX_ATTEMPTS = 16
"""In how many boxes of a component a placement is looked for."""


def components(bounds: FloatArray) -> list[NDArray[np.intp]]:
    """
    Group boxes that touch.

    Parameters
    ----------
    bounds : ndarray, shape (k, 2, n, n)
        Lower and upper bounds of the boxes.

    Returns
    -------
    list of ndarray of int
        The indices of the boxes of each connected component.

    """
    unseen = np.ones(len(bounds), dtype=bool)
    groups = []
    for seed in range(len(bounds)):
        if not unseen[seed]:
            continue
        unseen[seed] = False
        group = [seed]
        for member in group:
            low, high = bounds[member]
            others = np.flatnonzero(unseen)
            touching = np.all(
                (bounds[others, LOWER] <= high) & (bounds[others, UPPER] >= low), axis=(1, 2)
            )
            group.extend(others[touching].tolist())
            unseen[others[touching]] = False
        groups.append(np.array(sorted(group)))
    return groups


def _islands(upper: FloatArray) -> list[NDArray[np.intp]]:
    """Group the points between which every distance is bounded."""
    unseen = np.ones(len(upper), dtype=bool)
    islands = []
    for seed in range(len(upper)):
        if unseen[seed]:
            island = np.flatnonzero(np.isfinite(upper[seed]))
            unseen[island] = False
            islands.append(island)
    return islands


def place_everywhere(box: FloatArray, dimension: int) -> FloatArray:
    """
    Return a placement for a contracted box, its unconnected parts far enough apart.

    Parameters
    ----------
    box : ndarray, shape (4, n, n)
        The box in m^2; it may be unbounded.
    dimension : int
        The dimension q of the space.

    Returns
    -------
    ndarray, shape (n, q)
        Coordinates in m.

    """
    positions = np.zeros((box.shape[1], dimension))
    edge = 0.0
    clearance = 1.0 + 2.0 * float(np.sqrt(box[LOWER].max()))
    for island in _islands(box[UPPER]):
        local = place(np.ascontiguousarray(box[:, island[:, None], island]), dimension)
        local[:, 0] += edge - local[:, 0].min()
        edge = local[:, 0].max() + clearance
        positions[island] = local
    return positions


def _hypothesis(problem: Problem, boxes: list[FloatArray]) -> Hypothesis:
    bounds = np.array([box[: UPPER + 1] for box in boxes])
    step = max(1, len(boxes) // MAX_ATTEMPTS)
    positions = None
    proved = False
    for box in boxes[::step]:
        candidate = with_handedness(problem, place_everywhere(box, problem.dimension))
        proved = agrees(problem, candidate)
        if positions is None or proved:
            positions = candidate
        if proved:
            break
    assert positions is not None
    return Hypothesis(
        lower=bounds[:, LOWER].min(axis=0),
        upper=bounds[:, UPPER].max(axis=0),
        boxes=bounds,
        positions=positions,
        proved=proved,
        flexible=is_flexible(positions, np.isfinite(problem.upper)),
    )


def hypotheses_of(problem: Problem, boxes: list[FloatArray]) -> tuple[Hypothesis, ...]:
    """
    Return the hypotheses that the boxes of a cover form, in the order of their first box.

    Parameters
    ----------
    problem : Problem
        The problem.
    boxes : list of ndarray, shape (4, n, n)
        The cover.

    Returns
    -------
    tuple of Hypothesis
        One for each connected component.

    """
    if not boxes:
        return ()
    bounds = np.array([box[: UPPER + 1] for box in boxes])
    return tuple(
        _hypothesis(problem, [boxes[index] for index in group]) for group in components(bounds)
    )
