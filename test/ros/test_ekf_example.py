# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The example for robot_localization, against what the node publishes and the page says."""

from pathlib import Path

import yaml

from dg_localization.ros.interface.outputs import estimate_outputs
from dg_localization.ros.interface.parameters.settings import check_values, settings_from

REPOSITORY = Path(__file__).parents[2]
FILE = yaml.safe_load((REPOSITORY / 'config/ekf_example.yaml').read_text(encoding='utf-8'))
VALUES = FILE['ekf_filter_node']['ros__parameters']
SETTINGS = settings_from(check_values({'robots': ['robot_1']}))
ROBOT = SETTINGS.fleet.robots[0]


def test_it_fuses_positions_of_the_localizer_and_velocities_of_odometry():
    types = {
        output.name.replace('~', '/localizer'): output.message_class.__name__
        for output in estimate_outputs((ROBOT,))
    }
    assert types[VALUES['pose0']] == 'PoseWithCovarianceStamped'
    assert VALUES['world_frame'] == VALUES['map_frame'] == SETTINGS.fixed_frame
    (odometry,) = [template for template in SETTINGS.templates if 'robot' in template.fields]
    assert VALUES['odom0'] == odometry.text.format(robot=ROBOT)
    # In the order x y z, roll pitch yaw, then their rates, then accelerations.
    for source, wanted in (('pose0', [0, 1]), ('odom0', [6, 7, 11])):
        fused = VALUES[f'{source}_config']
        assert len(fused) == 15 and [i for i, one in enumerate(fused) if one] == wanted
