# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The parameters of the node `localizer`, in the order of `config/localizer.yaml`.

That file is their documentation: each entry begins with the text and the limits of its row here,
which a test compares.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
import math
import re
from typing import Any

from dg_localization.fleet import OdometryErrorModel, SuspectKind
from dg_localization.fleet.checks import FARTHEST_M
from dg_localization.fleet.config import LEAST_MEMORY_S
from dg_localization.fleet.odometry_error import MOST_SCALE
from dg_localization.ros.interface.parameters.spec import Spec

LENGTH, TIME = partial(Spec, unit='m', at_least=0.0), partial(Spec, unit='s', at_least=0.0)
COUNT = partial(Spec, at_least=0)
NAMES = partial(Spec, [], list_of=str)
PLACE = partial(Spec, [], unit='m', at_least=-FARTHEST_M, at_most=FARTHEST_M, list_of=float)


def _topics(kind: str, template: str) -> dict[str, Spec]:
    """Return the parameters common to all kinds of inputs."""
    return {
        f'{kind}.topic': Spec(template, 'template of the topics; empty for none'),
        f'{kind}.stamp_offset': Spec(
            0.0, 'what is added to stamps, negative where they are late', 's'
        ),
    }


TABLE = {
    'robots': NAMES('names of the robots; their order is the order of all outputs'),
    'dimension': Spec(2, 'dimension of the space the robots move in', '', 2, 3),
    'fixed_frame': Spec('map', 'name of the frame of the anchors'),
    'reference_robot': Spec(
        '', 'robot that the frame is tied to when the anchors do not fix it; empty for the first'
    ),
    'rate': Spec(5.0, 'how often the fleet is localized', 'Hz', 0.01, 1000.0),
    'autostart': Spec(True, 'configure and activate at start'),
    'publish_tf': Spec(False, 'publish transforms from the frame of the anchors on /tf'),
    'localized_width': LENGTH(
        1.0, 'widest enclosure of a robot in a fleet that is called localized'
    ),
    'covariance': Spec(
        'estimate',
        'what the covariance of a pose is made from',
        choices=('estimate', 'enclosure'),
    ),
    'covariance_floor': LENGTH(
        0.05, "least standard deviation of a coordinate with covariance 'estimate'"
    ),
    'stamp_source': Spec(
        'header',
        'time of a measurement: its header, or its arrival',
        choices=('header', 'receive'),
    ),
    'max_age': TIME(1.0, 'older measurements are not used'),
    'stamp_error': TIME(0.0, 'how far a stamp may be from when it was true'),
    'max_future': TIME(0.1, 'how far a stamp may lie ahead of the clock'),
    'max_repeats': Spec(8, 'newest readings of one input that are kept and intersected', '', 1),
    'max_speed': Spec(1.0, 'no robot moves faster', 'm/s', 0.0),
    'max_turn_rate': Spec(1.0, 'no robot turns faster', 'rad/s', 0.0),
    'min_separation': LENGTH(0.0, 'no two robots come nearer than this'),
    **_topics('range', '{observer}/range/{target}'),
    'range.min_error': Spec(0.0, 'least error of a range', 'm'),
    'range.max_error': Spec(0.0, 'greatest error of a range', 'm'),
    'range.min_error_relative': Spec(-0.03, 'least error as a fraction of the reading'),
    'range.max_error_relative': Spec(0.03, 'greatest error as a fraction of the reading'),
    'range.sigma_factor': Spec(0.0, 'standard deviations added on both sides', '', 0.0),
    'range.beyond_max_is_far': Spec(
        False, 'whether +inf (REP-117) proves that the target is farther than max_range'
    ),
    'range.expected_error': Spec(
        math.nan, 'likeliest error, for the published point', 'm', may_be_nan=True
    ),
    'range.expected_error_relative': Spec(0.0, 'what is added to it as a fraction of the reading'),
    'range.min_reading': Spec(0.0, 'a reading of this or less is none', 'm'),
    'range.max_reading': Spec(math.inf, 'a reading of this or more is none', 'm', finite=False),
    'range_difference.min_error': Spec(-0.5, 'least error of a range difference', 'm'),
    'range_difference.max_error': Spec(0.5, 'greatest error of a range difference', 'm'),
    **_topics('bearing', '{observer}/bearing/{target}'),
    'bearing.half_width': Spec(
        0.05, 'greatest angle between a ray and the true direction', 'rad', 0.0, math.pi
    ),
    'bearing.expected_error': Spec(
        0.0, 'likeliest error about the vertical axis', 'rad', -math.pi, math.pi
    ),
    **_topics('odometry', '{robot}/odom'),
    'odometry.translation_scale': Spec(
        1.0, 'true distance traveled per reported one', '', 1.0 / MOST_SCALE, MOST_SCALE
    ),
    'odometry.translation_per_m': Spec(
        0.1, 'greatest error of the position per meter traveled', 'm/m', 0.0
    ),
    'odometry.translation_per_rad': Spec(
        0.0, 'greatest error of the position per radian turned', 'm/rad', 0.0
    ),
    'odometry.rotation_per_m': Spec(
        0.02, 'greatest error of the heading per meter traveled', 'rad/m', 0.0
    ),
    'odometry.rotation_per_rad': Spec(
        0.1, 'greatest error of the heading per radian turned', 'rad/rad', 0.0
    ),
    'odometry.constant_translation': LENGTH(
        0.02, 'greatest error of the position however short the way'
    ),
    'odometry.constant_rotation': Spec(
        0.02, 'greatest error of the heading however short the way', 'rad', 0.0
    ),
    'odometry.latency': TIME(0.0, 'how far the stamp of a pose may be from when it was true'),
    'odometry.max_gap': TIME(1.0, 'where stamps are farther apart, messages are taken to be lost'),
    'odometry.restart_gap': TIME(
        math.nan,
        'where stamps are farther apart, the odometry counts as started anew',
        may_be_nan=True,
    ),
    'odometry.tilt': Spec(
        math.nan, 'greatest angle of roll and pitch from the truth', 'rad', 0.0, may_be_nan=True
    ),
    'memory.seconds': Spec(
        30.0, 'how long measurements are remembered', 's', LEAST_MEMORY_S, may_be_zero=True
    ),
    'memory.max_seconds': TIME(0.15, 'longest processor time that an estimate spends on them'),
    'window_outliers': COUNT(0, 'how many observations of each pair may be wrong in the memory'),
    **_topics('peers', '{observer}/peers'),
    'links': NAMES("inputs one by one, 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'"),
    'ids': NAMES("names of the ids in messages of other packages, 'ID NAME'"),
    'adapter_modules': NAMES('Python modules that register adapters of message types'),
    'mounts.names': NAMES("sensors at known places on robots, 'ROBOT/SENSOR'"),
    'elevations.names': NAMES('points in the plane whose elevation is known'),
    **_topics('elevation', ''),
    'elevation.min_error': Spec(-0.5, 'least error of a reading', 'm'),
    'elevation.max_error': Spec(0.5, 'greatest error of a reading', 'm'),
    'anchors.names': NAMES('points whose coordinates are known'),
    'anchors.bound': LENGTH(
        0.0, 'how far an anchor may be from its coordinates', at_most=FARTHEST_M
    ),
    'max_outliers': COUNT(0, 'most contradicting observations that may be dropped'),
    'outlier_unit': Spec(
        'observation', 'what counts as one of `max_outliers`', choices=tuple(SuspectKind)
    ),
    'conflicts.max_solves': COUNT(200, 'most problems solved to explain one contradiction'),
    'conflicts.max_seconds': TIME(
        2.0, 'longest time of a search for what explains a contradiction', finite=False
    ),
    'stuck.readings': COUNT(20, 'how many identical readings show that a sensor is stuck'),
    'stuck.drop': Spec(False, 'drop readings that are stuck, besides the warning'),
    'max_hypotheses': Spec(64, 'most hypotheses that are published', '', 1),
    'solver.resolution': Spec(
        0.05, 'width of a distance that is not split further', 'm', 1e-06, 1000000.0
    ),
    'solver.max_boxes': Spec(2000, 'most boxes that one solve processes', '', 1),
    'solver.max_seconds': Spec(1.0, 'longest time of one solve', 's', 0.001, finite=False),
    'solver.tighten_seconds': TIME(
        0.1, 'time of one solve until which linear programs narrow its bounds', finite=False
    ),
}

