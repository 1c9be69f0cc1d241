# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
A recording with the localizer in its time, and RViz behind an argument; all ends with the bag.

    ros2 launch dg_localization bag.launch.py bag:=my_bag params_file:=my_fleet.yaml rviz:=true
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    IncludeLaunchDescription,
    SetLaunchConfiguration,
    Shutdown,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

LAUNCH = Path(__file__).parent

ARGUMENTS = (
    DeclareLaunchArgument('bag', description='recording: a folder, a .db3 or an .mcap file'),
    DeclareLaunchArgument(
        'rate', default_value='1.0', description='seconds of the bag per second'
    ),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the localizer with RViz, and the replay of the bag."""
    time_of_bag = SetLaunchConfiguration('use_sim_time', 'true')
    localizer = IncludeLaunchDescription(
        PythonLaunchDescriptionSource(str(LAUNCH / 'localizer.launch.py'))
    )
    replay = Node(
        package='dg_localization',
        executable='replay',
        arguments=[LaunchConfiguration('bag'), '--rate', LaunchConfiguration('rate')],
        output='screen',
        on_exit=Shutdown(reason='the bag has ended'),
    )
    return LaunchDescription([*ARGUMENTS, time_of_bag, localizer, replay])
