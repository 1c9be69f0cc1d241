# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The sensors of a scenario: ``python -m benchmarks.load.sensors SCENARIO SECONDS``."""

from __future__ import annotations

from collections.abc import Iterator
import heapq
import json
import math
import struct
import sys
import time
from typing import Any

import numpy as np
import rclpy
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from rclpy.serialization import serialize_message

from benchmarks.load.scenario import Scenario
from msg_adapters import BearingReading, PeersReading, RangeReading, adapter_for

RANGE, BEARING = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
CLOUD = 'sensor_msgs/msg/PointCloud2'
STAMP = struct.Struct('<iI')
STAMP_OFFSET = 4
PATIENCE_S = 60.0
SETTLE_S = 5.0


def readings(scenario: Scenario) -> Iterator[tuple[str, str, Any]]:
    """Yield topic, type and message of everything that is measured."""
    robots, positions = scenario.robots, scenario.positions_m
    targets: dict[int, list[int]] = {}
    for observer, target in scenario.links:
        targets.setdefault(observer, []).append(target)
    for observer, seen in targets.items():
        gaps = positions[seen] - positions[observer]
        ranges_m = np.linalg.norm(gaps, axis=1)
        rays = np.column_stack([gaps / ranges_m[:, None], np.zeros(len(seen))])
        name = robots[observer]
        if scenario.peers:
            rays = rays if scenario.cameras else np.full((len(seen), 3), math.nan)
            cloud = PeersReading(0.0, np.array(seen), ranges_m, rays)
            yield f'/{name}/peers', CLOUD, cloud
            continue
        for target, range_m, ray in zip(seen, ranges_m, rays, strict=True):
            yield f'/{name}/range/{robots[target]}', RANGE, RangeReading(0.0, float(range_m))
            if scenario.cameras:
                yield f'/{name}/bearing/{robots[target]}', BEARING, BearingReading(0.0, ray)


def stamped(data: bytearray, time_s: float) -> bytes:
    """Return a serialized message with another stamp: the first field of its header."""
    sec, nanosec = divmod(round(time_s * 1e9), 1_000_000_000)
    STAMP.pack_into(data, STAMP_OFFSET, sec, nanosec)
    return bytes(data)


def send(scenario: Scenario, seconds: float) -> dict[str, float]:
    """Publish at the rate of a scenario; return when it began and ended, and how much was sent."""
    node = Node('sensors')
    publishers = []
    for topic, type_name, reading in readings(scenario):
        adapter = adapter_for(type_name)
        data = bytearray(serialize_message(adapter.to_message(reading)))
        publisher = node.create_publisher(adapter.message_class(), topic, qos_profile_sensor_data)
        publishers.append((publisher, data))
    give_up_s = time.monotonic() + PATIENCE_S
    while any(not publisher.get_subscription_count() for publisher, _ in publishers):
        if time.monotonic() > give_up_s:
            sys.exit('the node does not subscribe to all topics')
        time.sleep(0.1)
    period_s = 1.0 / scenario.rate_hz
    begin_s = time.time() + 0.1
    # Sensors are not in step.
    due = [(begin_s + period_s * k / len(publishers), k) for k in range(len(publishers))]
    heapq.heapify(due)
    sent, first_s = 0, begin_s + SETTLE_S
    end_s = first_s + seconds
    while due[0][0] < end_s:
        due_s, k = due[0]
        now_s = time.time()
        if due_s > now_s:
            time.sleep(due_s - now_s)
            now_s = time.time()
        publisher, data = publishers[k]
        publisher.publish(stamped(data, now_s))
        sent += first_s <= now_s < end_s
        # What could not be sent in time is left out, not sent in a burst.
        heapq.heapreplace(due, (max(due_s + period_s, now_s), k))
    time.sleep(1.0)
    return {'first_s': first_s, 'end_s': end_s, 'sent': sent}


def main() -> None:
    """Send, and print what was sent."""
    scenario = Scenario.from_json(sys.argv[1])
    rclpy.init()
    print(json.dumps(send(scenario, float(sys.argv[2]))), flush=True)
    rclpy.shutdown()


if __name__ == '__main__':
    main()
