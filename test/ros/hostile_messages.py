# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Serialized messages for a fleet at rest: true ones, useless ones, and anything at all."""

from dataclasses import dataclass, field
import math
from random import Random

from geometry_msgs.msg import Vector3Stamped
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.serialization import serialize_message
from sensor_msgs.msg import PointCloud2, PointField, Range

from dg_localization import SolverOptions
from dg_localization.fleet import Anchor, FleetConfig, LinkKey, LinkKind
from dg_localization.ros.interface.links import Link

RANGE, BEARING = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY, CLOUD = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/PointCloud2'
STRANGER = 'strånger'

NAN, INF = math.nan, math.inf
FLOATS = (
    *(NAN, INF, -INF, 0.0, -0.0, 5e-324, -5e-324, 1e-300, 1e-45, 1e-30, 1e-7, -1.0, 1.0),
    *(1.0 + 2**-52, 1e6, 1e16, 1e30, 1e154, 1e155, 1e300, 1.7976931348623157e308, -1.7e308),
)
SINGLES = (
    *(NAN, INF, -INF, 0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e-7, -1.0, 1.0, 1e6, 1e16, 1e19, 1e30),
    *(3.4028234e38, -3.4028234e38),
)
SECONDS = (0, 1, -1, 2**31 - 1, -(2**31))
NANOSECONDS = (0, 1, 999_999_999, 10**9, 2**32 - 1)
COUNTS = (0, 1, 2, 3, 7, 2**16, 2**31, 2**32 - 1)
TEXTS = ('', 'r0', 'map', '/', '../../etc/passwd', '{observer}', '%s %n', 'röbot', '🤖', '\u202e')
TEXTS += ('a\tb\nc', '\x01', 'x' * 500, '\ud7ff', '\ufeff', 'é' * 200)
NAMES = ('peer', 'range', 'x', 'y', 'z', '', 'peer ', 'Peer', 'intensity', '🤖')
NAMES += ('reference', 'range_difference')


