# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of anchors."""

from collections.abc import Mapping
from typing import Any

from dg_localization.fleet import Anchor
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.ros.interface.parameters.spec import (
    DOUBLE,
    DOUBLES,
    STRINGS,
    Section,
    Spec,
    WrongParameterError,
)


def anchor_specs(name: str) -> tuple[Spec, Spec]:
    """Return the parameters of one anchor; a negative bound stands for `anchors.bound`."""
    return (
        Spec(
            f'anchors.{name}.position',
            DOUBLES,
            [],
            'coordinates in the fixed frame',
            'm',
            -FARTHEST_M,
            FARTHEST_M,
        ),
        Spec(
            f'anchors.{name}.bound',
            DOUBLE,
            -1.0,
            'how far it may be from there; negative for anchors.bound',
            'm',
            at_most=FARTHEST_M,
        ),
    )


ANCHORS = Section(
    'Anchors',
    'Points whose coordinates in the fixed frame are known: landmarks, or parked robots. Each '
    'name has a position, and a bound of its own where it needs one.',
    (
        Spec(
            'anchors.names',
            STRINGS,
            [],
            'points whose coordinates are known',
            examples=(
                "names: ['beacon_1', 'beacon_2']",
                'beacon_1: {position: [0.0, 0.0]}',
                'beacon_2: {position: [8.0, 0.0], bound: 0.2}',
            ),
        ),
        Spec(
            'anchors.bound',
            DOUBLE,
            0.0,
            'how far an anchor may be from its coordinates',
            'm',
            0.0,
            FARTHEST_M,
        ),
    ),
)


def anchors_from(values: Mapping[str, Any]) -> dict[str, Anchor]:
    """Return the anchors by name."""
    return {name: _anchor(name, values) for name in values['anchors.names']}


def _anchor(name: str, values: Mapping[str, Any]) -> Anchor:
    position, dimension = values[f'anchors.{name}.position'], values['dimension']
    if len(position) != dimension:
        raise WrongParameterError(
            f"parameter 'anchors.{name}.position': {position!r} is not allowed, it must have "
            f'{dimension} coordinates (dimension)'
        )
    bound = values[f'anchors.{name}.bound']
    return Anchor(
        coordinates_m=tuple(position),
        bound_m=bound if bound >= 0.0 else values['anchors.bound'],
    )
