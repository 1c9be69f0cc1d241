# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Executables in processes of their own, and a node that listens to them."""

from functools import partial
import os
import signal
import subprocess
import sys
import time

from plain_python import REPOSITORY
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import DurabilityPolicy, QoSProfile

COMMAND = (sys.executable, '-m', 'dg_localization.ros')
LATCHED = QoSProfile(depth=10, durability=DurabilityPolicy.TRANSIENT_LOCAL)
DEADLINE_S = 60.0
PIPES = {'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE}


def start(name, *arguments, **options):
    """Start an executable; the options are those of `subprocess.Popen`."""
    return subprocess.Popen(
        [*COMMAND, name, *map(str, arguments)],
        cwd=REPOSITORY,
        env={**os.environ, 'PYTHONUNBUFFERED': '1'},
        text=True,
        **options,
    )


class LocalizerProcess:
    """The executable as a process of its own."""

    def __init__(self, log, *ros_args):
        self._log = log
        arguments = ['--ros-args', *ros_args] if ros_args else []
        with log.open('w') as output:
            self.process = start('localizer', *arguments, stdout=output, stderr=subprocess.STDOUT)

    def output(self):
        return self._log.read_text()

    def stop(self, number=signal.SIGINT):
        """Signal the process, and return its exit code and all it printed."""
        if self.process.poll() is None:
            self.process.send_signal(number)
        try:
            return self.process.wait(timeout=DEADLINE_S), self.output()
        except subprocess.TimeoutExpired:
            self.process.kill()
            raise AssertionError(f'not ended in {DEADLINE_S} s: {self.output()}') from None


def wait_for(condition, deadline_s=120.0):
    """Return what a condition gives as soon as that is true."""
    give_up_s = time.monotonic() + deadline_s
    while not (found := condition()):
        assert time.monotonic() < give_up_s, f'nothing for {deadline_s} s'
        time.sleep(0.02)
    return found


class Listener:
    """What a node hears on {topic: (class, QoS)}, in the order of arrival; others spin beside."""

    def __init__(self, node, topics, *others):
        self.received, self._nodes = [], (node, *others)
        for topic, (message_class, qos) in topics.items():
            node.create_subscription(message_class, topic, partial(self._take, topic), qos)

    def _take(self, topic, message):
        self.received.append((topic, message))

    def on(self, topic):
        return [message for name, message in self.received if name == topic]

    def spin_until(self, condition, timeout_s=30.0):
        """Spin until a condition is met, and return whether it is."""
        executor = SingleThreadedExecutor(context=self._nodes[0].context)
        for node in self._nodes:
            executor.add_node(node)
        deadline_s = time.monotonic() + timeout_s
        while not condition() and time.monotonic() < deadline_s:
            executor.spin_once(timeout_sec=0.05)
        executor.shutdown()
        return bool(condition())
