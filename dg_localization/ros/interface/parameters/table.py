# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the node `localizer`, in the order of the commented file."""

from collections.abc import Iterable, Iterator
import math

from dg_localization.fleet import LinkKind
from dg_localization.ros.interface.parameters.inputs import LINKS, stamp_offset_spec
from dg_localization.ros.interface.parameters.odometry import (
    MEMORY,
    ODOMETRY,
    robot_odometry_specs,
)
from dg_localization.ros.interface.parameters.points import (
    ANCHORS,
    ELEVATIONS,
    MOUNTS,
    anchor_specs,
)
from dg_localization.ros.interface.parameters.results import ANSWERS, CONTRADICTIONS, SOLVER
from dg_localization.ros.interface.parameters.spec import (
    BOOL,
    DOUBLE,
    INTEGER,
    STRING,
    STRINGS,
    Section,
    Spec,
)

FLEET = Section(
    'Fleet',
    '',
    (
        Spec(
            'robots',
            STRINGS,
            [],
            'names of the robots; their order is the order of all outputs',
            details='At least one must be named.',
            shown=['robot_1', 'robot_2', 'robot_3'],
        ),
        Spec(
            'dimension',
            INTEGER,
            2,
            'dimension of the space the robots move in',
            at_least=2,
            at_most=3,
        ),
        Spec(
            'fixed_frame',
            STRING,
            'map',
            'name of the frame of the anchors',
            details='Without anchors the frame is named after what it is tied to: the odometry '
            'frame of the reference robot as its messages name it, `ROBOT/base_link`, or `fleet`.',
        ),
        Spec(
            'reference_robot',
            STRING,
            '',
            'robot that the frame is tied to when the anchors do not fix it; empty for the first',
            details='In its odometry frame it is at its odometry pose. In other frames it is at '
            'the origin, and the x axis is its heading when its bearings fix that, else it points '
            'towards the next robot of the list.',
        ),
    ),
)

NODE = Section(
    'Node',
    '',
    (
        Spec('rate', DOUBLE, 5.0, 'how often the fleet is localized', 'Hz', 0.01, 1000.0),
        Spec(
            'autostart',
            BOOL,
            True,
            'configure and activate at start',
            details='Set it to false under a lifecycle manager.',
        ),
        Spec(
            'publish_tf',
            BOOL,
            False,
            'publish transforms from the frame of the anchors on /tf',
            details='They go to the odometry frame of each robot that has odometry, and to the '
            'body of others. It needs the package tf2_msgs.',
        ),
    ),
)

TIME = Section(
    'Time',
    '',
    (
        Spec(
            'stamp_source',
            STRING,
            'header',
            'time of a measurement: its header, or its arrival',
            choices=('header', 'receive'),
            details="'receive' serves drivers that leave the header empty or run on another "
            'clock.',
        ),
        Spec('max_age', DOUBLE, 1.0, 'older measurements are not used', 's', 0.0),
        Spec(
            'stamp_error',
            DOUBLE,
            0.0,
            'how far a stamp may be from when it was true, by the clock of the node',
            's',
            0.0,
            details='Clocks of robots differ. What robots can move and turn meanwhile widens all '
            'bounds. Where a clock may be ahead, `max_future` must not be less.',
        ),
        Spec('max_future', DOUBLE, 0.1, 'how far a stamp may lie ahead of the clock', 's', 0.0),
        Spec(
            'max_repeats',
            INTEGER,
            8,
            'newest readings of one input that are kept and intersected',
            at_least=1,
        ),
    ),
)


def robot_spec(name: str) -> Spec:
    """Return the speed limit of one robot; a negative one stands for `max_speed`."""
    return Spec(
        f'robot_max_speed.{name}',
        DOUBLE,
        -1.0,
        'this robot moves no faster; negative for max_speed',
        'm/s',
    )


MOTION = Section(
    'Motion',
    'A measurement of age dt is widened by how far the robots can have moved in dt.',
    (
        Spec(
            'max_speed',
            DOUBLE,
            1.0,
            'no robot moves faster',
            'm/s',
            0.0,
            details='A robot may have a limit of its own, robot_max_speed.NAME.',
            examples=('robot_max_speed: {robot_3: 0.3}',),
        ),
        Spec(
            'max_turn_rate',
            DOUBLE,
            1.0,
            'no robot turns faster',
            'rad/s',
            0.0,
            details='In the plane this bounds the heading, with `dimension: 3` the whole '
            'rotation: roll and pitch count too.',
        ),
        Spec(
            'min_separation',
            DOUBLE,
            0.0,
            'no two robots come nearer than this',
            'm',
            0.0,
            details='The size of a robot, for example. Moving robots that are only seen, never '
            'ranged, need it: at very short distance a direction can change arbitrarily fast.',
        ),
    ),
)

