# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The localizer, and RViz behind an argument.

    ros2 launch dg_localization localizer.launch.py params_file:=my_fleet.yaml rviz:=true
"""

from pathlib import Path

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, LogInfo
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

CONFIG = Path(__file__).parents[1] / 'config'

ARGUMENTS = (
    DeclareLaunchArgument('params_file', description='parameters of the localizer, a YAML file'),
    DeclareLaunchArgument(
        'extra_params_file',
        # The same file once more changes nothing.
        default_value=LaunchConfiguration('params_file'),
        description='parameters that replace those of params_file, as fit_bounds writes them',
    ),
    DeclareLaunchArgument(
        'namespace', default_value='', description='namespace of all nodes, such as left'
    ),
    DeclareLaunchArgument(
        'use_sim_time',
        default_value='false',
        choices=['true', 'false'],
        description='whether the time is that of /clock',
    ),
    DeclareLaunchArgument(
        'rviz',
        default_value='false',
        choices=['true', 'false'],
        description='whether to open RViz',
    ),
    DeclareLaunchArgument(
        'rviz_config',
        default_value=str(CONFIG / 'localizer.rviz'),
        description='what RViz shows',
    ),
    DeclareLaunchArgument(
        'frame',
        default_value='map',
        description='fixed frame of RViz: the frame_id of the markers',
    ),
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, the localizer and RViz."""
    time = {'use_sim_time': ParameterValue(LaunchConfiguration('use_sim_time'), value_type=bool)}
    localizer = Node(
        package='dg_localization',
        executable='localizer',
        namespace=LaunchConfiguration('namespace'),
        parameters=[
            LaunchConfiguration('params_file'),
            LaunchConfiguration('extra_params_file'),
            time,
        ],
        output='screen',
    )
    rviz = Node(
        package='rviz2',
        executable='rviz2',
        namespace=LaunchConfiguration('namespace'),
        arguments=['-d', LaunchConfiguration('rviz_config'), '-f', LaunchConfiguration('frame')],
        parameters=[time],
        # The file names the topic in full; a name without a slash is in the namespace.
        remappings=[('/localizer/markers', 'localizer/markers')],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    hint = LogInfo(
        msg=[
            'RViz shows the frame ',
            LaunchConfiguration('frame'),
            '; where it stays empty, start with frame:=FRAME: the frame_id of localizer/markers',
        ],
        condition=IfCondition(LaunchConfiguration('rviz')),
    )
    return LaunchDescription([*ARGUMENTS, localizer, rviz, hint])