# Parameters that define the fleet, its inputs and its outputs; others change while the node runs.
AT_CONFIGURE = {'robots', 'dimension', 'fixed_frame', 'reference_robot', 'links', 'ids'}
AT_CONFIGURE |= {'adapter_modules', 'autostart', 'publish_tf', 'stamp_source'}


def takes_effect_at_once(name: str) -> bool:
    """Return whether a change takes effect at once, not at the next configuration."""
    of_names = name.startswith(('anchors.', 'mounts.', 'elevation.', 'elevations.'))
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
    """Return the fields of a dataclass that have parameters, by name without the prefix."""
    found = {}
    for name, spec in TABLE.items():
        field = name.removeprefix(prefix).replace('.', '_')
        fields = OTHER_FIELDS.get(name, ''), field + SUFFIXES.get(spec.unit, ''), field
        known = [field for field in fields if field in settings.__dataclass_fields__]
        if known and name.startswith(prefix) and spec.list_of is None:
            found[name.removeprefix(prefix)] = known[0]
    return found


def own_of(name: str, whose: str) -> Spec:
    """Return the parameter of one robot or anchor that replaces the common parameter `name`."""
    text = f'the same of this {whose}; negative for {name}'
    return replace(TABLE[name], default=-1.0, description=text, may_be_negative=True)


# Parameters of single robots, sensors, anchors and other points, by names with placeholders.
OWN = {
    'robot_max_speed.NAME': own_of('max_speed', 'robot'),
    **{
        f'robot_odometry.NAME.{name}': own_of(f'odometry.{name}', 'robot')
        for name in fields_of(OdometryErrorModel, 'odometry.')
    },
    'mounts.ROBOT.SENSOR.position': PLACE('place of the sensor in the body frame'),
    'mounts.ROBOT.SENSOR.bound': LENGTH(0.0, 'how far it may be from there', at_most=FARTHEST_M),
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
    """Yield the parameters of single robots, anchors and sensors by name."""
    for name, spec in OWN.items():
        for point in values[POINTS[name.partition('.')[0]]]:
            yield re.sub('NAME|ROBOT.SENSOR', point.replace('/', '.'), name), spec