@dataclass
class HostileFleet:
    """
    A fleet at rest, and a source of messages about it.

    `now_s` is the clock of the fleet. True readings lie within the bounds of `config`.
    """

    random: Random
    config: FleetConfig
    positions_m: np.ndarray
    yaws_rad: np.ndarray
    now_s: float
    links: list = field(default_factory=list)
    newest_odometry_s: dict = field(default_factory=dict)

    @classmethod
    def make(cls, seed):
        random = Random(seed)
        q = random.choice((2, 2, 3))
        n_robots, n_anchors = random.randint(2, 5), random.choice((0, 0, 3))
        robots = tuple(f'r{i}' for i in range(n_robots))
        positions = np.array(
            [[random.uniform(-8, 8) for _ in range(q)] for _ in range(n_robots + n_anchors)]
        )
        anchors = {f'a{k}': Anchor(tuple(positions[n_robots + k])) for k in range(n_anchors)}
        config = FleetConfig(
            robots=robots,
            dimension=q,
            anchors=anchors,
            max_age_s=1.0,
            max_speed_m_s=random.choice((0.0, 0.1)),
            max_turn_rate_rad_s=random.choice((0.0, 0.1)),
            min_separation_m=0.01,
            max_hypotheses=16,
            max_conflict_solves=4,
            max_conflict_seconds=0.2,
            solver=SolverOptions(resolution=0.5, max_boxes=8, max_seconds=0.2),
        )
        yaws = np.array([random.uniform(-3, 3) for _ in positions])
        now_s = random.choice((5.0, 1.7e9))
        fleet = cls(random, config, positions, yaws, now_s)
        points = config.points
        for robot in robots:
            fleet.links.append(Link(f'/{robot}/odom', ODOMETRY, _key(LinkKind.ODOMETRY, robot)))
            fleet.links.append(Link(f'/{robot}/peers', CLOUD, _key(LinkKind.PEERS, robot)))
            for target in points:
                if target != robot:
                    for kind, type_name in ((LinkKind.RANGE, RANGE), (LinkKind.BEARING, BEARING)):
                        key = _key(kind, robot, target)
                        fleet.links.append(Link(f'/{robot}/{kind}/{target}', type_name, key))
        return fleet

    @property
    def strangers(self):
        """Links from, or to, a point that is not of the fleet."""
        robot = self.config.robots[0]
        return [
            Link('/s/range', RANGE, _key(LinkKind.RANGE, STRANGER, robot)),
            Link('/s/bearing', BEARING, _key(LinkKind.BEARING, robot, STRANGER)),
            Link('/s/odom', ODOMETRY, _key(LinkKind.ODOMETRY, STRANGER)),
            Link('/s/peers', CLOUD, _key(LinkKind.PEERS, STRANGER)),
        ]

    def pass_time(self):
        """Let some time pass; now and then so much that everything becomes too old."""
        self.now_s += self.random.choice((0.0, 1e-6, 0.001, 0.01, 0.01, 0.05, 0.05, 0.3))
        if self.random.random() < 0.001:
            self.now_s += 3.0

    # True readings.

    def true_message(self, link):
        """Return a message that obeys all bounds."""
        link = self._within_fleet(link)
        message = _CLASSES[link.type_name]()
        self._stamp(message, self.now_s - self.random.choice((0.0, 0.01, 0.1, 0.5)))
        getattr(self, f'_fill_{link.key.kind.value}')(message, link.key)
        return message

    def _within_fleet(self, link):
        """Return a link of the fleet: a stranger sends what a robot would."""
        if STRANGER in (link.key.observer, link.key.target):
            return self.random.choice([x for x in self.links if x.type_name == link.type_name])
        return link

    def _stamp(self, message, stamp_s):
        sec, nanosec = divmod(round(stamp_s * 1e9), 1_000_000_000)
        message.header.stamp.sec, message.header.stamp.nanosec = sec, nanosec

    def _index(self, name):
        return self.config.points.index(name)

    def _gap(self, observer, target):
        gap = np.zeros(3)
        q = self.config.dimension
        gap[:q] = self.positions_m[self._index(target)] - self.positions_m[self._index(observer)]
        return gap

    def _true_range_m(self, observer, target):
        distance_m = float(np.linalg.norm(self._gap(observer, target)))
        return distance_m * self.random.uniform(0.975, 1.025)

    def _true_ray(self, observer, target):
        gap = self._gap(observer, target)
        turn = self.random.uniform(-0.045, 0.045) - self.yaws_rad[self._index(observer)]
        c, s = math.cos(turn), math.sin(turn)
        ray = np.array([c * gap[0] - s * gap[1], s * gap[0] + c * gap[1], gap[2]])
        return ray * self.random.choice((1.0, 1e-3, 1e6)) / np.linalg.norm(gap)

    def _fill_range(self, message, key):
        message.range = self._true_range_m(key.observer, key.target)
        if self.random.random() < 0.5:
            message.min_range, message.max_range = 0.0, 100.0

    def _fill_bearing(self, message, key):
        x, y, z = self._true_ray(key.observer, key.target).tolist()
        message.vector.x, message.vector.y, message.vector.z = x, y, z

    def _fill_odometry(self, message, key):
        robot = key.observer
        newest_s = self.newest_odometry_s.get(robot, -INF)
        self.newest_odometry_s[robot] = stamp_s = max(self.now_s, newest_s + 1e-6)
        self._stamp(message, stamp_s)
        half = self.yaws_rad[self._index(robot)] / 2.0
        pose = message.pose.pose
        pose.position.x, pose.position.y = 3.0, -4.0
        pose.orientation.z, pose.orientation.w = math.sin(half), math.cos(half)

    def _fill_peers(self, message, key):
        others = [p for p in self.config.points if p != key.observer]
        rows = [
            (
                self._index(name),
                self._true_range_m(key.observer, name),
                *self._true_ray(key.observer, name).tolist(),
            )
            for name in self.random.sample(others, self.random.randint(0, len(others)))
        ]
        self._fill_cloud(message, rows)

    def _fill_cloud(self, message, rows):
        order = '>' if self.random.random() < 0.2 else '<'
        table = np.array(rows, dtype=_columns(order)) if rows else np.empty(0, _columns(order))
        message.height, message.width = 1, len(rows)
        message.is_bigendian = order == '>'
        message.point_step = table.dtype.itemsize
        message.row_step = message.point_step * len(rows)
        message.fields = [
            PointField(name=name, offset=offset, datatype=datatype, count=1)
            for name, offset, datatype in (
                *(('peer', 0, 6), ('range', 4, 8)),
                *(('x', 12, 8), ('y', 20, 8), ('z', 28, 8)),
            )
        ]
        message.data = table.tobytes()

    # Messages that say nothing.

    def useless_message(self, link):
        """Return a message not one reading of which may be used."""
        link = self._within_fleet(link)
        message = self.true_message(link)
        if self.random.random() < 0.3:
            self._spoil_stamp(message)
        else:
            getattr(self, f'_spoil_{link.key.kind.value}')(message, link.key)
        return message

    def _spoil_stamp(self, message):
        stamp = message.header.stamp
        how = self.random.randrange(4)
        if how == 0:
            stamp.sec, stamp.nanosec = 0, 0
        elif how == 1:
            self._stamp(message, self.now_s + self.random.choice((0.2, 5.0, 1e8)))
        elif how == 2:
            self._stamp(message, self.now_s - self.random.choice((1.1, 4.0)))
        else:
            stamp.sec = self.random.choice((-1, -(2**31), 2**31 - 1))

    def _spoil_range(self, message, key):
        wrong = self.random.choice((NAN, -1.0, -1e-45, INF, -INF, 101.0, 3e38, 0.01))
        message.range, message.min_range, message.max_range = wrong, 0.0, 100.0
        if wrong == 0.01:
            message.min_range = 0.02

    def _spoil_bearing(self, message, key):
        vector = message.vector
        if self.random.random() < 0.5:
            setattr(vector, self.random.choice('xyz'), self.random.choice((NAN, INF, -INF)))
        else:
            vector.x, vector.y, vector.z = 0.0, -0.0, 0.0
            if self.config.dimension == 2:
                vector.z = self.random.choice((1.0, -1e300, 5e-324))

    def _spoil_odometry(self, message, key):
        pose = message.pose.pose
        how = self.random.randrange(4)
        if how == 0:
            setattr(pose.position, self.random.choice('xyz'), self.random.choice((NAN, INF, -INF)))
        elif how == 1:
            wrong = self.random.choice((NAN, INF, -2.0, 1e200, 1.7e308))
            setattr(pose.orientation, self.random.choice('xyzw'), wrong)
        elif how == 2:
            pose.orientation.z = pose.orientation.w = 0.0
        else:
            pose.orientation.z, pose.orientation.w = 0.9, 0.0

    def _spoil_peers(self, message, key):
        own, n_points = self._index(key.observer), len(self.config.points)
        other = (own + 1) % n_points
        nothing, ray = (NAN, NAN, NAN), (1.0, 0.0, 0.0)
        how, usual = self.random.randrange(8), [(other, 1.0, *ray)]
        useless = [
            [(own, 1.0, *ray)] * self.random.randint(1, 2 * n_points),
            [(self.random.choice((n_points, 2**31, 2**32 - 1)), 1.0, *ray)],
            [(other, NAN, *nothing), (other, -1.0, *nothing)],
            [(other, INF, NAN, 1.0, INF), (other, -INF, 0.0, 0.0, -0.0)],
            usual * (2 * n_points + 1),
        ]
        self._fill_cloud(message, useless[how] if how < len(useless) else usual)
        if how == 5:
            message.fields = message.fields[: self.random.randrange(2)]
        elif how == 6:
            message.data = message.data[: self.random.randrange(36)]
        elif how == 7:
            self.random.choice(message.fields).datatype = self.random.choice((0, 9, 255))

    # Anything at all.

    def any_message(self, link):
        """Return the bytes of a message some of whose fields, or bytes, are anything."""
        choose = self.random.random()
        message = self.true_message(link) if choose < 0.8 else self.useless_message(link)
        for _ in range(self.random.choice((0, 1, 1, 1, 2, 5))):
            self._set_anything(message)
        data = serialized(message)
        return self._damaged(data) if self.random.random() < 0.3 else data

    def _set_anything(self, message):
        """Set one field, however deep, to any value that its type allows."""
        name = self.random.choice(list(message.get_fields_and_field_types()))
        kind = message.get_fields_and_field_types()[name]
        if kind in _VALUES:
            setattr(message, name, self.random.choice(_VALUES[kind]))
        elif kind.startswith('double['):
            setattr(message, name, [self.random.choice(FLOATS)] * 36)
        elif kind == 'sequence<uint8>':
            self._set_data(message)
        elif kind.startswith('sequence<'):
            self._set_fields(message)
        else:
            self._set_anything(getattr(message, name))

    def _set_data(self, cloud):
        """Put hostile numbers into the rows of a cloud, or change their length."""
        data = bytearray(cloud.data)
        if len(data) >= 36 and self.random.random() < 0.7:
            dtype = np.dtype(_columns('>' if cloud.is_bigendian else '<'))
            table = np.frombuffer(data[: len(data) // 36 * 36], dtype).copy()
            column = self.random.choice(dtype.names)
            values = COUNTS if column == 'peer' else FLOATS
            table[column][self.random.randrange(len(table))] = self.random.choice(values)
            data = table.tobytes()
        else:
            data = bytes(self.random.choice((0, 1, 35, 36, 37, 300, 5_000)))
        cloud.data = data

    def _set_fields(self, cloud):
        """Drop, repeat or change a column of a cloud."""
        fields = list(cloud.fields)
        self.random.shuffle(fields)
        if fields and self.random.random() < 0.5:
            self._set_anything(fields[0])
            fields[0].name = self.random.choice((fields[0].name, self.random.choice(NAMES)))
        else:
            fields = fields * self.random.choice((0, 1, 2, 40))
        cloud.fields = fields[: self.random.choice((1, 3, 5, 500))]

    def _damaged(self, data):
        """Return bytes that are cut, lengthened, or wrong in some places."""
        data = bytearray(data)
        how = self.random.randrange(4)
        if how == 0:
            return bytes(data[: self.random.randrange(len(data))])
        if how == 1:
            return bytes(data) + self.random.randbytes(self.random.choice((1, 4, 100)))
        if how == 2:
            return self.random.randbytes(self.random.choice((0, 1, 3, 4, 8, 60, 200)))
        for _ in range(self.random.choice((1, 1, 3, 10))):
            data[self.random.randrange(len(data))] = self.random.choice((0, 1, 127, 128, 255))
        return bytes(data)


_CLASSES = {RANGE: Range, BEARING: Vector3Stamped, ODOMETRY: Odometry, CLOUD: PointCloud2}
_VALUES = {
    'double': FLOATS,
    'float': SINGLES,
    'int32': SECONDS,
    'uint32': (*COUNTS, *NANOSECONDS),
    'uint8': (0, 1, 5, 6, 7, 8, 9, 255),
    'boolean': (False, True),
    'string': TEXTS,
}


def serialized(message):
    """Return the bytes of a message."""
    return bytes(serialize_message(message))


def _columns(order):
    return [('peer', f'{order}u4'), *((name, f'{order}f8') for name in ('range', 'x', 'y', 'z'))]


def _key(kind, observer, target=''):
    return LinkKey(kind, observer, target)
