# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of points: anchors, sensors on robots, and elevations."""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

from dg_localization.fleet import Anchor, ElevationErrorModel, LinkKind, Mount
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.fleet.rotations import quaternion_of_euler
from dg_localization.ros.interface.links import STAMP_OFFSET, Link
from dg_localization.ros.interface.parameters.inputs import stamp_offset_spec
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


def mount_specs(name: str) -> tuple[Spec, ...]:
    """Return the parameters of one sensor, ``ROBOT/SENSOR``."""
    prefix = f'mounts.{name.replace("/", ".")}'
    return (
        Spec(
            f'{prefix}.position',
            DOUBLES,
            [],
            'place of the sensor in the body frame',
            'm',
            -FARTHEST_M,
            FARTHEST_M,
        ),
        Spec(f'{prefix}.bound', DOUBLE, 0.0, 'how far it may be from there', 'm', 0.0, FARTHEST_M),
        Spec(
            f'{prefix}.rotation',
            DOUBLES,
            [0.0, 0.0, 0.0],
            'orientation of the sensor in the body frame: roll, pitch and yaw about fixed axes',
            'rad',
        ),
    )


MOUNTS = Section(
    'Sensors on robots',
    'Sensors away from the origin of the body frame. The sensor `left` of `robot_1` is called '
    '`robot_1/left` wherever an observer or a target is named.',
    (
        Spec(
            'mounts.names',
            STRINGS,
            [],
            "sensors at known places on robots, 'ROBOT/SENSOR'",
            examples=(
                "names: ['robot_1/left', 'robot_1/camera']",
                'robot_1:',
                '  left: {position: [0.3, 0.2]}',
                '  camera: {position: [0.4, 0.0], bound: 0.01, rotation: [0.0, 0.0, 1.57]}',
            ),
        ),
    ),
)


def specs_of_mounts(values: Mapping[str, Any]) -> Iterator[Spec]:
    """Yield the parameters of the sensors that are named."""
    for name in values['mounts.names']:
        if len(name.split('/')) != 2:
            raise WrongParameterError(
                f"parameter 'mounts.names': '{name}' is not allowed, it must read 'ROBOT/SENSOR'"
            )
        yield from mount_specs(name)


def mounts_from(values: Mapping[str, Any]) -> dict[str, dict[str, Mount]]:
    """Return the sensors of each robot."""
    mounts: dict[str, dict[str, Mount]] = {}
    for full_name in values['mounts.names']:
        robot, name = full_name.split('/')
        prefix = f'mounts.{robot}.{name}'
        rotation_rad = values[f'{prefix}.rotation']
        if len(rotation_rad) != 3:
            raise WrongParameterError(
                f"parameter '{prefix}.rotation': {rotation_rad!r} is not allowed, it must be "
                'roll, pitch and yaw (rad)'
            )
        mounts.setdefault(robot, {})[name] = Mount(
            tuple(values[f'{prefix}.position']),
            values[f'{prefix}.bound'],
            quaternion_of_euler(*rotation_rad),
        )
    return mounts


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
