# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What of a window contradicts itself, or what is measured now, and is forgotten therefore."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
import math

from dg_localization.fleet.window.memory import Ends


@dataclass(frozen=True)
class Forgotten:
    """
    Observations that are not used any more.

    Parameters
    ----------
    ends : frozenset of (str, str)
        The points that observed each other, in either order.
    before_s : float
        Observations up to this time are forgotten.
    text : str
        Why.

    """

    ends: frozenset[Ends]
    before_s: float
    text: str


def also_forgotten(known: Mapping[Ends, float], more: Iterable[Forgotten]) -> Mapping[Ends, float]:
    """Return up to when observations between two points are forgotten, with some more of them."""
    stamps = dict(known)
    for forgotten in more:
        for ends in forgotten.ends:
            stamps[ends] = max(stamps.get(ends, -math.inf), forgotten.before_s)
    return stamps
