# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window leaves of the answer of the moment, and what that proves of later ones."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

from dg_localization.fleet.answers import Answer
from dg_localization.fleet.estimate import FixedFrame, Group, Placement
from dg_localization.fleet.frames.finders import FittedPlacement
from dg_localization.fleet.frames.plan import FramePlan, Plans
from dg_localization.fleet.window.forgetting import Forgotten
from dg_localization.fleet.window.meeting import join_meeting
from dg_localization.fleet.window.proved import Proved
from dg_localization.fleet.window.recollection import Recollection
from dg_localization.fleet.window.sifting import Left

Refit = Callable[[FramePlan, Placement], FittedPlacement]

MOST_REFITTED = 4
"""More placements than these stay as they are: none of them is the answer yet."""


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
    proved : tuple of Proved
        What it proves of later ones, the oldest chain first.

    """

    answer: Answer
    ruled_out: tuple[str, ...]
    forgotten: tuple[Forgotten, ...]
    proved: tuple[Proved, ...] = ()


def narrow_answer(
    found: Answer, plans: Plans, recalled: Recollection, refit: Refit
) -> NarrowedAnswer:
    """
    Return what a window leaves of an answer.

    `refit` finds best points by the headings that the window tells. Where the window leaves no
    placement at all, it contradicts the moment: the answer stays as it is. The same holds where
    none is left of those listed, and there are others: that is no contradiction.
    """
    if recalled.empty:
        return NarrowedAnswer(found, (), recalled.forgotten)
    recalled.allowance.resume()
    main = Left((), ())
    if plans.main is not None:
        main = recalled.narrow(found.placements, plans.main.frame)
    of_groups = [recalled.narrow(group.placements, group.frame) for group in found.groups]
    parts: list[tuple[Answer | Group, Left]] = [
        (found, main),
        *zip(found.groups, of_groups, strict=True),
    ]
    emptied = [part for part, left in parts if part.placements and not left.placements]
    if any(len(part.placements) < part.n_hypotheses for part in emptied):
        return NarrowedAnswer(found, (), recalled.forgotten)
    if emptied and any(recalled.chains):
        recalled.allowance.pause()
        return narrow_answer(found, plans, recalled.without_chains(), refit)
    if emptied:
        return NarrowedAnswer(found, (), recalled.without_anything())
    proved: tuple[Proved, ...] = ()
    placements = main.placements
    if plans.main is not None:
        proved = tuple(_what_is_proved(found, plans.main.frame, recalled, main))
        placements = _hypotheses(main, plans.main, recalled, refit)
    answer = replace(
        found,
        placements=placements,
        n_hypotheses=found.n_hypotheses - len(found.placements) + len(placements),
        groups=tuple(
            _narrowed_group(group, _hypotheses(left, plan, recalled, refit))
            for group, left, plan in zip(found.groups, of_groups, plans.others, strict=True)
        ),
    )
    ruled_out = tuple(text for _, left in parts for text in left.ruled_out)
    return NarrowedAnswer(answer, ruled_out, recalled.forgotten, proved)


def _hypotheses(
    left: Left, plan: FramePlan, recalled: Recollection, refit: Refit
) -> tuple[Placement, ...]:
    """Return the placements that are left; in the plane with new best points, and joined."""
    if recalled.config.dimension != 2:
        return left.placements
    if len(left.placements) > MOST_REFITTED:
        return left.placements
    return join_meeting([refit(plan, placement) for placement in left.placements])


def _narrowed_group(group: Group, placements: tuple[Placement, ...]) -> Group:
    """Return a group with the placements that are left."""
    return replace(
        group,
        placements=placements,
        n_hypotheses=group.n_hypotheses - len(group.placements) + len(placements),
    )


def _what_is_proved(
    found: Answer, frame: FixedFrame, recalled: Recollection, oldest: Left
) -> Iterator[Proved]:
    """
    Yield what an answer proves of later ones.

    Nothing where measurements contradict, or where it rests on all of the memory: later ones may
    not rest on what is older.

    Parameters
    ----------
    found : Answer
        Of the moment.
    frame : FixedFrame
        Of its coordinates.
    recalled : Recollection
    oldest : Left
        What the window and the oldest chain leave of it.

    """
    listed = found.placements
    complete = len(listed) == found.n_hypotheses and not any(p.dropped for p in listed)
    if not complete or recalled.forgotten or recalled.config.dimension != 2:
        return
    if recalled.pose_sets.of_whole_memory:
        return
    for chain, carried in enumerate(recalled.chains):
        left = recalled.narrow(listed, frame, chain) if chain else oldest
        if left.placements:
            since_s = recalled.stamp_s if carried is None else carried.since_s
            yield Proved(left.placements, frame, recalled.stamp_s, since_s)
