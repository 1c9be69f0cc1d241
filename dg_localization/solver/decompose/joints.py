# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What rigid pieces share, and what that leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class JointKind(Enum):
    """What two pieces can still do to each other."""

    HINGE = 'hinge'
    """They share q - 1 points and turn: about a point in the plane, about a line in space."""

    REFLECTION = 'reflection'
    """They share q points; either side may be mirrored in the hyperplane through them."""

    LOOSE = 'loose'
    """They share fewer points: one, in space."""


@dataclass(frozen=True)
class Joint:
    """
    What pieces share.

    Attributes
    ----------
    pieces : tuple of int
        Two or more pieces, by their numbers in the order of the pieces.
    points : tuple of int
        The points that all of them share, ascending.
    kind : JointKind
        What the joint leaves open.

    """

    pieces: tuple[int, ...]
    points: tuple[int, ...]
    kind: JointKind
