# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Robots at elevations that are read: the parameters, and a node that hears them over DDS."""

import math

from heard_poses import assert_holds, half_widths_of, pose_from_message
import numpy as np

from dg_localization.fleet import ElevationErrorModel
from dg_localization.ros.interface.parameters.settings import check_values, settings_from
from msg_adapters import Level

BEACONS = {'beacon_1': (0.0, 0.0), 'beacon_2': (6.0, 0.0), 'beacon_3': (0.0, 6.0)}
PLACE_M, HEIGHT_M = np.array([2.0, 3.0]), 8.0
ELEVATED = {
    'robots': ['robot_1', 'robot_2'],
    'elevations.names': ['robot_1'],
    'elevations.robot_1': [0.0, 20.0],
}
LINK = '/baro geometry_msgs/msg/PointStamped'


def settings(**given):
    return settings_from(check_values({**ELEVATED, **given}))


def test_parameters_of_readings_reach_the_fleet():
    found = settings(
        **{
            'elevation.topic': '{observer}/depth',
            'elevation.min_error': -0.2,
            'elevation.max_error': 0.3,
            'elevation.stamp_offset': -0.1,
        }
    )
    assert found.fleet.elevation_error == ElevationErrorModel(-0.2, 0.3)
    assert found.fleet.point_elevation_error == {}
    (template,) = (one for one in found.templates if one.kind == 'elevation')
    link = template.link_of('/robot_1/depth', found.fleet.points)
    assert str(link.key) == 'elevation robot_1'
    assert link.stamp_offset_s == -0.1


def test_a_link_has_error_bounds_of_its_own_which_are_not_those_of_ranges():
    found = settings(
        links=[f'{LINK} robot_1 min_error=-1.0', '/other geometry_msgs/msg/PointStamped robot_1']
    )
    assert found.fleet.point_elevation_error == {'robot_1': ElevationErrorModel(-1.0, 0.5)}
    assert found.fleet.links == ()
    # Readings of a robot without a stated elevation are counted and rejected.
    assert settings(links=[f'{LINK} robot_2 max_error=1.0']).fleet.point_elevation_error == {}


def test_a_robot_in_the_air_is_found_by_its_altimeter(bench, make_node):
    beacons = {f'anchors.{name}.position': list(place) for name, place in BEACONS.items()}
    make_node(
        covariance='enclosure',
        **beacons,
        **{
            'robots': ['robot_1'],
            'anchors.names': list(BEACONS),
            'elevations.names': ['robot_1'],
            'elevations.robot_1': [0.0, 20.0],
            'elevation.topic': '{observer}/elevation',
            'elevation.min_error': -0.1,
            'elevation.max_error': 0.1,
            'range.min_error': -0.01,
            'range.max_error': 0.01,
            'range.min_error_relative': 0.0,
            'range.max_error_relative': 0.0,
            'max_speed': 0.1,
        },
    )
    bench.repeat(
        lambda: bench.send_elevation('robot_1', HEIGHT_M + 0.05),
        *(
            lambda name=name, place=place: bench.send_range(
                'robot_1', name, math.dist((*PLACE_M, HEIGHT_M), (*place, 0.0))
            )
            for name, place in BEACONS.items()
        ),
    )

    def poses():
        return [pose_from_message(message) for message in bench.heard.poses['robot_1']]

    # Without a reading the place is known to 8 m.
    bench.until(lambda: any(half_widths_of(pose)[0] < 1.0 for pose in poses()), 'a place')
    for pose in poses():
        assert_holds(pose, PLACE_M, 0.0)
    bench.until_status('robot robot_1', Level.OK, 'localized')
