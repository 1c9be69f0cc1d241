# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Mirror images: which of the two a hypothesis may be, and how one of them is chosen."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.frames.local import best_apexes
from dg_localization.solver.decompose.decomposition import pieces_of
from dg_localization.solver.decompose.joints import JointKind
from dg_localization.solver.result import Hypothesis


@dataclass(frozen=True)
class ChiralityChoice:
    """
    One of two mirror images: the sign of the chirality of a core and one more point.

    Parameters
    ----------
    core : tuple of int
        q points.
    apex : int
    sign : {1, -1}
        That of the last coordinate of `apex` in the frame of the core.

    """

    core: tuple[int, ...]
    apex: int
    sign: int


def rigid_with(core: tuple[int, ...], solved: Constraints) -> frozenset[int]:
    """
    Return the points that have a chirality with a core: those that cannot turn against it.

    Parameters
    ----------
    core : tuple of int
        q points.
    solved : Constraints
        Of the points that the solver places.

    Returns
    -------
    frozenset of int
        The points of all pieces that reflections join to the piece of the core, without the core;
        none where the core is not in one piece.

    """
    measured = np.argwhere(np.triu(np.isfinite(solved.upper), 1))
    parts = pieces_of(len(solved.upper), measured, solved.dimension)
    clusters = [set(points) for points in parts.pieces]
    for joint in parts.joints:
        if joint.kind is JointKind.REFLECTION:
            joined = set.union(*(clusters[number] for number in joint.pieces))
            clusters = [joined if cluster & joined == cluster else cluster for cluster in clusters]
    for cluster in clusters:
        if cluster.issuperset(core):
            return frozenset(cluster - set(core))
    return frozenset()


def possible_choices(
    hypothesis: Hypothesis, solved: Constraints, core: tuple[int, ...], rigid: frozenset[int]
) -> list[ChiralityChoice | None]:
    """
    Return the mirror images that the known chiralities allow.

    Parameters
    ----------
    hypothesis : Hypothesis
    solved : Constraints
        Of the points of the hypothesis.
    core : tuple of int
        At most q of them.
    rigid : frozenset of int
        The points that have a chirality with the core.

    Returns
    -------
    list of ChiralityChoice or None
        One when a chirality decides it, else both; a single None when every point can turn into
        its mirror image or lies in the hyperplane of the core, so that there is nothing to choose.

    """
    if len(core) < solved.dimension:
        return [None]
    known = {}
    for chirality in solved.chiralities:
        apexes = set(chirality.points) - set(core)
        if len(apexes) == 1 and set(core) < set(chirality.points):
            apex = apexes.pop()
            known[apex] = chirality.sign_of((*core, apex))
    if not (known or rigid):
        return [None]
    apex = best_apexes(hypothesis, core, list(known) or sorted(rigid))[0]
    signs = [known[apex]] if known else [1, -1]
    return [ChiralityChoice(core, apex, sign) for sign in signs]
