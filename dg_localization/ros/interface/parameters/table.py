# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the node `localizer`, in the order of the commented file."""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
import re
from typing import Any

from dg_localization.fleet import OdometryErrorModel
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.ros.interface.parameters.measured import (
    BEARINGS,
    LINKS,
    MOTION,
    ODOMETRY,
    PEERS,
    RANGES,
    STAMP_OFFSET,
    TIME,
)
from dg_localization.ros.interface.parameters.results import (
    ANSWERS,
    CONTRADICTIONS,
    FLEET,
    MEMORY,
    NODE,
    SOLVER,
)
from dg_localization.ros.interface.parameters.spec import Section, Spec

MOUNTS = Section(
    'Sensors on robots',
    'Sensors away from the origin of the body frame. The sensor `left` of `robot_1` is '
    'called `robot_1/left` wherever an observer or a target is named.',
    {
        'mounts.names': Spec(
            [],
            "sensors at known places on robots, 'ROBOT/SENSOR'",
            list_of=str,
            examples=(
                "names: ['robot_1/left', 'robot_1/camera']",
                'robot_1:',
                '  left: {position: [0.3, 0.2]}',
                '  camera: {position: [0.4, 0.0], bound: 0.01, rotation: [0.0, 0.0, 1.57]}',
            ),
        )
    },
)


ELEVATIONS = Section(
    'Elevations',
    'With `dimension: 2`, points may be at different elevations: ranges and rays in space '
    'become those between the projections of their ends on the plane. An elevation that '
    'changes may be read, in messages of type geometry_msgs/PointStamped whose z is up. '
    'The error of a reading is the reading minus the true elevation.',
    {
        'elevations.names': Spec(
            [],
            'points in the plane whose elevation is known: robots, anchors and sensors. A '
            'sensor that is not named has the elevation of its robot, and all else is at 0. '
            'The sensor robot_1/left is given as robot_1.left.',
            list_of=str,
            examples=(
                "names: ['robot_1', 'beacon_1']",
                'robot_1: [0.4, 0.5]',
                'beacon_1: [2.1, 2.1]',
            ),
        ),
        'elevation.topic': Spec(
            '',
            "template of the topics, such as '{observer}/elevation'; empty for none. Readings "
            'narrow the elevation of a point that is named in `elevations.names`.',
        ),
        'elevation.stamp_offset': STAMP_OFFSET,
        'elevation.min_error': Spec(-0.5, 'least error of a reading', 'm'),
        'elevation.max_error': Spec(0.5, 'greatest error of a reading', 'm'),
    },
)


ANCHORS = Section(
    'Anchors',
    'Points whose coordinates in the fixed frame are known: landmarks, or parked robots. '
    'Each name has a position, and a bound of its own where it needs one.',
    {
        'anchors.names': Spec(
            [],
            'points whose coordinates are known',
            list_of=str,
            examples=(
                "names: ['beacon_1', 'beacon_2']",
                'beacon_1: {position: [0.0, 0.0]}',
                'beacon_2: {position: [8.0, 0.0], bound: 0.2}',
            ),
        ),
        'anchors.bound': Spec(
            0.0, 'how far an anchor may be from its coordinates', 'm', 0.0, FARTHEST_M
        ),
    },
)

SECTIONS = (
    FLEET,
    NODE,
    ANSWERS,
    TIME,
    MOTION,
    RANGES,
    BEARINGS,
    ODOMETRY,
    MEMORY,
    PEERS,
    LINKS,
    MOUNTS,
    ELEVATIONS,
    ANCHORS,
    CONTRADICTIONS,
    SOLVER,
)
TABLE = {name: spec for section in SECTIONS for name, spec in section.specs.items()}

# What makes the fleet, its inputs and its outputs; the rest changes while the node runs.
OF_FLEET = (FLEET, PEERS, LINKS, MOUNTS, ELEVATIONS, ANCHORS)
AT_CONFIGURE = {name for section in OF_FLEET for name in section.specs}
AT_CONFIGURE |= {'autostart', 'publish_tf', 'stamp_source'}


def takes_effect_at_once(name: str) -> bool:
    """Return whether a change counts at once, not when the node is configured next."""
    of_names = name.startswith(('anchors.', 'mounts.', 'elevations.'))
    return not (of_names or name in AT_CONFIGURE or name.endswith(('.topic', '.stamp_offset')))


SUFFIXES = {'m': '_m', 's': '_s', 'rad': '_rad', 'm/s': '_m_s', 'rad/s': '_rad_s', 'Hz': '_hz'}
OTHER_FIELDS = {
    'memory.seconds': 'memory_s',
    'stuck.drop': 'drop_stuck',
    'conflicts.max_solves': 'max_conflict_solves',
    'conflicts.max_seconds': 'max_conflict_seconds',
    'odometry.constant_translation': 'constant_m',
    'odometry.constant_rotation': 'constant_rad',
}


def fields_of(settings: Any, prefix: str = '') -> dict[str, str]:
    """Return the fields of a dataclass that parameters state, by their names without a prefix."""
    found = {}
    for name, spec in TABLE.items():
        field = name.removeprefix(prefix).replace('.', '_')
        fields = OTHER_FIELDS.get(name, ''), field + SUFFIXES.get(spec.unit, ''), field
        known = [field for field in fields if field in settings.__dataclass_fields__]
        if known and name.startswith(prefix) and spec.list_of is None:
            found[name.removeprefix(prefix)] = known[0]
    return found


def own_of(name: str, whose: str) -> Spec:
    """Return what one robot or anchor has in place of the common parameter `name`."""
    text = f'the same of this {whose}; negative for {name}'
    return replace(TABLE[name], default=-1.0, text=text, may_be_negative=True, examples=())


PLACE = partial(Spec, [], unit='m', at_least=-FARTHEST_M, at_most=FARTHEST_M, list_of=float)
# What robots, sensors, anchors and other points have of their own, by names with placeholders.
OWN = {
    'robot_max_speed.NAME': own_of('max_speed', 'robot'),
    **{
        f'robot_odometry.NAME.{name}': own_of(f'odometry.{name}', 'robot')
        for name in fields_of(OdometryErrorModel, 'odometry.')
    },
    'mounts.ROBOT.SENSOR.position': PLACE('place of the sensor in the body frame'),
    'mounts.ROBOT.SENSOR.bound': Spec(0.0, 'how far it may be from there', 'm', 0.0, FARTHEST_M),
    'mounts.ROBOT.SENSOR.rotation': Spec(
        [0.0, 0.0, 0.0],
        'orientation of the sensor in the body frame: roll, pitch, yaw about fixed axes',
        'rad',
        list_of=float,
    ),
    'elevations.NAME': PLACE('least and greatest elevation'),
    'anchors.NAME.position': PLACE('coordinates in the fixed frame'),
    'anchors.NAME.bound': own_of('anchors.bound', 'anchor'),
}
# The parameter that lists these points, by the first word of the names.
POINTS = {'robot_max_speed': 'robots', 'robot_odometry': 'robots'}
POINTS |= {name: f'{name}.names' for name in ('mounts', 'elevations', 'anchors')}


def named_specs(values: Mapping[str, Any]) -> Iterator[tuple[str, Spec]]:
    """Yield the parameters that robots, anchors and sensors have of their own, by name."""
    for name, spec in OWN.items():
        for point in values[POINTS[name.partition('.')[0]]]:
            yield re.sub('NAME|ROBOT.SENSOR', point.replace('/', '.'), name), spec
