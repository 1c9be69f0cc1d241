# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Small bags of three robots that range each other, and what `localize_bag` makes of them."""

import json

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from sensor_msgs.msg import Range

from dg_localization.ros.executables import localize_bag
from dg_localization.ros.simulation.simulate_fleet import PARAMETERS as SIMULATION, SimulatedFleet
from msg_adapters import adapter_for

# Without these each test that needs bags is skipped.
for package in ('rosbags', 'mcap'):
    pytest.importorskip(package, reason=f"{package}, the extra 'bags', is not installed")

from rosbags import interfaces as qos  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: E402

STORE = get_typestore(Stores.ROS2_JAZZY)
ODD = 'strange_msgs/msg/Odd'
STORE.register(get_types_from_msg('float64 x', ODD))
ODD_MESSAGE = STORE.serialize_cdr(STORE.types[ODD](1.0), ODD)
RANGE = 'sensor_msgs/msg/Range'
POSE = 'geometry_msgs/msg/PoseStamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 100_000_000
SIMULATED_TRUTH = '/simulate_fleet/ground_truth'
# Two sides and the hypotenuse of a right triangle.
TRIANGLE = {('a', 'b'): 3.0, ('a', 'c'): 4.0, ('b', 'c'): 5.0}
PLACES = {'a': (0.0, 0.0), 'b': (3.0, 0.0), 'c': (0.0, 4.0)}
KEPT = qos.QosHistory.KEEP_LAST, 1, qos.QosReliability.RELIABLE, qos.QosDurability.TRANSIENT_LOCAL
NEVER = qos.QosTime(0, 0)
LATCHED = qos.Qos(*KEPT, NEVER, NEVER, qos.QosLiveliness.AUTOMATIC, NEVER, False)
PARAMETERS = {'robots': ['a', 'b', 'c'], 'max_speed': 0.1}


def write_parameters(folder, **given):
    """Write the parameters of the three robots, or others; return the file."""
    path = folder / 'params.yaml'
    # JSON is YAML.
    path.write_text(json.dumps({'/**': {'ros__parameters': {**PARAMETERS, **given}}}))
    return path


def stamped(message, time_ns, frame_id=''):
    """Return the bytes of a message with a header."""
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(time_ns, 10**9)
    message.header.frame_id = frame_id
    return serialize_message(message)


def time_ns_of(step):
    return START_NS + round(step * PERIOD_NS)


def record_simulation(bag, seconds=20.0, change=lambda topic, message: message, **values):
    """
    Write a bag of a simulated fleet at 10 Hz.

    Each message is received at once: a node may hear of its time after it. `change` may spoil a
    message, or return None to leave it out.
    """
    defaults = {name: spec.default for name, spec in SIMULATION.items()}
    fleet = SimulatedFleet({**defaults, 'path': 'loops', **values})
    recorder = Recorder(bag)
    for step in range(round(seconds * 10)):
        times_s = step / 10, START_NS * 1e-9 + step / 10
        messages = [*fleet.measurements(*times_s), *fleet.odometry_messages(*times_s)]
        for topic, message in [*messages, (SIMULATED_TRUTH[1:], fleet.ground_truth(*times_s))]:
            changed = change(topic, message)
            if changed is not None:
                package = type(changed).__module__.partition('.')[0]
                name = f'{package}/msg/{type(changed).__name__}'
                recorder.write(f'/{topic}', step, serialize_message(changed), name)
    return recorder.close()


class Recorder:
    """Writes a bag; messages on a topic of their own are 0.1 s apart."""

    def __init__(self, path, plugin=StoragePlugin.MCAP):
        self.path = path
        self._writer = Writer(path, version=9, storage_plugin=plugin)
        self._writer.open()
        self._connections = {}

    def add(self, topic, type_name=RANGE, qos=()):
        self._connections[topic] = self._writer.add_connection(
            topic, type_name, typestore=STORE, offered_qos_profiles=list(qos)
        )

    def write(self, topic, step, data, type_name=RANGE):
        if topic not in self._connections:
            self.add(topic, type_name)
        self._writer.write(self._connections[topic], time_ns_of(step), data)

    def write_range(self, topic, step, range_m, stamp_ns=None, frame_id='', **limits):
        """Write a range with the stamp of its step, or with another one."""
        time_ns = time_ns_of(step) if stamp_ns is None else stamp_ns
        self.write(topic, step, stamped(Range(range=range_m, **limits), time_ns, frame_id))

    def write_triangle(self, steps, ranges_m=TRIANGLE):
        for step in steps:
            for (observer, target), range_m in ranges_m.items():
                self.write_range(f'/{observer}/range/{target}', step, range_m)

    def close(self):
        self._writer.close()
        return self.path


def write_triangles(path, *stretches, plugin=StoragePlugin.MCAP):
    """Write a bag of a triangle by stretches of steps, the later ones with ranges of their own."""
    recorder = Recorder(path, plugin)
    for steps, *ranges_m in stretches:
        recorder.write_triangle(steps, *ranges_m)
    return recorder.close()


class Localize:
    """
    Localizes bags with parameters.

    A call returns the exit code and the report, where there is one; `output` is the last bag.
    """

    def __init__(self, folder):
        self.folder, self.output, self.n_runs = folder, None, 0

    def __call__(self, bags, *arguments, **parameters):
        bags = bags if isinstance(bags, list) else [bags]
        run = self.folder / f'run_{self.n_runs}'
        self.n_runs += 1
        run.mkdir()
        given = {name.replace('__', '.'): value for name, value in parameters.items()}
        params = write_parameters(run, **given)
        report, self.output = run / 'report.json', run / 'out'
        paths = ('-o', self.output, '--params', params, '--report', report)
        code = localize_bag([str(text) for text in (*bags, *paths, *arguments)])
        return code, json.loads(report.read_text()) if report.exists() else None


def read(path, topic):
    """Return the log times in ns and the values of the messages on a topic."""
    with AnyReader([path], default_typestore=STORE) as reader:
        connections = [c for c in reader.connections if c.topic == topic]
        assert connections, topic
        value_of = adapter_for(connections[0].msgtype).from_message
        messages = [
            (time_ns, value_of(reader.deserialize(data, connection.msgtype)))
            for connection, time_ns, data in reader.messages(connections)
        ]
    return [time_ns for time_ns, _ in messages], [value for _, value in messages]


def counts(path):
    with AnyReader([path], default_typestore=STORE) as reader:
        return {name: info.msgcount for name, info in reader.topics.items()}


def places_at(stamp_s):
    """Return the true places of the triangle in a frame of their own, those of any time."""
    return {'a': (7.0, 5.0), 'b': (10.0, 5.0), 'c': (7.0, 9.0)}


def write_table(path, places=places_at):
    """Write the ground truth of 2.1 s as a table; the places are a function of the stamp."""
    rows = [
        f'{START_NS * 1e-9 + stamp_s:.3f},{robot},{x},{y}'
        for stamp_s in np.arange(0.0, 2.2, 0.1)
        for robot, (x, y) in places(stamp_s).items()
    ]
    path.write_text('\n'.join(['stamp,robot,x,y', *rows]) + '\n')
    return path
