# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the bytes of messages to the ROS-free `Localizer`.

Any node on the network may send anything, and users may add adapters. So the length of a message
is checked before it is decoded and its number of rows before it is used. Every failure is counted
and never raised.
"""

from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
import math
from types import MappingProxyType
from typing import Any

import numpy as np
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Range

from dg_localization.fleet import InputState, LinkKey, Localizer, Rejection, RejectionReason
from dg_localization.fleet.admission import PeerMeasurement
from dg_localization.ros.interface.identities import Cameras, Identities
from dg_localization.ros.interface.links import Link
from dg_localization.ros.interface.poses import usable_frame_id
from msg_adapters import (
    BearingReading,
    CameraReading,
    ElevationReading,
    IdentifiedReading,
    OdometryReading,
    PeersReading,
    PixelReading,
    RangeReading,
    adapter_for,
)

# A message of one reading has about 100 bytes, one of odometry about 700. Decoding time grows with
# the length: this length takes a few milliseconds in the worst case.
MOST_BYTES = 32_768
# Further bytes per row of peers: all columns in double precision have 36 bytes, plus padding.
MOST_BYTES_PER_ROW = 128
# The range of a peer and the ray to it may be in separate rows.
ROWS_PER_POINT = 2
# Diagnostics may quote a sensor or an unknown node, and are recorded for days.
MOST_CHARACTERS = 300
# The last field of sensor_msgs/Range, in single precision.
VARIANCE_BYTES = 4
# An input has a warning if it rejected most readings over this time.
REJECTING_S = 10.0
# A sensor has a warning only after this many rejected readings or contradictions.
LEAST_OFFENCES = 3
# Readings of a sensor that works are rejected for these reasons, and unknown points have warnings
# of their own.
HARMLESS = {
    RejectionReason.NAN,
    RejectionReason.NOTHING_IN_RANGE,
    RejectionReason.UNKNOWN_ROBOT,
    RejectionReason.SAME_ROBOT,
}


def shortened(text: str) -> str:
    """Return a text cut to a length that people read."""
    return text if len(text) <= MOST_CHARACTERS else f'{text[: MOST_CHARACTERS - 4]} ...'


@dataclass(frozen=True)
class Malformed:
    """The number of unreadable messages of a topic, and the error and time of the last one."""

    count: int
    last: str
    last_s: float = -math.inf


NONE_MALFORMED = Malformed(0, '')


class Intake:
    """
    Passes readings from messages to a localizer, and counts messages that cannot be read.

    Parameters
    ----------
    localizer : Localizer
    use_header_stamp : bool
        Whether the time of a measurement is its header stamp, not its arrival.
    ids : mapping of str to str, optional
        The names of ids in messages.
    is_simulated : bool, optional
        Whether the time comes from /clock, which may arrive after the messages of that time.

    Attributes
    ----------
    malformed : dict of str to Malformed
        The messages that could not be read, by topic.
    bodies : dict of str to str
        The name of the body frame of each robot in its odometry.

    """

    def __init__(
        self,
        localizer: Localizer,
        use_header_stamp: bool,
        ids: Mapping[str, str] = MappingProxyType({}),
        is_simulated: bool = False,
    ) -> None:
        self._localizer = localizer
        self._is_simulated = is_simulated
        self._identities = Identities(ids, localizer.config.points)
        self._cameras = Cameras()
        self._use_header_stamp = use_header_stamp
        self._most_rows = ROWS_PER_POINT * len(localizer.config.points)
        self._most_bytes = MOST_BYTES + MOST_BYTES_PER_ROW * self._most_rows
        self._bounds_of = cache(Link.bounds_within)
        self._counts: deque[tuple[float, dict[LinkKey, tuple[int, int]]]] = deque()
        self.malformed: dict[str, Malformed] = {}
        self.bodies: dict[str, str] = {}

    def take(
        self, link: Link, data: bytes, now_s: float, arrived_s: float | None = None
    ) -> Rejection | None:
        """
        Take one serialized message; it never raises.

        Return the rejection of a readable message; None if it was accepted or unreadable.
        """
        try:
            reading = self._read(link, data)
            arrived_s = now_s if arrived_s is None else arrived_s
            stamp_s = reading.stamp_s if self._use_header_stamp else arrived_s
            # Zero is no stamp, and must stay so.
            if link.stamp_offset_s and stamp_s != 0.0:
                stamp_s += link.stamp_offset_s
            if self._is_simulated and isinstance(stamp_s, float):
                # /clock may arrive after the messages that it dates, so this clock is not wrong.
                if 0.0 < stamp_s - now_s <= self._localizer.config.max_future_s:
                    now_s = stamp_s
            return self._add(link, reading, stamp_s, now_s)
        except Exception as error:
            wrong = shortened(f'{type(error).__name__}: {error}')
            before = self.malformed.get(link.topic, NONE_MALFORMED)
            self.malformed[link.topic] = Malformed(before.count + 1, wrong, now_s)
            return None

    def _read(self, link: Link, data: bytes) -> Any:
        """Return the reading of a message; a wrong message may raise any exception."""
        if len(data) > self._most_bytes:
            raise ValueError(
                f'the message has {len(data)} bytes, for this fleet at most {self._most_bytes} '
                'are read'
            )
        adapter = adapter_for(link.type_name)
        reading = adapter.from_message(_deserialized(data, adapter.message_class()))
        if not isinstance(reading, adapter.value_class):
            raise TypeError(
                f'the adapter of {link.type_name} returned {type(reading).__name__}, '
                f'it must return {adapter.value_class.__name__}'
            )
        if isinstance(reading, PeersReading) and len(reading.peers) > self._most_rows:
            raise ValueError(
                f'the cloud has {len(reading.peers)} points, for this fleet at most '
                f'{self._most_rows} are read'
            )
        return reading

    def _add(self, link: Link, reading: Any, stamp_s: float, now_s: float) -> Rejection | None:
        """Pass a reading to the localizer, or keep the matrix of a camera."""
        localizer, key, when = self._localizer, link.key, (stamp_s, now_s)
        bounds = self._bounds_of(link, localizer.config.sensor_bounds)
        match reading:
            case RangeReading():
                told = reading.min_range_m, reading.max_range_m, reading.variance_m2
                return localizer.add_range(*key.ends, reading.range_m, *when, *told, bounds)
            case BearingReading():
                return localizer.add_bearing(*key.ends, reading.ray_xyz, *when, bounds)
            case ElevationReading():
                return localizer.add_elevation(key.observer, reading.elevation_m, *when, bounds)
            case OdometryReading():
                self.bodies[key.observer] = usable_frame_id(str(reading.child_frame_id))
                pose, frame = (reading.position_xyz, reading.orientation_xyzw), reading.frame_id
                return localizer.add_odometry(key.observer, *pose, *when, usable_frame_id(frame))
            case CameraReading():
                self._cameras.keep(link, reading, now_s)
                return None
            case PixelReading():
                reading = self._cameras.rays(link, reading)
        observer, rows = self._targets(link, reading)
        kept = [row for row, _ in rows]
        rays_xyz, ranges_m = link.turned(reading.rays_xyz[kept]), reading.ranges_m[kept].tolist()
        has_rays = np.any(~np.isnan(rays_xyz), axis=1).tolist()
        # All rows are read before any is taken: a message must not be taken in part.
        readings = list(self._differences(reading)) if isinstance(reading, PeersReading) else []
        has_others = bool(readings)
        for (_, name), range_m, ray_xyz, has_ray in zip(
            rows, ranges_m, rays_xyz, has_rays, strict=True
        ):
            # A row without a reading counts as a range of NaN.
            if not ((has_ray or has_others) and math.isnan(range_m)):
                readings.append((name, range_m))
            if has_ray:
                readings.append((name, ray_xyz))
        return next(iter(localizer.add_peers(observer, readings, *when, bounds)), None)

    def _targets(
        self, link: Link, reading: PeersReading | IdentifiedReading
    ) -> tuple[str, list[tuple[int, str]]]:
        """Return the observer, and the row and the name of each target."""
        if isinstance(reading, PeersReading):
            rows = list(enumerate(map(self._name_of, reading.peers.tolist())))
            if not len(rows) == len(reading.ranges_m) == len(reading.rays_xyz):
                raise ValueError('peers, ranges and rays must be as many')
            return link.key.observer, rows
        observer = self._identities.observer(link, reading.observer_id)
        rows = list(self._identities.targets(reading))
        n_known = sum(name in self._localizer.config.points for _, name in rows)
        if n_known > self._most_rows:
            raise ValueError(
                f'{n_known} robots and anchors were measured, for this fleet at most '
                f'{self._most_rows} are read'
            )
        return observer, rows

    def _differences(self, reading: PeersReading) -> Iterator[PeerMeasurement]:
        """Yield two points and their range difference, for each row that has one."""
        if reading.references is None or reading.differences_m is None:
            return
        columns = (reading.references, reading.peers, reading.differences_m)
        for first, second, difference_m in zip(*(c.tolist() for c in columns), strict=True):
            if not math.isnan(difference_m):
                yield (self._name_of(first), self._name_of(second)), difference_m

    def _name_of(self, peer: int) -> str:
        """Return the name of a peer; unknown ones share a name, since every name is kept."""
        points = self._localizer.config.points
        return points[peer] if 0 <= peer < len(points) else f'peer beyond {len(points) - 1}'

    def forget(self) -> None:
        """Forget unreadable messages; camera matrices are kept."""
        self._counts.clear()
        self.malformed.clear()

    def rejecting(self, now_s: float) -> dict[LinkKey, str]:
        """Return the inputs that rejected most of their recent readings, with the reasons."""
        states = self._localizer.input_states(now_s)
        counts = {}
        for state in states:
            harmful = [n for reason, n in state.rejected.items() if reason not in HARMLESS]
            counts[state.key] = state.accepted, sum(harmful)
        while len(self._counts) > 1 and now_s - self._counts[1][0] > REJECTING_S:
            self._counts.popleft()
        if not self._counts or now_s - self._counts[-1][0] >= 1.0:
            self._counts.append((now_s, counts))
        found = {}
        for state in states:
            before = self._counts[0][1].get(state.key, (0, 0))
            accepted, rejected = (
                new - old for new, old in zip(counts[state.key], before, strict=True)
            )
            if rejected >= LEAST_OFFENCES and rejected > accepted:
                found[state.key] = (
                    f'rejects {rejected} of {accepted + rejected} readings: '
                    f'{state.last_reason_text}'
                )
        return found

    def states(self, now_s: float) -> dict[LinkKey, InputState]:
        """Return the states of all inputs."""
        states = (*self._localizer.input_states(now_s), *self._cameras.states(now_s))
        return {state.key: state for state in states}


def _deserialized(data: bytes, message_class: type) -> Any:
    """Return a message; the error for a `Range` of before Iron says what is missing."""
    try:
        return deserialize_message(data, message_class)
    except Exception:
        if message_class is not Range:
            raise
        deserialize_message(data + bytes(VARIANCE_BYTES), message_class)
        raise ValueError(
            'sensor_msgs/msg/Range without variance, as ROS 2 published it before Iron: update '
            'the driver, or convert the messages'
        ) from None
