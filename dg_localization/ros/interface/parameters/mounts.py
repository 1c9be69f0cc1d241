# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of sensors at known places on robots."""

from collections.abc import Iterator, Mapping
from typing import Any

from dg_localization.fleet import Mount
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.fleet.rotations import quaternion_of_euler
from dg_localization.ros.interface.parameters.spec import (
    DOUBLE,
    DOUBLES,
    STRINGS,
    Section,
    Spec,
    WrongParameterError,
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
