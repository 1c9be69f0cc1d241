# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What a window leaves of some placements, mirror images together, and what ruled the rest out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
import math

import numpy as np

from dg_localization.fleet.estimate import Placement


@dataclass(frozen=True)
class Left:
    """
    The placements that a window leaves of some.

    Parameters
    ----------
    placements : tuple of Placement
    ruled_out : tuple of str
        A sentence on each placement that is impossible.

    """

    placements: tuple[Placement, ...]
    ruled_out: tuple[str, ...]


def sifted(
    placements: Sequence[Placement], sift: Callable[[Placement], tuple[Placement | None, str]]
) -> Left:
    """
    Return what is left of placements, those that are impossible left out.

    Those whose headings are known least come first, each with all the time that is left: a part
    of it would not do for any. Where time is short the others have their turn at the next
    estimate, which knows of these then.

    Parameters
    ----------
    placements : sequence of Placement
    sift : callable
        Returns what is left of a placement, or what ruled it out.

    Returns
    -------
    Left

    """
    unknown_rad = [
        np.minimum(placement.heading_half_width_rad, math.pi).sum() for placement in placements
    ]
    order = np.argsort(-np.array(unknown_rad), kind='stable')
    found = {int(number): sift(placements[number]) for number in order}
    left: list[Placement] = []
    ruled_out: list[str] = []
    lone = True
    for number, placement in enumerate(placements):
        narrowed, cause = found[number]
        image = placement.mirrored or any(p.mirrored for p in placements[number + 1 :][:1])
        if narrowed is not None:
            left.append(replace(narrowed, mirrored=placement.mirrored and not lone))
        else:
            ruled_out.append(f'{"mirror image" if image else "hypothesis"} ruled out by {cause}')
        lone = narrowed is None
    return Left(tuple(left), tuple(ruled_out))


def parted(
    placements: Sequence[Placement], most: int
) -> tuple[Sequence[Placement], Sequence[Placement]]:
    """Return the first `most` placements and the others; a mirror image stays with its image."""
    if len(placements) > most and placements[most].mirrored:
        most -= 1
    return placements[:most], placements[most:]
