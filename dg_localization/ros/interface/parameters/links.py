# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The parameters of the node `localizer` that name inputs one by one."""

from collections.abc import Mapping
from typing import Any

from dg_localization.fleet import LinkKind
from dg_localization.ros.interface.links import STAMP_OFFSET
from dg_localization.ros.interface.parameters.spec import DOUBLE, STRINGS, Section, Spec

LINKS = Section(
    'Links',
    '',
    (
        Spec(
            'links',
            STRINGS,
            [],
            "inputs named one by one, 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'; "
            'each replaces what the templates give for the same measurement',
            details='NAME overrides min_error, max_error, min_error_relative, max_error_relative, '
            'sigma_factor, expected_error, expected_error_relative, min_reading or max_reading of '
            'a range, half_width or '
            'expected_error of a bearing, min_error or max_error of an elevation, any of the '
            'bounds for all that peers measure, and gives roll, pitch and yaw (rad) of a sensor '
            'of peers in the body frame of its robot; stamp_offset (s) is added to stamps. '
            'Odometry, elevations, peers and cameras have no TARGET; the OBSERVER of peers is * '
            'where their messages say who measured. A link to a robot that is not in robots is '
            'allowed: its readings are counted and rejected.',
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
        Spec(
            'ids',
            STRINGS,
            [],
            "who the ids in messages of other packages are, 'ID NAME'",
            details='NAME is a robot or an anchor, or - for an id to be passed over. Several ids '
            'may have one name. The name of a robot or an anchor stands for itself. An ID that '
            'has blanks stands in double quotes.',
            examples=("ids: ['12 robot_1', '13 robot_1', 'tag36h11:4 robot_2', 'chair -']",),
        ),
        Spec(
            'adapter_modules',
            STRINGS,
            [],
            'Python modules to import at start, which register adapters of message types',
            examples=("adapter_modules: ['tag_adapter']",),
        ),
    ),
)


def stamp_offset_spec(kind: LinkKind) -> Spec:
    """Return the parameter that corrects the stamps of all inputs of a kind."""
    return Spec(
        f'{kind}.{STAMP_OFFSET}',
        DOUBLE,
        0.0,
        'what is added to stamps, negative where they are late',
        's',
        details='A link may have a `stamp_offset` of its own.',
    )


def stamp_offset(values: Mapping[str, Any], kind: LinkKind) -> dict[str, float]:
    """Return what links of a kind override where they do not say it themselves."""
    offset_s = values.get(f'{kind}.{STAMP_OFFSET}', 0.0)
    return {STAMP_OFFSET: offset_s} if offset_s else {}
