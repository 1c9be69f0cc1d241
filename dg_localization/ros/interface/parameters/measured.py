# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rows of the table of parameters: what is measured, by whom, and how wrong it may be."""

import math

from dg_localization.fleet.odometry_error import LEAST_SCALE, MOST_SCALE
from dg_localization.ros.interface.parameters.spec import Section, Spec

STAMP_OFFSET = Spec(
    0.0,
    'what is added to stamps, negative where they are late. A link may have a `stamp_offset` of '
    'its own.',
    's',
)

TIME = Section(
    'Time',
    '',
    {
        'stamp_source': Spec(
            'header',
            "time of a measurement: its header, or its arrival. 'receive' serves drivers that "
            'leave the header empty or run on another clock.',
            choices=('header', 'receive'),
        ),
        'max_age': Spec(1.0, 'older measurements are not used', 's', 0.0),
        'stamp_error': Spec(
            0.0,
            'how far a stamp may be from when it was true, by the clock of the node. It widens '
            'all bounds. Where a clock may be ahead, `max_future` must not be less.',
            's',
            0.0,
        ),
        'max_future': Spec(0.1, 'how far a stamp may lie ahead of the clock', 's', 0.0),
        'max_repeats': Spec(
            8, 'newest readings of one input that are kept and intersected', '', 1
        ),
    },
)


MOTION = Section(
    'Motion',
    'A measurement of age dt is widened by how far the robots can have moved in dt.',
    {
        'max_speed': Spec(
            1.0,
            'no robot moves faster. A robot may have a limit of its own, robot_max_speed.NAME.',
            'm/s',
            0.0,
            examples=('robot_max_speed: {robot_3: 0.3}',),
        ),
        'max_turn_rate': Spec(
            1.0,
            'no robot turns faster. In the plane this bounds the heading, with `dimension: 3` '
            'the whole rotation: roll and pitch count too.',
            'rad/s',
            0.0,
        ),
        'min_separation': Spec(
            0.0,
            'no two robots come nearer than this, such as the size of a robot. Moving robots '
            'that are only seen, never ranged, need it.',
            'm',
            0.0,
        ),
    },
)


RANGES = Section(
    'Ranges',
    'Messages of type sensor_msgs/Range. The error of a reading r is r minus the true '
    'distance. It lies between min_error + min_error_relative * r and max_error + '
    'max_error_relative * r, widened on both sides by sigma_factor standard deviations '
    'when the message carries a variance.',
    {
        'range.topic': Spec(
            '{observer}/range/{target}',
            'template of the topics; empty for none. Without a leading slash it is in the '
            'namespace of the node. Ranges may also be named one by one under links.',
        ),
        'range.stamp_offset': STAMP_OFFSET,
        'range.min_error': Spec(0.0, 'least error of a range', 'm'),
        'range.max_error': Spec(
            0.0,
            'greatest error of a range. Ultra-wideband reads too long, rarely too short: 0.4 '
            'to 1.3 m is common.',
            'm',
        ),
        'range.min_error_relative': Spec(-0.03, 'least error as a fraction of the reading'),
        'range.max_error_relative': Spec(
            0.03, 'greatest error as a fraction of the reading, below 1'
        ),
        'range.sigma_factor': Spec(
            0.0,
            'standard deviations (of Range.variance) added on both sides; 0 ignores the variance',
            '',
            0.0,
        ),
        'range.beyond_max_is_far': Spec(
            False,
            'whether +inf (REP-117) proves that the target is farther than max_range. It does '
            'not where readings simply get lost.',
        ),
        'range.expected_error': Spec(
            math.nan,
            'likeliest error, for the published point. Where it is not known, .nan, it is the '
            'mean of two errors: the one nearest to zero that the bounds allow, and the '
            'middle of the bounds.',
            'm',
            may_be_nan=True,
        ),
        'range.expected_error_relative': Spec(
            0.0,
            'what is added to it as a fraction of the reading. Some radios read a few percent '
            'too long.',
        ),
        'range.min_reading': Spec(
            0.0,
            'a reading of this or less is none; a negative number takes 0.0 for a distance',
            'm',
        ),
        'range.max_reading': Spec(
            math.inf,
            'a reading of this or more is none. Many radios report the largest number that '
            'they have, such as 65.535, where nothing was measured.',
            'm',
            finite=False,
        ),
        'range_difference.min_error': Spec(
            -0.5,
            'least error of a range difference, which comes with peers: the reading minus the '
            'true difference. Robots with odometry, which are remembered, make use of it.',
            'm',
        ),
        'range_difference.max_error': Spec(0.5, 'greatest error of a range difference', 'm'),
    },
)


BEARINGS = Section(
    'Bearings',
    'Messages of type geometry_msgs/Vector3Stamped: a ray of any length in the body frame '
    'of the observer, x forward, y left, z up.',
    {
        'bearing.topic': Spec(
            '{observer}/bearing/{target}', 'template of the topics; empty for none'
        ),
        'bearing.stamp_offset': STAMP_OFFSET,
        'bearing.half_width': Spec(
            0.05, 'greatest angle between a ray and the true direction', 'rad', 0.0, math.pi
        ),
        'bearing.expected_error': Spec(
            0.0,
            'likeliest error about the vertical axis, counterclockwise, for the published point',
            'rad',
            -math.pi,
            math.pi,
        ),
    },
)


