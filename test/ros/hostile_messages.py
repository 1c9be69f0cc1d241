# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages for a fleet at rest: true ones, useless ones, and anything at all."""

from dataclasses import dataclass, field
import math
from random import Random
import struct

import numpy as np

from dg_localization import SolverOptions
from dg_localization.fleet import Anchor, FleetConfig, LinkKey, LinkKind
from dg_localization.fleet.rotations import quaternion_of_yaw
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from msg_adapters import (
    BearingReading,
    CameraReading,
    IdentifiedReading,
    OdometryReading,
    PeersReading,
    PixelReading,
    RangeReading,
    adapter_for,
)

RANGE, BEARING = 'sensor_msgs/msg/Range', 'geometry_msgs/msg/Vector3Stamped'
ODOMETRY, CLOUD = 'nav_msgs/msg/Odometry', 'sensor_msgs/msg/PointCloud2'
RADIOS, FRAMES = 'uwb_ros/msg/RangeStamped', 'nlink_parser/msg/LinktrackNodeframe2'
TAGS, BOXES_2D = 'apriltag_msgs/msg/AprilTagDetectionArray', 'vision_msgs/msg/Detection2DArray'
BOXES_3D, CAMERA_INFO = 'vision_msgs/msg/Detection3DArray', 'sensor_msgs/msg/CameraInfo'
# How messages write the number of a robot or an anchor.
IDS = {RADIOS: '{}', FRAMES: '1:{}', TAGS: 'tag36h11:{}', BOXES_2D: 'n_{}', BOXES_3D: 'n_{}'}
CAMERA = CameraReading(0.0, 'eye_optical', (400.0, 400.0), (320.0, 240.0))
# A name and a number that are not of the fleet, and a number that it ignores.
STRANGER, STRANGE_NUMBER, IGNORED = 'strånger', 88, 77

