# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Pieces that come apart once what hangs on them is taken off.

A part that two points hold joins what lies on either side of these, and so it hides the sets of
points that separate the rest. Each such set doubles the placements of the piece. Searched as a
whole, all its points are contracted for every one of them; solved in parts, they are combined.
"""

from __future__ import annotations

from collections.abc import Callable

from dg_localization.interval.kernels import until
from dg_localization.solver.assemble.coincident import pieces_of_problem
from dg_localization.solver.decompose.decomposition import Decomposition
from dg_localization.solver.decompose.joints import JointKind
from dg_localization.solver.problem import Problem

LEAST_PARTED, MOST_PARTED = 9, 60
"""Fewer points are searched as a whole in less time; more are solved in patches."""


def hidden_parts(problem: Problem, stopped: Callable[[], bool]) -> Decomposition | None:
    """Return the parts of a piece, None where it has one part only or the time is over."""
    if not LEAST_PARTED <= problem.n_points <= MOST_PARTED:
        return None
    parts = None
    with until(stopped):
        parts = pieces_of_problem(problem)
    if parts is None or len(parts.pieces) == 1:
        return None
    if any(joint.kind is not JointKind.REFLECTION for joint in parts.joints):
        return None
    return parts
