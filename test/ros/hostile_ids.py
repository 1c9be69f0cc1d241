# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Messages with the ids of drivers for a fleet at rest: true, useless, and anything at all."""

import math

import numpy as np

from dg_localization.fleet import LinkKey, LinkKind
from dg_localization.ros.interface.links import ANY_OBSERVER, Link
from msg_adapters import CameraReading, IdentifiedReading, PixelReading, adapter_for

RADIOS, FRAMES = 'uwb_ros/msg/RangeStamped', 'nlink_parser/msg/LinktrackNodeframe2'
TAGS, BOXES_2D = 'apriltag_msgs/msg/AprilTagDetectionArray', 'vision_msgs/msg/Detection2DArray'
BOXES_3D = 'vision_msgs/msg/Detection3DArray'
CAMERA = CameraReading(0.0, 'eye_optical', (400.0, 400.0), (320.0, 240.0))
NAMED_BY = {
    RADIOS: '{}',
    FRAMES: '1:{}',
    TAGS: 'tag36h11:{}',
    BOXES_2D: 'class_{}',
    BOXES_3D: 'class_{}',
}
PATTERNS = tuple(dict.fromkeys(NAMED_BY.values()))
IGNORED, STRANGER = 77, 88

ANYTHING = (
    *(None, '', 'x', b'y', True, -1, 0, 1, 255, 2**31, 2**64, 10**400, -0.0, 1e-320, 1e308),
    *(math.nan, math.inf, -math.inf, 3 + 4j, [], [None], {}, (1.0, 2.0), np.arange(3.0), object()),
)


class IdFleet:
    """
    Messages that name observers and targets by ids, about the fleet of another source.

    Parameters
    ----------
    fleet : HostileFleet

    """

    def __init__(self, fleet):
        self.fleet = fleet
        self.random = fleet.random
        points = fleet.config.points
        self.ids = {p.format(k): name for p in PATTERNS for k, name in enumerate(points)}
        self.ids |= {pattern.format(IGNORED): '-' for pattern in PATTERNS}
        self.links = [
            Link(f'/{type_name}', type_name, LinkKey(LinkKind.PEERS, ANY_OBSERVER, ''))
            for type_name in (RADIOS, FRAMES)
        ]
        self.links += [
            Link(f'/{robot}/{type_name}', type_name, LinkKey(LinkKind.PEERS, robot, ''))
            for type_name in (TAGS, BOXES_2D, BOXES_3D)
            for robot in fleet.config.robots
        ]
        self.cameras = [
            Link(f'/{robot}/camera_info', 'sensor_msgs/msg/CameraInfo', key)
            for robot in fleet.config.robots
            for key in [LinkKey(LinkKind.CAMERA, robot, '')]
        ]

    def camera_message(self):
        return adapter_for('sensor_msgs/msg/CameraInfo').to_message(CAMERA)

    def true_message(self, link):
        """Return a message that obeys all bounds; of cameras, what lies before them."""
        return self._message(link, self._true_reading(link))

    def useless_message(self, link):
        """Return a message not one reading of which may be used."""
        reading = self._true_reading(link)
        name, count = NAMED_BY[link.type_name], len(reading.target_ids)
        how = self.random.choice(('targets', 'stamp', 'values', 'nobody', 'observer'))
        if how == 'observer' and isinstance(reading, IdentifiedReading) and reading.observer_id:
            wrong = name.format(self.random.choice((IGNORED, STRANGER)))
            return self._message(link, replaced(reading, observer_id=wrong))
        if how == 'stamp':
            late_s = self.fleet.now_s + self.random.choice((-4.0, 5.0, -self.fleet.now_s))
            return self._message(link, replaced(reading, stamp_s=late_s))
        if how == 'values':
            return self._message(link, self._without_values(reading))
        # A robot does not measure itself; the observer of cameras is that of the link.
        own = self._observer_of(link, reading)
        others = (IGNORED,) if how == 'nobody' else (STRANGER, own)
        ids = tuple(name.format(self.random.choice(others)) for _ in range(count))
        return self._message(link, replaced(reading, target_ids=ids))

    def any_message(self, link):
        """Return a message some of whose fields are anything, of any type."""
        useless = self.random.random() < 0.2
        message = self.useless_message(link) if useless else self.true_message(link)
        for _ in range(self.random.choice((1, 1, 2, 5))):
            self._set_anything(message)
        return message

    def _true_reading(self, link):
        fleet, random = self.fleet, self.random
        points, name = fleet.config.points, NAMED_BY[link.type_name]
        stamp_s = fleet.now_s - random.choice((0.0, 0.01, 0.1, 0.5))
        robot = link.key.observer
        if robot == ANY_OBSERVER:
            robot = random.choice(fleet.config.robots)
        others = [point for point in points if point != robot]
        n_others = 1 if link.type_name == RADIOS else random.randint(1, len(others))
        seen = random.sample(others, n_others)
        ids = tuple(name.format(points.index(point)) for point in seen)
        if link.type_name in (RADIOS, FRAMES):
            ranges_m = np.array([fleet._true_range_m(robot, point) for point in seen])
            return IdentifiedReading(stamp_s, name.format(points.index(robot)), ids, ranges_m)
        rays = np.array([fleet._true_ray(robot, point) for point in seen])
        if link.type_name == BOXES_3D:
            nothing = np.full(len(seen), math.nan)
            return IdentifiedReading(stamp_s, '', ids, nothing, rays, 'base_link')
        # A camera sees what is before it.
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        front = rays[:, 0] > 0.05
        pixels = 400.0 * -rays[front, 1:] / rays[front, :1] + (320.0, 240.0)
        kept = tuple(one for one, is_seen in zip(ids, front, strict=True) if is_seen)
        return PixelReading(stamp_s, kept, pixels, CAMERA.frame_id)

    def _without_values(self, reading):
        wrong = self.random.choice((math.nan, math.inf, -math.inf))
        if isinstance(reading, PixelReading):
            return replaced(reading, pixels_xy=np.full(reading.pixels_xy.shape, wrong))
        if reading.observer_id:
            wrong = self.random.choice((wrong, -1.0))
            return replaced(reading, ranges_m=np.full(reading.ranges_m.shape, wrong))
        wrong = self.random.choice((wrong, 0.0))
        return replaced(reading, rays_xyz=np.full(reading.rays_xyz.shape, wrong))

    def _observer_of(self, link, reading):
        points = self.fleet.config.points
        if link.key.observer != ANY_OBSERVER:
            return points.index(link.key.observer)
        return points.index(self.ids[reading.observer_id])

    def _message(self, link, reading):
        return adapter_for(link.type_name).to_message(reading)

    def _set_anything(self, message):
        """Set one field, however deep, to anything."""
        for _ in range(20):
            name = self.random.choice(list(fields_of(message)))
            value = getattr(message, name)
            if isinstance(value, list) and value and self.random.random() < 0.8:
                value = self.random.choice(value)
            if list(fields_of(value)) and self.random.random() < 0.9:
                message = value
                continue
            many = [getattr(message, name)] * self.random.choice((0, 2, 50))
            setattr(message, name, self.random.choice((*ANYTHING, many)))
            return


def fields_of(message):
    """Return the names of the fields of a message or of a part of one."""
    return getattr(type(message), '__slots__', None) or getattr(message, '__dict__', ())


def replaced(reading, **values):
    """Return a reading with other values, without a check."""
    other = object.__new__(type(reading))
    for name, value in {**vars(reading), **values}.items():
        object.__setattr__(other, name, value)
    return other
