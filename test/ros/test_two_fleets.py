# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Two fleets side by side, each in a namespace of its own."""

from functools import partial
import os
from pathlib import Path
import signal
import subprocess

from geometry_msgs.msg import PoseArray
from launch_stand_ins import install, launched, ros_arguments
from processes import start
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

REPOSITORY = Path(__file__).parents[2]
FLEETS = {'left': ('true', 1), 'right': ('false', 16)}
N_ROBOTS = 6
LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEADLINE_S = 120.0


def start_all(processes, log):
    """Start the processes of a launch file in one process group, as a terminal does."""
    started = []
    for process in processes:
        group = started[0].pid if started else 0
        options = {'stdout': log.open('a'), 'stderr': subprocess.STDOUT}
        command = process.executable, *ros_arguments(process)
        started.append(start(*command, process_group=group, **options))
    return started


@pytest.fixture
def fleets(tmp_path):
    """Start both with the launch file of the simulation; return the processes of each."""
    started = {}
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        for fleet, (cameras, _) in FLEETS.items():
            path = REPOSITORY / 'launch/simulation.launch.py'
            context = launched(path, namespace=fleet, cameras=cameras)
            started[fleet] = start_all(context.processes, tmp_path / f'{fleet}.log')
    yield started
    for process in (process for fleet in started.values() for process in fleet):
        process.kill()
        process.wait()


def test_each_fleet_hears_itself_alone_and_ends_alone(bench, fleets, tmp_path):
    poses = {}
    for fleet in FLEETS:
        topic, take = f'/{fleet}/localizer/feasible_poses', partial(poses.__setitem__, fleet)
        bench.node.create_subscription(PoseArray, topic, take, LATCHED)

    def until_placements(fleet, number):
        bench.until(
            lambda: fleet in poses and len(poses[fleet].poses) == number * N_ROBOTS,
            f'{number} hypotheses of the fleet {fleet}',
            DEADLINE_S,
        )

    everybodys = {'/diagnostics', '/parameter_events', '/rosout'}
    for fleet, (_, n_hypotheses) in FLEETS.items():
        until_placements(fleet, n_hypotheses)
        node = ('localizer', f'/{fleet}')
        # Whose a topic is arrives later than what is sent on it.
        subscribed, published = (
            bench.until(lambda of=of, node=node: dict(of(*node)), f'the topics of {node}')
            for of in (
                bench.node.get_subscriber_names_and_types_by_node,
                bench.node.get_publisher_names_and_types_by_node,
            )
        )
        assert all(topic.startswith(f'/{fleet}/robot_') for topic in subscribed)
        assert all(topic.startswith(f'/{fleet}/') for topic in set(published) - everybodys)
        name = f'{fleet}/localizer: fleet'
        bench.until(lambda name=name: name in bench.heard.statuses, name)
    # As Ctrl-C does: no traceback, and no old answers.
    os.killpg(fleets['left'][0].pid, signal.SIGINT)
    codes = [process.wait(timeout=20.0) for process in fleets['left']]
    printed = (tmp_path / 'left.log').read_text()
    assert codes == [0, 0] and 'rror' not in printed and 'Traceback' not in printed, printed
    until_placements('left', 0)
    poses.pop('right')
    until_placements('right', 16)


def test_remapped_outputs_have_their_new_names_alone(bench, make_node):
    node = make_node('-r', '~/feasible_poses:=/fleet/poses', '-r', '/diagnostics:=fleet/state')
    bench.until(lambda: node.count_publishers('/fleet/poses') == 1, 'the topic')
    assert node.count_publishers('/localizer/feasible_poses') == 0
    assert node.count_publishers('/fleet/state') == 1
