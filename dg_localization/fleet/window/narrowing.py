# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window leaves of the answer of the moment."""

from __future__ import annotations

from dataclasses import dataclass, replace

from dg_localization.fleet.answers import Answer
from dg_localization.fleet.estimate import Group
from dg_localization.fleet.frames.plan import Plans
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.recollection import Left, Recollection


@dataclass(frozen=True)
class NarrowedAnswer:
    """
    An answer after the window has been heard.

    Parameters
    ----------
    answer : Answer
    ruled_out : tuple of str
        A sentence on each placement that is left out.
    forgotten : tuple of Forgotten

    """

    answer: Answer
    ruled_out: tuple[str, ...]
    forgotten: tuple[Forgotten, ...]


def narrow_answer(found: Answer, plans: Plans, recalled: Recollection) -> NarrowedAnswer:
    """
    Return what a window leaves of an answer.

    Where it leaves no placement at all, it contradicts the moment: the answer stays as it is.
    """
    if recalled.empty:
        return NarrowedAnswer(found, (), recalled.forgotten)
    recalled.allowance.resume()
    main, groups = Left((), ()), []
    ruled_out: list[str] = []
    if plans.main is not None:
        main = recalled.narrow(found.placements, plans.main.frame)
        ruled_out += main.ruled_out
    contradicts = bool(found.placements) and not main.placements
    for group in found.groups:
        left = recalled.narrow(group.placements, group.frame)
        contradicts |= bool(group.placements) and not left.placements
        groups.append(_narrowed_group(group, left))
        ruled_out += left.ruled_out
    if contradicts and recalled.carried is not None:
        recalled.allowance.pause()
        return narrow_answer(found, plans, recalled.without_carried())
    if contradicts:
        return NarrowedAnswer(found, (), recalled.without_anything())
    answer = replace(
        found,
        placements=main.placements,
        n_hypotheses=found.n_hypotheses - len(main.ruled_out),
        groups=tuple(groups),
    )
    return NarrowedAnswer(answer, tuple(ruled_out), recalled.forgotten)


def _narrowed_group(group: Group, left: Left) -> Group:
    """Return a group with the placements that are left."""
    return replace(
        group,
        placements=left.placements,
        n_hypotheses=group.n_hypotheses - len(left.ruled_out),
    )
