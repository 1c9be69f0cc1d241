# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of elevations: stated ones, and those that are read."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from dg_localization.fleet import ElevationErrorModel, LinkKind
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.ros.interface.links import STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.links import stamp_offset_spec
from dg_localization.ros.interface.parameters.spec import (
    DOUBLE,
    DOUBLES,
    STRING,
    STRINGS,
    Section,
    Spec,
    WrongParameterError,
    by_parameters,
)

ELEVATIONS = Section(
    'Elevations',
    'With `dimension: 2`, points may be at different elevations: ranges and rays in space become '
    'those between the projections of their ends on the plane. An elevation that changes may be '
    'read, in messages of type geometry_msgs/PointStamped whose z is up. The error of a reading '
    'is the reading minus the true elevation.',
    (
        Spec(
            'elevations.names',
            STRINGS,
            [],
            'points in the plane whose elevation is known: robots, anchors and sensors',
            details='A sensor that is not named has the elevation of its robot, and all else is '
            'at 0. The sensor robot_1/left is given as robot_1.left.',
            examples=(
                "names: ['robot_1', 'beacon_1']",
                'robot_1: [0.4, 0.5]',
                'beacon_1: [2.1, 2.1]',
            ),
        ),
        Spec(
            'elevation.topic',
            STRING,
            '',
            "template of the topics, such as '{observer}/elevation'; empty for none",
            details='Readings narrow the elevation of a point that is named in '
            '`elevations.names`.',
        ),
        stamp_offset_spec(LinkKind.ELEVATION),
        Spec('elevation.min_error', DOUBLE, -0.5, 'least error of a reading', 'm'),
        Spec('elevation.max_error', DOUBLE, 0.5, 'greatest error of a reading', 'm'),
    ),
)


def elevation_spec(name: str) -> Spec:
    """Return the parameter of the elevation of one point."""
    return Spec(
        f'elevations.{name.replace("/", ".")}',
        DOUBLES,
        [],
        'least and greatest elevation',
        'm',
        -FARTHEST_M,
        FARTHEST_M,
    )


def specs_of_elevations(values: Mapping[str, Any]) -> Iterator[Spec]:
    """Yield the parameters of the elevations that are named."""
    yield from (elevation_spec(name) for name in values['elevations.names'])


def elevations_from(values: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Return the bounds of each elevation; topics of readings without any are refused."""
    if values['elevation.topic'] and not values['elevations.names']:
        raise WrongParameterError(
            f"parameter 'elevation.topic': '{values['elevation.topic']}' is not allowed without "
            "'elevations.names': readings narrow the least and the greatest elevation of a point "
            '(dimension: 2)'
        )
    return {
        name: tuple(values[f'elevations.{name.replace("/", ".")}'])
        for name in values['elevations.names']
    }


def elevation_error_from(values: Mapping[str, Any], **overrides: float) -> ElevationErrorModel:
    """Return the bounds of elevations that are read, some of them overridden by name."""
    least, greatest = (
        overrides.get(name, values[f'elevation.{name}']) for name in ('min_error', 'max_error')
    )
    return ElevationErrorModel(least, greatest)


def elevation_errors_from(
    links: Iterable[Link], values: Mapping[str, Any]
) -> dict[str, ElevationErrorModel]:
    """Return the bounds of the points that links read; the widest where a point has several."""
    errors: dict[str, ElevationErrorModel] = {}
    for link in links:
        point = link.key.observer
        if link.key.kind is not LinkKind.ELEVATION or point not in values['elevations.names']:
            continue
        bounds = {name: x for name, x in link.overrides.items() if name != STAMP_OFFSET}
        try:
            error = elevation_error_from(values, **bounds)
        except ValueError as wrong:
            raise WrongParameterError(
                f"parameter 'links': the bounds of '{link.topic}' are not allowed: "
                f'{by_parameters(str(wrong))}'
            ) from None
        before = errors.get(point, error)
        errors[point] = ElevationErrorModel(
            min(before.min_error_m, error.min_error_m),
            max(before.max_error_m, error.max_error_m),
        )
    return errors
