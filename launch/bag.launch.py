# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A recording with the localizer in its time, and RViz behind an argument; all ends with the bag.

    ros2 launch dg_localization bag.launch.py bag:=my_bag params_file:=my_fleet.yaml rviz:=true
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription, Shutdown
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

LAUNCH = Path(__file__).parent

ARGUMENTS = (
    DeclareLaunchArgument('bag', description='recording: a folder, a .db3 or an .mcap file'),
    DeclareLaunchArgument('params_file', description='parameters of the localizer, a YAML file'),
    DeclareLaunchArgument(
        'rate', default_value='1.0', description='seconds of the bag per second'
    ),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the localizer with RViz, and the replay of the bag."""
    localizer = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(LAUNCH / 'localizer.launch.py')),
        launch_arguments={
            'params_file': LaunchConfiguration('params_file'),
            'use_sim_time': 'true',
        }.items(),
    )
    replay = Node(
        package='dg_localization',
        executable='replay',
        arguments=[LaunchConfiguration('bag'), '--rate', LaunchConfiguration('rate')],
        output='screen',
        on_exit=Shutdown(reason='the bag has ended'),
    )
    return LaunchDescription([*ARGUMENTS, localizer, replay])
