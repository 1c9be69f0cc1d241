# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What goes wrong: each disturbance begins, lasts, and ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from sensor_msgs.msg import PointCloud2, Range
from std_msgs.msg import String

from benchmarks.chaos.world import RANGE, ROBOTS, World


@contextmanager
def silence(world: World, _: Path) -> Iterator[None]:
    """Silence all sensors."""
    world.silent |= set(ROBOTS)
    yield
    world.silent.clear()


@contextmanager
def robot_restarts(world: World, _: Path) -> Iterator[None]:
    """Switch one robot off, and on again with new publishers."""
    world.silent.add('r2')
    world.forget_publishers('r2')
    yield
    world.silent.clear()


@contextmanager
def reference_is_lost(world: World, _: Path) -> Iterator[None]:
    """Silence the reference robot."""
    world.silent.add('r1')
    yield
    world.silent.clear()


@contextmanager
def clock_forward(world: World, _: Path) -> Iterator[None]:
    """Have the clock jump ahead by 7 s."""
    world.now_s += 7.0
    yield


@contextmanager
def clock_back(world: World, _: Path) -> Iterator[None]:
    """Have the clock jump back by 7 s."""
    world.now_s -= 7.0
    yield


@contextmanager
def clock_stops(world: World, _: Path) -> Iterator[None]:
    """Pause the clock; the sensors go on."""
    world.speed = 0.0
    yield
    world.speed = 1.0


@contextmanager
def stamps_are_old(world: World, _: Path) -> Iterator[None]:
    """Put all stamps 3 s into the past."""
    world.lag_s = 3.0
    yield
    world.lag_s = 0.0


@contextmanager
def wrong_types(world: World, _: Path) -> Iterator[None]:
    """Have a stranger publish other types on the names of inputs."""
    # DDS lets no participant use two types on one topic.
    context = Context()
    rclpy.init(context=context)
    stranger = Node('stranger', context=context)
    topics = ['/r1/range/a1', '/r2/peers', '/r3/odom']
    publishers = [stranger.create_publisher(String, topic, 10) for topic in topics]

    def shout() -> None:
        for publisher in publishers:
            publisher.publish(String(data='hello'))

    world.extra.append(shout)
    yield
    world.extra.clear()
    stranger.destroy_node()
    rclpy.shutdown(context=context)


@contextmanager
def flood(world: World, _: Path) -> Iterator[None]:
    """Send NaN and huge messages to the inputs, hundreds a second."""
    ranges = world.publisher(RANGE, '/r1/range/a1')
    clouds = world.node.create_publisher(PointCloud2, '/r3/peers', 10)
    huge = PointCloud2(height=1, width=100_000, data=bytes(500_000))

    def pour() -> None:
        for _ in range(50):
            ranges.publish(Range(range=float('nan')))
        clouds.publish(huge)

    world.extra.append(pour)
    yield
    world.extra.clear()
    world.node.destroy_publisher(clouds)


@contextmanager
def slow_solver(_: World, slow: Path) -> Iterator[None]:
    """Have the solver not come back."""
    slow.touch()
    yield
    slow.unlink()


@contextmanager
def reset(world: World, _: Path) -> Iterator[None]:
    """Tell the node to forget everything."""
    world.reset()
    yield


@contextmanager
def deactivated(world: World, _: Path) -> Iterator[None]:
    """Deactivate the node."""
    world.transition('deactivate')
    yield
    world.transition('activate')


@contextmanager
def cleaned_up(world: World, _: Path) -> Iterator[None]:
    """Take the node down to where it has nothing, and up again."""
    for label in ('deactivate', 'cleanup'):
        world.transition(label)
    yield
    for label in ('configure', 'activate'):
        world.transition(label)


@contextmanager
def two_at_once(world: World, slow: Path) -> Iterator[None]:
    """Have the solver not come back, and the clock jump back meanwhile."""
    with slow_solver(world, slow), clock_back(world, slow):
        yield


DISTURBANCES = {
    'sensors silent': (silence, 2.5, True),
    'robot restarts': (robot_restarts, 1.5, False),
    'reference silent': (reference_is_lost, 1.5, False),
    'clock +7 s': (clock_forward, 0.1, False),
    'clock -7 s': (clock_back, 0.1, False),
    'clock stops': (clock_stops, 1.5, False),
    'stamps 3 s old': (stamps_are_old, 2.5, True),
    'wrong types': (wrong_types, 1.5, False),
    'flood': (flood, 1.5, False),
    'slow solver': (slow_solver, 3.0, False),
    'reset': (reset, 0.1, False),
    'deactivated': (deactivated, 0.5, True),
    'cleaned up': (cleaned_up, 0.5, True),
    'slow, clock -7 s': (two_at_once, 2.0, True),
}
"""By name: the disturbance, for how many seconds it lasts, and whether it leaves no answer."""