RANGES = Section(
    'Ranges',
    'Messages of type sensor_msgs/Range. The error of a reading r is r minus the true distance. '
    'It lies between min_error + min_error_relative * r and max_error + max_error_relative * r, '
    'widened on both sides by sigma_factor standard deviations when the message carries a '
    'variance.',
    (
        Spec(
            'range.topic',
            STRING,
            '{observer}/range/{target}',
            'template of the topics; empty for none',
            details='It is resolved like the name of a topic: without a leading slash it is in '
            'the namespace of the node. Ranges may also be named one by one under links.',
        ),
        stamp_offset_spec(LinkKind.RANGE),
        Spec('range.min_error', DOUBLE, 0.0, 'least error of a range', 'm'),
        Spec(
            'range.max_error',
            DOUBLE,
            0.0,
            'greatest error of a range',
            'm',
            details='Ultra-wideband reads too long, rarely too short: 0.4 to 1.3 m is common.',
        ),
        Spec(
            'range.min_error_relative',
            DOUBLE,
            -0.03,
            'least error as a fraction of the reading',
        ),
        Spec(
            'range.max_error_relative',
            DOUBLE,
            0.03,
            'greatest error as a fraction of the reading, below 1',
        ),
        Spec(
            'range.sigma_factor',
            DOUBLE,
            0.0,
            'standard deviations (of Range.variance) added on both sides; 0 ignores the variance',
            at_least=0.0,
        ),
        Spec(
            'range.beyond_max_is_far',
            BOOL,
            False,
            'whether +inf (REP-117) proves that the target is farther than max_range',
            details='It does not where readings simply get lost.',
        ),
        Spec(
            'range.expected_error',
            DOUBLE,
            math.nan,
            'likeliest error, for the published point',
            'm',
            may_be_nan=True,
            details='Where it is not known, .nan, it is the mean of two errors: the one nearest '
            'to zero that the bounds allow, and the middle of the bounds.',
        ),
        Spec(
            'range.expected_error_relative',
            DOUBLE,
            0.0,
            'what is added to it as a fraction of the reading',
            details='Some radios read a few percent too long.',
        ),
        Spec(
            'range.min_reading',
            DOUBLE,
            0.0,
            'a reading of this or less is none',
            'm',
            details='By default 0.0 is none; a negative number takes it for a distance.',
        ),
        Spec(
            'range.max_reading',
            DOUBLE,
            math.inf,
            'a reading of this or more is none',
            'm',
            finite=False,
            details='Many radios report the largest number that they have, such as 65.535, where '
            'nothing was measured.',
        ),
    ),
)

BEARINGS = Section(
    'Bearings',
    'Messages of type geometry_msgs/Vector3Stamped: a ray of any length in the body frame of the '
    'observer, x forward, y left, z up.',
    (
        Spec(
            'bearing.topic',
            STRING,
            '{observer}/bearing/{target}',
            'template of the topics; empty for none',
        ),
        stamp_offset_spec(LinkKind.BEARING),
        Spec(
            'bearing.half_width',
            DOUBLE,
            0.05,
            'greatest angle between a ray and the true direction',
            'rad',
            0.0,
            math.pi,
        ),
        Spec(
            'bearing.expected_error',
            DOUBLE,
            0.0,
            'likeliest error about the vertical axis, counterclockwise, for the published point',
            'rad',
            -math.pi,
            math.pi,
        ),
    ),
)

PEERS = Section(
    'Peers',
    'All that one robot measures in one message of type sensor_msgs/PointCloud2, for fleets of so '
    'many pairs that a topic for each costs too much. A point stands for one robot or anchor that '
    'was measured. Its fields are `peer`, an integer: zero-based index into the list of robots '
    'followed by the anchors not in robots and the sensors on robots; `range` (m); and `x`, `y`, '
    '`z`, the ray in the body frame. Range or ray may be missing, or NaN.',
    (
        Spec('peers.topic', STRING, '{observer}/peers', 'template of the topics; empty for none'),
        stamp_offset_spec(LinkKind.PEERS),
    ),
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

# What makes the fleet, its inputs and its outputs; the rest changes while the node runs.
OF_FLEET = (FLEET, PEERS, LINKS, MOUNTS, ELEVATIONS, ANCHORS)
AT_CONFIGURE = {spec.name for section in OF_FLEET for spec in section.specs}
AT_CONFIGURE |= {'autostart', 'publish_tf', 'stamp_source'}


def takes_effect_at_once(name: str) -> bool:
    """Return whether a change counts at once, not when the node is configured next."""
    of_names = name.startswith(('anchors.', 'mounts.', 'elevations.'))
    return not (of_names or name in AT_CONFIGURE or name.endswith(('.topic', '.stamp_offset')))


TABLE = tuple(spec for section in SECTIONS for spec in section.specs)


def named_specs(robots: Iterable[str], anchors: Iterable[str]) -> Iterator[Spec]:
    """Yield the parameters that each robot and each anchor has of its own."""
    for name in robots:
        yield robot_spec(name)
        yield from robot_odometry_specs(name)
    for name in anchors:
        yield from anchor_specs(name)
