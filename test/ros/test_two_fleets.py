# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Two fleets side by side, each in a namespace, started and looked at as an operator does."""

from functools import partial
import os
from pathlib import Path
import signal
import subprocess

from geometry_msgs.msg import PoseArray
from launch_stand_ins import install, launched
from processes import start
import pytest
from rclpy.qos import DurabilityPolicy, QoSProfile

REPOSITORY = Path(__file__).parents[2]
FLEETS = {'left': ('true', 1), 'right': ('false', 16)}
N_ROBOTS = 6
DEADLINE_S = 120.0


class Fleet:
    """What a launch file starts, in a process group of its own, as a terminal has it."""

    def __init__(self, processes, log):
        self.processes = []
        for process in processes:
            group = self.processes[0].pid if self.processes else 0
            options = {'stdout': log.open('a'), 'stderr': subprocess.STDOUT}
            command = process.executable, *process.ros_arguments
            self.processes.append(start(*command, process_group=group, **options))
        self._log = log

    def interrupt(self):
        """Press Ctrl-C; return the exit codes and what was printed."""
        os.killpg(self.processes[0].pid, signal.SIGINT)
        codes = [process.wait(timeout=20.0) for process in self.processes]
        return codes, self._log.read_text()

    def end(self):
        for process in self.processes:
            if process.poll() is None:
                process.kill()
                process.wait()


class Heard:
    """The newest answers of both fleets."""

    def __init__(self, bench):
        self.poses = {}
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        for fleet in FLEETS:
            topic, take = f'/{fleet}/localizer/feasible_poses', partial(self._take, fleet)
            bench.node.create_subscription(PoseArray, topic, take, latched)

    def _take(self, fleet, message):
        self.poses[fleet] = message

    def n_hypotheses(self, fleet):
        message = self.poses.get(fleet)
        return None if message is None else len(message.poses) // N_ROBOTS


@pytest.fixture(scope='module')
def heard(bench):
    return Heard(bench)


@pytest.fixture(scope='module')
def fleets(tmp_path_factory):
    """Start both with the launch file of the simulation."""
    folder = tmp_path_factory.mktemp('fleets')
    started = {}
    with pytest.MonkeyPatch.context() as patch:
        install(patch)
        for fleet, (cameras, _) in FLEETS.items():
            path = REPOSITORY / 'launch/simulation.launch.py'
            context = launched(path, namespace=fleet, cameras=cameras)
            started[fleet] = Fleet(context.processes, folder / f'{fleet}.log')
    yield started
    for fleet in started.values():
        fleet.end()


@pytest.fixture
def both_answer(bench, fleets, heard):
    """Wait until each fleet has the answer of its own sensors."""
    for fleet, (_, n_hypotheses) in FLEETS.items():
        bench.until(
            lambda fleet=fleet, n=n_hypotheses: heard.n_hypotheses(fleet) == n,
            f'{n_hypotheses} hypotheses of the fleet {fleet}',
            DEADLINE_S,
        )


@pytest.mark.usefixtures('both_answer')
def test_each_fleet_hears_itself_alone(bench):
    everybodys = {'/diagnostics', '/parameter_events', '/rosout'}
    for fleet in FLEETS:
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


@pytest.mark.usefixtures('both_answer')
def test_ctrl_c_ends_one_fleet_without_a_traceback_and_without_old_answers(bench, fleets, heard):
    codes, printed = fleets['left'].interrupt()
    assert codes == [0, 0], printed
    assert 'Traceback' not in printed and 'rror' not in printed
    bench.until(lambda: heard.n_hypotheses('left') == 0, 'an empty answer of the left fleet')
    heard.poses.pop('right')
    bench.until(lambda: heard.n_hypotheses('right') == 16, 'a new answer of the right fleet')


def test_remapped_outputs_have_their_new_names_alone(bench, make_node):
    node = make_node('-r', '~/feasible_poses:=/fleet/poses', '-r', '/diagnostics:=fleet/state')
    bench.until(lambda: node.count_publishers('/fleet/poses') == 1, 'the topic')
    assert node.count_publishers('/localizer/feasible_poses') == 0
    assert node.count_publishers('/fleet/state') == 1
