# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
The executable `replay`: the messages of a rosbag2 on their topics, with `/clock`.

    replay BAG [--rate R] [--loop] [--start S] [--duration S] [--topics T ...] [--wait S]

Nodes that are to live in the time of the bag set the parameter `use_sim_time`.
"""

import argparse
from collections.abc import Iterator, Sequence
from contextlib import closing
from pathlib import Path
import time
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from dg_localization.ros.bags.bag import NS_PER_S, BagError, Topic, open_bag
from dg_localization.ros.bags.reading import BagMessage, Reading
from dg_localization.ros.executables import add_span, make_progress, number, print_line
from dg_localization.ros.spinning import own_arguments, rclpy_running

CLOCK = '/clock'
QUEUE_DEPTH = 100
# Between messages the clock goes on, so that timers in bag time run through a gap.
CLOCK_PERIOD_S = 0.05
# Subscribers come one by one; after this long without a new one all are taken to be there.
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
        Where to publish.
    rate : float
        How many seconds of the bag pass in a second.

    """

    def __init__(self, node: Node, topics: Sequence[Topic], rate: float = 1.0) -> None:
        self._rate = rate
        self._publishers: dict[str, Publisher] = {
            topic.name: node.create_publisher(topic.message_class, topic.name, _qos(topic.latched))
            for topic in topics
        }
        self._clock = node.create_publisher(Clock, CLOCK, _qos(latched=False))

    def wait_for_subscribers(self, timeout_s: float) -> int:
        """Wait until somebody listens and nobody new comes."""
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

    def play(self, messages: Iterator[BagMessage], start_ns: int, progress: Any) -> int:
        """Publish messages, each after the time of it on `/clock`."""
        wall_start_s = time.monotonic()
        clock_ns = start_ns
        count = 0
        self._publish_clock(start_ns)
        for message in messages:
            due_s = wall_start_s + (message.time_ns - start_ns) / NS_PER_S / self._rate
            while (left_s := due_s - time.monotonic()) > CLOCK_PERIOD_S:
                time.sleep(CLOCK_PERIOD_S)
                passed_s = time.monotonic() - wall_start_s
                now_ns = start_ns + round(passed_s * self._rate * NS_PER_S)
                clock_ns = self._advance(clock_ns, min(now_ns, message.time_ns), progress)
            if left_s > 0.0:
                time.sleep(left_s)
            clock_ns = self._advance(clock_ns, message.time_ns, progress)
            self._publishers[message.topic].publish(message.data)
            count += 1
        return count

    def _advance(self, clock_ns: int, now_ns: int, progress: Any) -> int:
        """Publish the time if it is later than the last one, and return the later of both."""
        if now_ns <= clock_ns:
            return clock_ns
        self._publish_clock(now_ns)
        progress.update((now_ns - clock_ns) / NS_PER_S)
        return now_ns

    def _publish_clock(self, time_ns: int) -> None:
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(time_ns, NS_PER_S)
        self._clock.publish(message)

    def flush(self) -> None:
        """Wait, for a short time, until every reliable subscriber has everything."""
        for publisher in self._publishers.values():
            publisher.wait_for_all_acked(Duration(seconds=ACKNOWLEDGE_S))


def _qos(latched: bool) -> QoSProfile:
    """Return a profile that subscribers of every reliability can read."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return QoSProfile(
        depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.RELIABLE, durability=durability
    )


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command line."""
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
    return parser


def replay(node: Node, options: argparse.Namespace) -> None:
    """Do what the command line asks for."""
    with open_bag(options.bag) as bag:
        reading = Reading(bag, options.topics)
        for notice in (*bag.damage, *bag.notices, *reading.notices):
            print_line(notice)
        left_s = bag.duration_s - options.start
        if left_s < 0.0:
            raise BagError(
                f'--start {options.start:g} s is after the end: the bag has {bag.duration_s:.1f} s'
            )
        # The time of the recording is told by the replay itself.
        topics = [topic for topic in reading.topics if topic.name != CLOCK]
        if len(topics) < len(reading.topics):
            print_line(f'{CLOCK} is passed over: replay publishes the time of the bag there')
        replayer = Replayer(node, topics, options.rate)
        print_line(f'{len(topics)} topics, {bag.duration_s:.1f} s; waiting for subscribers')
        if not replayer.wait_for_subscribers(options.wait):
            print_line(f'nobody subscribed within {options.wait:g} s; playing all the same')
        start_ns = bag.start_ns + round(options.start * NS_PER_S)
        total_s = left_s if options.duration is None else min(left_s, options.duration)
        while True:
            next_pass_s = time.monotonic() + SHORTEST_PASS_S
            recorded = reading.messages(options.start, options.duration)
            messages = (message for message in recorded if message.topic != CLOCK)
            with closing(make_progress(total_s)) as progress:
                count = replayer.play(messages, start_ns, progress)
            replayer.flush()
            print_line(f'{count} messages published')
            for topic, unreadable in sorted(reading.unreadable.items()):
                print_line(f'{topic}: {unreadable} damaged messages were passed over')
            reading.unreadable.clear()
            if not options.loop:
                return
            time.sleep(max(0.0, next_pass_s - time.monotonic()))


def main(args: Sequence[str]) -> int:
    """Replay a bag until its end or a signal."""
    options = make_parser().parse_args(own_arguments(args))
    with rclpy_running(args):
        node = Node('replay')
        try:
            replay(node, options)
        except KeyboardInterrupt:
            print_line('interrupted')
        finally:
            node.destroy_node()
    return 0
