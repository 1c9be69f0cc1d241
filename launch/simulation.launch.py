# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The simulated fleet of the paper with the localizer, and RViz behind an argument.

    ros2 launch dg_localization simulation.launch.py rviz:=true cameras:=false frame:=fleet
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

LAUNCH = Path(__file__).parent
SWITCHES = {
    'cameras': ('true', 'whether the robots see each other'),
    'landmarks': ('false', 'whether there are three landmarks, ranged and seen by all'),
    'odometry': ('false', 'whether the robots publish odometry'),
    'peers': ('false', 'whether each robot sends all ranges and bearings in one message'),
}

ARGUMENTS = (
    # The file that is included has these two with other defaults.
    DeclareLaunchArgument(
        'params_file',
        default_value=str(LAUNCH.parent / 'config/paper_fleet.yaml'),
        description='parameters of the localizer, a YAML file',
    ),
    DeclareLaunchArgument(
        'frame',
        default_value='robot_2/base_link',
        description='fixed frame of RViz: frame_id of the markers (with odometry robot_2/odom)',
    ),
    *(
        DeclareLaunchArgument(
            name, default_value=default, choices=['true', 'false'], description=description
        )
        for name, (default, description) in SWITCHES.items()
    ),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the localizer with RViz, and the simulated fleet."""
    localizer = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(LAUNCH / 'localizer.launch.py')),
        launch_arguments={
            'params_file': LaunchConfiguration('params_file'),
            'frame': LaunchConfiguration('frame'),
            # The simulated fleet has the time of the machine.
            'use_sim_time': 'false',
        }.items(),
    )
    simulation = Node(
        package='dg_localization',
        executable='simulate_fleet',
        namespace=LaunchConfiguration('namespace'),
        parameters=[
            {name: ParameterValue(LaunchConfiguration(name), value_type=bool) for name in SWITCHES}
        ],
        output='screen',
    )
    return LaunchDescription([*ARGUMENTS, localizer, simulation])
