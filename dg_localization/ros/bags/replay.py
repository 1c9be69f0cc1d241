# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `replay`: the messages of a rosbag2 on their topics, with `/clock`.

    replay BAG [--rate R] [--loop] [--start S] [--duration S] [--topics T ...] [--wait S]

Nodes that use the time of the bag set the parameter `use_sim_time`.
"""

import argparse
from collections.abc import Iterable, Sequence
from datetime import timedelta
import math
from pathlib import Path
import time

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rosgraph_msgs.msg import Clock

from dg_localization.ros.bags.bag import NS_PER_S, SILENCE_NS, BagError, Topic, open_bag
from dg_localization.ros.bags.reading import BagMessage, Reading
from dg_localization.ros.executables import add_span, number, print_line
from dg_localization.ros.spinning import own_arguments, rclpy_running

CLOCK = '/clock'
QUEUE_DEPTH = 100
# The clock also ticks between messages, so that timers in bag time run through a gap.
CLOCK_PERIOD_S = 0.05
# Subscribers come one by one; after this time without a new one all count as present.
SETTLED_S = 0.5
ACKNOWLEDGE_S = 2.0
# A bag of one message has no duration: without a pause its loop would flood the graph.
SHORTEST_PASS_S = 1.0


class Replayer:
    """
    Publishes recorded messages at the pace of the recording.

    Parameters
    ----------
    node : rclpy.node.Node
        The node that owns the publishers.
    topics : sequence of Topic
        The topics to publish.
    rate : float
        Seconds of the bag per second.

    """

    def __init__(self, node: Node, topics: Sequence[Topic], rate: float = 1.0) -> None:
        self._rate = rate
        self._publishers: dict[str, Publisher] = {
            topic.name: node.create_publisher(topic.message_class, topic.name, _qos(topic.latched))
            for topic in topics
        }
        self._clock = node.create_publisher(Clock, CLOCK, _qos(latched=False))

    def wait_for_subscribers(self, timeout_s: float) -> int:
        """Wait until there are subscribers and no new ones come; return their number."""
        deadline_s = time.monotonic() + timeout_s
        count, since_s = 0, time.monotonic()
        while time.monotonic() < deadline_s:
            present = sum(p.get_subscription_count() for p in self._publishers.values())
            if present != count:
                count, since_s = present, time.monotonic()
            elif count and time.monotonic() - since_s >= SETTLED_S:
                break
            time.sleep(CLOCK_PERIOD_S)
        return count

    def play(self, messages: Iterable[BagMessage], start_ns: int) -> int:
        """Publish messages, each after its time on `/clock`, then wait for acknowledgement."""
        began_s, clock, count = time.monotonic(), Clock(), 0
        clock_ns, last_ns = start_ns - 1, start_ns
        for message in messages:
            if message.time_ns - last_ns > SILENCE_NS:
                gap = timedelta(seconds=round((message.time_ns - last_ns) / NS_PER_S))
                print_line(f'no message for {gap} of the recording; {CLOCK} goes on meanwhile')
            last_ns = message.time_ns
            left_s = math.inf
            while left_s > 0.0:
                passed_s = (time.monotonic() - began_s) * self._rate
                now_ns = min(message.time_ns, start_ns + round(passed_s * NS_PER_S))
                if now_ns > clock_ns:
                    clock.clock.sec, clock.clock.nanosec = divmod(now_ns, NS_PER_S)
                    self._clock.publish(clock)
                    clock_ns = now_ns
                left_s = (message.time_ns - now_ns) / NS_PER_S / self._rate
                time.sleep(min(left_s, CLOCK_PERIOD_S))
            self._publishers[message.topic].publish(message.data)
            count += 1
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_S))
        return count


def _qos(latched: bool) -> QoSProfile:
    """Return a profile that is compatible with subscribers of every reliability."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(depth=QUEUE_DEPTH, durability=durability)


def replay(node: Node, options: argparse.Namespace) -> None:
    """Replay a bag as the command line asks."""
    with open_bag(options.bag) as bag:
        reading = Reading(bag, options.topics, options.start, options.duration)
        for notice in (*bag.damage, *bag.notices, *reading.notices):
            print_line(notice)
        if bag.duration_s < options.start:
            raise BagError(
                f'--start {options.start:g} s is after the end: the bag has {bag.duration_s:.1f} s'
            )
        # The replay publishes the time of the recording itself.
        topics = [topic for topic in reading.topics if topic.name != CLOCK]
        if len(topics) < len(reading.topics):
            print_line(f'{CLOCK} is passed over: replay publishes the time of the bag there')
        replayer = Replayer(node, topics, options.rate)
        print_line(f'{len(topics)} topics, {bag.duration_s:.1f} s; waiting for subscribers')
        if not replayer.wait_for_subscribers(options.wait):
            print_line(f'no subscriber within {options.wait:g} s; playing without one')
        while True:
            next_pass_s = time.monotonic() + SHORTEST_PASS_S
            recorded = (message for message in reading.shown() if message.topic != CLOCK)
            count = replayer.play(recorded, reading.start_ns)
            print_line(f'{count} messages published')
            for topic, unreadable in sorted(reading.unreadable.items()):
                print_line(f'{topic}: {unreadable} damaged messages were passed over')
            reading.unreadable.clear()
            if not options.loop:
                return
            time.sleep(max(0.0, next_pass_s - time.monotonic()))


def main(args: Sequence[str]) -> int:
    """Replay a bag until its end or a signal."""
    parser = argparse.ArgumentParser(
        prog='replay', description='Publish the messages of a rosbag2 on their topics.'
    )
    add = parser.add_argument
    add('bag', type=Path, metavar='BAG', help='folder, .db3 or .mcap file')
    pace = number(0.0, '', strict=True)
    add('--rate', type=pace, default=1.0, help='seconds of the bag per second (%(default)s)')
    add('--loop', action='store_true', help='begin again at the end, once a second at most')
    add_span(parser)
    add('--topics', nargs='+', metavar='T', help='play only these topics')
    seconds = number(0.0, ' s')
    add('--wait', type=seconds, default=5.0, metavar='S', help='for subscribers (%(default)s)')
    options = parser.parse_args(own_arguments(args))
    with rclpy_running(args):
        node = Node('replay')
        try:
            replay(node, options)
        except KeyboardInterrupt:
            print_line('interrupted')
        finally:
            node.destroy_node()
    return 0
