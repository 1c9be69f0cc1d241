# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Hypotheses of parts of a problem, whose placements hardly anybody asks for."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from dg_localization.interval.environment import default_environment
from dg_localization.solver.box import UPPER, FloatArray
from dg_localization.solver.place.hypotheses import hulls_of, placement_in
from dg_localization.solver.place.rigidity import is_flexible
from dg_localization.solver.problem import Problem
from dg_localization.solver.result import Hypothesis


class UnplacedHypothesis(Hypothesis):
    """
    A hypothesis whose placement is sought when it is first asked for.

    Parameters
    ----------
    problem : Problem
        The problem.
    hull : ndarray, shape (2, n, n)
        Lower and upper bounds in m^2.
    boxes : list of ndarray, shape (4, n, n)
        Its boxes in m^2.

    """

    _problem: Problem
    _inside: list[FloatArray]

    def __init__(self, problem: Problem, hull: FloatArray, boxes: list[FloatArray]) -> None:
        # The base class is frozen.
        bounds = np.array([box[: UPPER + 1] for box in boxes])
        lower, upper = hull
        values = {'lower': lower, 'upper': upper, 'boxes': bounds}
        self.__dict__.update(values, _problem=problem, _inside=boxes)

    @cached_property
    @default_environment()
    def _placed(self) -> tuple[FloatArray, bool]:
        """A placement in m, and whether it is proved to agree."""
        return placement_in(self._problem, self._inside, [], lambda: False)

    @property
    def positions(self) -> FloatArray:
        """One placement in m, shape (n, q)."""
        return self._placed[0]

    @property
    def proved(self) -> bool:
        """Whether it meets every constraint of the problem and lies in a box."""
        return self._placed[1]

    @cached_property
    @default_environment()
    def flexible(self) -> bool:
        """Whether the placements are a continuum even without measurement errors."""
        return bool(is_flexible(self.positions, np.isfinite(self._problem.upper)))


def unplaced_hypotheses_of(
    problem: Problem, boxes: list[FloatArray]
) -> tuple[UnplacedHypothesis, ...]:
    """
    Return the hypotheses of a cover like `hypotheses_of`, their placements only when asked for.

    Parameters
    ----------
    problem : Problem
        The problem.
    boxes : list of ndarray, shape (4, n, n)
        The cover.

    Returns
    -------
    tuple of UnplacedHypothesis
        One for each connected component.

    """
    return tuple(
        UnplacedHypothesis(problem, hull, [boxes[index] for index in indices])
        for hull, indices in hulls_of(boxes)
    )
