# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Idle anchors: nothing ties them to any point but other anchors.

They tell nothing of the other points, and the solver takes longer with every point. So it is asked
of the others, and its hypotheses are completed with what is known of the idle ones anyway.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.bodies import AnchorGeometry
from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.directions import best_rotation
from dg_localization.interval.arrays import Interval
from dg_localization.solver.problem import Chirality
from dg_localization.solver.result import Hypothesis


@dataclass(frozen=True)
class Busy:
    """
    The rows that are no idle anchors, and what fixes their frame.

    Parameters
    ----------
    rows : tuple of int
    cores : tuple of tuple of int
        Sets of q anchors among them that span a hyperplane, the largest first.
    chiralities : tuple of Chirality
        Of anchors among them.

    """

    rows: tuple[int, ...]
    cores: tuple[tuple[int, ...], ...]
    chiralities: tuple[Chirality, ...] = ()


def busy_of(
    solved: Constraints, points: Sequence[int], n_robots: int, anchors: AnchorGeometry
) -> Busy:
    """
    Return the rows that are no idle anchors.

    Where they do not fix the frame, those of the anchors that span most are among them.

    Parameters
    ----------
    solved : Constraints
    points : sequence of int
        The points of its rows.
    n_robots : int
        An anchor among the robots is never idle.
    anchors : AnchorGeometry

    """
    row_of = {point: row for row, point in enumerate(points)}
    landmarks = {
        row for row, point in enumerate(points) if point >= n_robots and point in anchors.boxes
    }
    others = [row for row in range(len(points)) if row not in landmarks]
    known = np.isfinite(solved.upper[:, others]) | (solved.lower[:, others] > 0.0)
    busy = {*others, *np.flatnonzero(known.any(axis=1)).tolist()}
    busy |= {solved.rows[ray.key.target] for rays in solved.rays.values() for ray in rays}
    geometry = anchors.among([points[row] for row in busy])
    if not geometry.chiralities:
        # The idle ones may tell the others from their mirror image.
        geometry = anchors
        busy |= {row_of[point] for point in anchors.spanning}
    return Busy(
        tuple(sorted(busy)),
        tuple(
            tuple(row_of[point] for point in core)
            for core in geometry.cores
            if busy >= {row_of[point] for point in core}
        ),
        tuple(
            Chirality(tuple(row_of[point] for point in chirality.points), chirality.sign)
            for chirality in geometry.chiralities
        ),
    )


def completed(
    hypothesis: Hypothesis,
    rows: Sequence[int],
    solved: Constraints,
    anchors: Mapping[int, Interval],
) -> Hypothesis:
    """
    Return a hypothesis of some rows as one of all; the others are anchors.

    Parameters
    ----------
    hypothesis : Hypothesis
    rows : sequence of int
    solved : Constraints
        Of all rows.
    anchors : mapping of int to Interval
        Coordinates of the anchors, by their rows.

    """
    if len(rows) == len(solved.points):
        return hypothesis
    among = np.ix_(rows, rows)
    boxes = np.empty((len(hypothesis.boxes), 2, *solved.lower.shape))
    boxes[:, 0], boxes[:, 1] = solved.lower, solved.upper
    for box, known in zip(boxes, hypothesis.boxes, strict=True):
        box[0][among], box[1][among] = known
    positions = hypothesis.positions
    return replace(
        hypothesis,
        lower=boxes[:, 0].min(axis=0),
        upper=boxes[:, 1].max(axis=0),
        boxes=boxes,
        positions=None if positions is None else _positions_of_all(positions, rows, anchors),
        proved=False,
    )


def _positions_of_all(
    positions_m: NDArray[np.float64], rows: Sequence[int], anchors: Mapping[int, Interval]
) -> NDArray[np.float64]:
    """Return the positions of all rows where those of some are known."""
    centers_m = {row: 0.5 * (box.lower + box.upper) for row, box in anchors.items()}
    n_points = len({*rows, *anchors})
    found = np.empty((n_points, positions_m.shape[1]))
    found[list(rows)] = positions_m
    known = [row for row in rows if row in anchors]
    start_m, end_m = np.array([centers_m[row] for row in known]), found[known]
    turn = best_rotation(start_m - start_m.mean(axis=0), end_m - end_m.mean(axis=0))
    for row in anchors.keys() - {*rows}:
        found[row] = turn @ (centers_m[row] - start_m.mean(axis=0)) + end_m.mean(axis=0)
    return found