ODOMETRY = Section(
    'Odometry',
    'Messages of type nav_msgs/Odometry. They are optional and keep older measurements '
    'sharp. The bounds per m and per rad are those of each step between two messages; '
    'seen from now they add up along the way. A robot may have each of these numbers of '
    'its own, robot_odometry.NAME.translation_scale and so on.',
    {
        'odometry.topic': Spec('{robot}/odom', 'template of the topics; empty for none'),
        'odometry.stamp_offset': STAMP_OFFSET,
        'odometry.translation_scale': Spec(
            1.0,
            'the true distance traveled is this times the reported one, up to the errors. The '
            'errors count per meter of the scaled distance.',
            '',
            LEAST_SCALE,
            MOST_SCALE,
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
        'odometry.constant_translation': Spec(
            0.02, 'greatest error of the position however short the way', 'm', 0.0
        ),
        'odometry.constant_rotation': Spec(
            0.02, 'greatest error of the heading however short the way', 'rad', 0.0
        ),
        'odometry.latency': Spec(
            0.0, 'how far the stamp of a pose may be from the time when it was true', 's', 0.0
        ),
        'odometry.max_gap': Spec(
            1.0,
            'where stamps are farther apart, messages are taken to be lost, and only '
            '`max_speed` and `max_turn_rate` bound what a robot does meanwhile',
            's',
            0.0,
        ),
        'odometry.restart_gap': Spec(
            math.nan,
            'where stamps are farther apart, the odometry counts as started anew. By default, '
            '.nan, gaps alone do not; a pose near zero after a pause, a jump and a new frame '
            'always do.',
            's',
            0.0,
            may_be_nan=True,
        ),
        'odometry.tilt': Spec(
            math.nan,
            'greatest angle of roll and pitch together from the truth, with `dimension: 3` '
            'and z axes that point up. Without it, .nan, nothing is remembered in space.',
            'rad',
            0.0,
            may_be_nan=True,
        ),
    },
)


PEERS = Section(
    'Peers',
    'All that one robot measures in one message of type sensor_msgs/PointCloud2, for '
    'fleets of so many pairs that a topic for each costs too much. A point stands for one '
    'robot or anchor that was measured. Its fields are `peer`, an integer: zero-based '
    'index into the list of robots followed by the anchors not in robots and the sensors '
    'on robots; `range` (m); `x`, `y`, `z`, the ray in the body frame; and `reference`, an '
    'index like `peer`, with `range_difference` (m): the distance to the peer minus that to '
    'the reference. Each of the three may be missing, or NaN.',
    {
        'peers.topic': Spec('{observer}/peers', 'template of the topics; empty for none'),
        'peers.stamp_offset': STAMP_OFFSET,
    },
)


LINKS = Section(
    'Links',
    '',
    {
        'links': Spec(
            [],
            "inputs named one by one, 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'; each "
            'replaces what the templates give for the same measurement. NAME overrides '
            'min_error, max_error, min_error_relative, max_error_relative, sigma_factor, '
            'expected_error, expected_error_relative, min_reading or max_reading of a range, '
            'half_width or expected_error of a bearing, min_error or max_error of an '
            'elevation, any of the bounds for all that peers measure, difference_min_error and '
            'difference_max_error of range differences among it, and gives roll, pitch '
            'and yaw (rad) of a sensor of peers in the body frame of its robot; stamp_offset '
            '(s) is added to stamps. Odometry, elevations, peers and cameras have no TARGET; '
            'the OBSERVER of peers is * where their messages say who measured. A link to a '
            'robot that is not in robots is allowed: its readings are counted and rejected.',
            list_of=str,
            examples=(
                'links:',
                "  - '/uwb_1/to_2 sensor_msgs/msg/Range robot_1 robot_2 max_error=1.2'",
                "  - '/cam1/seen_2 geometry_msgs/msg/Vector3Stamped robot_1 robot_2 "
                "half_width=0.12'",
                "  - '/base_3/odom nav_msgs/msg/Odometry robot_3'",
                "  - '/base_3/seen sensor_msgs/msg/PointCloud2 robot_3'",
                "  - '/uwb uwb_ros/msg/RangeStamped *'",
            ),
        ),
        'ids': Spec(
            [],
            "who the ids in messages of other packages are, 'ID NAME'. NAME is a robot or an "
            'anchor, or - for an id to be passed over. Several ids may have one name. The '
            'name of a robot or an anchor stands for itself. An ID that has blanks stands in '
            'double quotes.',
            list_of=str,
            examples=("ids: ['12 robot_1', '13 robot_1', 'tag36h11:4 robot_2', 'chair -']",),
        ),
        'adapter_modules': Spec(
            [],
            'Python modules to import at start, which register adapters of message types',
            list_of=str,
            examples=("adapter_modules: ['tag_adapter']",),
        ),
    },
)