NAN, INF = math.nan, math.inf
NOT_FINITE, AHEAD = (NAN, INF, -INF), (1.0, 0.0, 0.0)
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
TEXTS += ('a\tb\nc', '\x01', 'x' * 500, '\ud7ff', '\ufeff', 'é' * 200, 'reference', 'peer', 'x')
ANYTHING = (
    *(None, '', 'x', b'y', True, -1, 0, 1, 255, 2**31, 2**64, 10**400, -0.0, 1e-320, 1e308),
    *(NAN, INF, -INF, 3 + 4j, [], [None], {}, (1.0, 2.0), np.arange(3.0), object()),
)
# What a field of a message of an installed package may hold, by its type.
VALUES = {
    'double': FLOATS,
    'float': SINGLES,
    'int32': SECONDS,
    'uint32': (*COUNTS, *NANOSECONDS),
    'uint8': (0, 1, 5, 6, 7, 8, 9, 255),
    'boolean': (False, True),
    'string': TEXTS,
}


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
        return cls(random, config, positions, yaws, random.choice((5.0, 1.7e9)))

    def __post_init__(self):
        """Name the inputs of the fleet, those of strangers, and the cameras."""
        points, robots = self.config.points, self.config.robots
        self.ids = {text.format(k): p for text in IDS.values() for k, p in enumerate(points)}
        self.ids |= {text.format(IGNORED): '-' for text in IDS.values()}
        self.links = [_link(kind, LinkKind.PEERS, ANY_OBSERVER) for kind in (RADIOS, FRAMES)]
        for robot in robots:
            self.links.append(_link(ODOMETRY, LinkKind.ODOMETRY, robot))
            for kind in (CLOUD, TAGS, BOXES_2D, BOXES_3D):
                self.links.append(_link(kind, LinkKind.PEERS, robot))
            for target in (point for point in points if point != robot):
                self.links.append(_link(RANGE, LinkKind.RANGE, robot, target))
                self.links.append(_link(BEARING, LinkKind.BEARING, robot, target))
        self.cameras = [_link(CAMERA_INFO, LinkKind.CAMERA, robot) for robot in robots]
        self.strangers = [
            _link(RANGE, LinkKind.RANGE, STRANGER, robots[0]),
            _link(BEARING, LinkKind.BEARING, robots[0], STRANGER),
            _link(ODOMETRY, LinkKind.ODOMETRY, STRANGER),
            _link(CLOUD, LinkKind.PEERS, STRANGER),
        ]

    def pass_time(self):
        """Let some time pass; now and then so much that everything becomes too old."""
        self.now_s += self.random.choice((0.0, 1e-6, 0.001, 0.01, 0.01, 0.05, 0.05, 0.3))
        if self.random.random() < 0.001:
            self.now_s += 3.0

    # True readings.

    def true_message(self, link):
        """Return a message that obeys all bounds; of cameras, what lies before them."""
        return adapter_for(link.type_name).to_message(self._true_reading(*self._sender(link)))

    def _sender(self, link):
        """Return a link of the fleet and its robot: a stranger sends what a robot would."""
        if STRANGER in (link.key.observer, link.key.target):
            link = self.random.choice([x for x in self.links if x.type_name == link.type_name])
        if link.key.observer == ANY_OBSERVER:
            return link, self.random.choice(self.config.robots)
        return link, link.key.observer

    def _true_reading(self, link, robot):
        random, points = self.random, self.config.points
        stamp_s = self.now_s - random.choice((0.0, 0.01, 0.1, 0.5))
        match link.key.kind:
            case LinkKind.CAMERA:
                return CAMERA
            case LinkKind.RANGE:
                limits_m = random.choice(((None, None), (0.0, 100.0)))
                return RangeReading(stamp_s, self._range_m(robot, link.key.target), *limits_m)
            case LinkKind.BEARING:
                return BearingReading(stamp_s, self._ray(robot, link.key.target))
            case LinkKind.ODOMETRY:
                stamp_s = max(self.now_s, self.newest_odometry_s.get(robot, -INF) + 1e-6)
                self.newest_odometry_s[robot] = stamp_s
                orientation = quaternion_of_yaw(self.yaws_rad[points.index(robot)])
                return OdometryReading(stamp_s, np.array([3.0, -4.0, 0.0]), orientation)
        others = [point for point in points if point != robot]
        n_others = 1 if link.type_name == RADIOS else random.randint(1, len(others))
        seen = random.sample(others, n_others)
        ranges_m = np.array([self._range_m(robot, point) for point in seen])
        rays = np.array([self._ray(robot, point) for point in seen])
        numbers = [points.index(point) for point in seen]
        if link.type_name == CLOUD:
            return PeersReading(stamp_s, np.array(numbers), ranges_m, rays)
        text = IDS[link.type_name]
        ids = tuple(map(text.format, numbers))
        if link.type_name in (RADIOS, FRAMES):
            return IdentifiedReading(stamp_s, text.format(points.index(robot)), ids, ranges_m)
        if link.type_name == BOXES_3D:
            nothing = np.full(len(seen), NAN)
            return IdentifiedReading(stamp_s, '', ids, nothing, rays, 'base_link')
        # A camera sees what is before it.
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        front = rays[:, 0] > 0.05
        pixels = 400.0 * -rays[front, 1:] / rays[front, :1] + (320.0, 240.0)
        kept = tuple(one for one, is_seen in zip(ids, front, strict=True) if is_seen)
        return PixelReading(stamp_s, kept, pixels, CAMERA.frame_id)

    def _gap(self, observer, target):
        points, gap = self.config.points, np.zeros(3)
        ends_m = self.positions_m[[points.index(target), points.index(observer)]]
        gap[: self.config.dimension] = ends_m[0] - ends_m[1]
        return gap

    def _range_m(self, observer, target):
        distance_m = float(np.linalg.norm(self._gap(observer, target)))
        return distance_m * self.random.uniform(0.975, 1.025)

    def _ray(self, observer, target):
        gap = self._gap(observer, target)
        yaw_rad = self.yaws_rad[self.config.points.index(observer)]
        turn = self.random.uniform(-0.045, 0.045) - yaw_rad
        c, s = math.cos(turn), math.sin(turn)
        ray = np.array([c * gap[0] - s * gap[1], s * gap[0] + c * gap[1], gap[2]])
        return ray * self.random.choice((1.0, 1e-3, 1e6)) / np.linalg.norm(gap)

    # Messages that say nothing.

    def useless_message(self, link):
        """Return a message not one reading of which may be used."""
        link, robot = self._sender(link)
        reading = self._true_reading(link, robot)
        to_message = adapter_for(link.type_name).to_message
        if link.type_name == CLOUD and self.random.random() < 0.3:
            return self._broken(to_message(reading))
        if self.random.random() < 0.3:
            late_s = self.random.choice((0.2, 5.0, 1e8, -1.1, -4.0))
            stamps_s = 0.0, self.now_s + late_s, -1.0, -(2.0**31), 2.0**31 - 1.0
            return to_message(replaced(reading, stamp_s=self.random.choice(stamps_s)))
        return to_message(replaced(reading, **self._useless_values(link, robot, reading)))

    def _broken(self, cloud):
        """Return a cloud without columns or bytes that it needs, or with a type that is none."""
        how = self.random.randrange(3)
        if how == 0:
            cloud.fields = cloud.fields[: self.random.randrange(2)]
        elif how == 1:
            cloud.data = cloud.data[: self.random.randrange(cloud.point_step)]
        else:
            self.random.choice(cloud.fields).datatype = self.random.choice((0, 9, 255))
        return cloud

    def _useless_values(self, link, robot, reading):
        """Return values for some fields of a reading with which it says nothing."""
        random, not_finite = self.random, self.random.choice(NOT_FINITE)
        points = self.config.points
        own, n_points = points.index(robot), len(points)
        match reading:
            case RangeReading():
                range_m = random.choice((*NOT_FINITE, -1.0, -1e-45, 101.0, 3e38, 0.01))
                least_m = 0.02 if range_m == 0.01 else 0.0
                return {'range_m': range_m, 'min_range_m': least_m, 'max_range_m': 100.0}
            case BearingReading():
                up = random.choice((0.0, 1.0, -1e300, 5e-324)) if self.config.dimension == 2 else 0
                wrong = _with_one(random, reading.ray_xyz, not_finite)
                return {'ray_xyz': random.choice((wrong, np.array([0.0, -0.0, up])))}
            case OdometryReading():
                number = random.choice((NAN, INF, -2.0, 1e200, 1.7e308))
                place_m = _with_one(random, reading.position_xyz, not_finite)
                turned = _with_one(random, reading.orientation_xyzw, number)
                wrong = random.choice((turned, np.zeros(4), np.array([0.0, 0.0, 0.9, 0.0])))
                return random.choice(({'position_xyz': place_m}, {'orientation_xyzw': wrong}))
            case PeersReading():
                other, nothing = (own + 1) % n_points, (NAN, NAN, NAN)
                half_infinite = random.choice(((NAN, 1.0, INF), (0.0, 0.0, -0.0)))
                peers, range_m, ray = random.choice(
                    (
                        ([own] * random.randint(1, 2 * n_points), 1.0, AHEAD),
                        ([random.choice((n_points, 2**31, 2**32 - 1))], 1.0, AHEAD),
                        ([other] * 2, random.choice((NAN, -1.0)), nothing),
                        ([other] * 2, random.choice((INF, -INF)), half_infinite),
                        ([other] * (2 * n_points + 1), 1.0, AHEAD),
                    )
                )
                rays, ranges_m = np.tile(ray, (len(peers), 1)), np.full(len(peers), range_m)
                return {'peers': np.array(peers), 'ranges_m': ranges_m, 'rays_xyz': rays}
            case PixelReading():
                values = {'pixels_xy': np.full(reading.pixels_xy.shape, not_finite)}
            case IdentifiedReading(observer_id=''):
                wrong = random.choice((not_finite, 0.0))
                values = {'rays_xyz': np.full(reading.rays_xyz.shape, wrong)}
            case IdentifiedReading():
                wrong = random.choice((not_finite, -1.0))
                values = {'ranges_m': np.full(reading.ranges_m.shape, wrong)}
        # A robot does not measure itself.
        text, numbers = IDS[link.type_name], (IGNORED, STRANGE_NUMBER, own)
        ids = tuple(text.format(random.choice(numbers)) for _ in reading.target_ids)
        others = [values, {'target_ids': ids}]
        if link.key.observer == ANY_OBSERVER:
            others.append({'observer_id': text.format(random.choice(numbers[:2]))})
        return random.choice(others)

    # Anything at all.

    def any_message(self, link):
        """Return a message some of whose fields are anything."""
        is_true = self.random.random() < 0.8
        message = self.true_message(link) if is_true else self.useless_message(link)
        for _ in range(self.random.choice((0, 1, 1, 1, 2, 5))):
            self._set_anything(message)
        return message

    def _set_anything(self, message):
        """Set one field, however deep, to anything, or to any value that its type allows."""
        random, kinds = self.random, _fields_of(message)
        name = random.choice(list(kinds))
        kind, value = kinds[name], getattr(message, name)
        part = random.choice(value) if isinstance(value, list) and value else value
        if _fields_of(part) and random.random() < 0.8:
            self._set_anything(part)
        elif kind is None:
            many = [part] * random.choice((0, 2, 50))
            setattr(message, name, random.choice((*ANYTHING, many)))
        elif kind in VALUES:
            setattr(message, name, random.choice(VALUES[kind]))
        elif kind == 'double[36]':
            setattr(message, name, [random.choice(FLOATS)] * 36)
        elif kind == 'sequence<uint8>':
            setattr(message, name, self._any_rows(bytearray(value)))
        elif kind.startswith('sequence<'):
            some = random.sample(value, random.randint(0, len(value)))
            setattr(message, name, some * random.choice((1, 2, 40)))
        else:
            self._set_anything(value)

    def _any_rows(self, data):
        """Return the data of a cloud with a hostile number in it, or of another length."""
        if len(data) < 8 or self.random.random() < 0.3:
            return bytes(self.random.choice((0, 1, 35, 36, 37, 300, 5_000)))
        place = self.random.randrange(0, len(data) - 7, 4)
        code, values = self.random.choice((('<d', FLOATS), ('<I', COUNTS)))
        struct.pack_into(code, data, place, self.random.choice(values))
        return bytes(data)

    def damaged(self, data):
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


def _fields_of(message):
    """Return the fields of a message or a part of one, and their types where these are checked."""
    if hasattr(message, 'get_fields_and_field_types'):
        return message.get_fields_and_field_types()
    names = getattr(type(message), '__slots__', None) or getattr(message, '__dict__', ())
    return dict.fromkeys(names)


def _with_one(random, numbers, wrong):
    """Return an array of numbers with a wrong one in one place."""
    numbers = numbers.copy()
    numbers[random.randrange(len(numbers))] = wrong
    return numbers


def replaced(reading, **values):
    """Return a reading with other values, without a check."""
    other = object.__new__(type(reading))
    for name, value in {**vars(reading), **values}.items():
        object.__setattr__(other, name, value)
    return other


def _link(type_name, kind, observer, target=''):
    topic = f'/{observer}/{type_name}/{target}'
    return Link(topic, type_name, LinkKey(kind, observer, target))
