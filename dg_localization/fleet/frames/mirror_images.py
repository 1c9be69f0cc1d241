"""Mirror images: which of the two a hypothesis may be, and how one of them is chosen."""

from __future__ import annotations

from dataclasses import dataclass

from dg_localization.fleet.constraints.constrain import Constraints
from dg_localization.fleet.frames.local import best_apexes
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


def possible_choices(
    hypothesis: Hypothesis, solved: Constraints, core: tuple[int, ...]
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

    Returns
    -------
    list of ChiralityChoice or None
        One when a chirality decides it, else both; a single None when the points lie in the
        hyperplane of the core, so that there is nothing to choose.

    """
    others = [point for point in range(len(solved.points)) if point not in core]
    if len(core) < solved.dimension or not others:
        return [None]
    known = {}
    for chirality in solved.chiralities:
        apexes = set(chirality.points) - set(core)
        if len(apexes) == 1 and set(core) < set(chirality.points):
            apex = apexes.pop()
            known[apex] = chirality.sign_of((*core, apex))
    apex = best_apexes(hypothesis, core, list(known) or others)[0]
    signs = [known[apex]] if known else [1, -1]
    return [ChiralityChoice(core, apex, sign) for sign in signs]
