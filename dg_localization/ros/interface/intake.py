# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the bytes of messages to the ROS-free `Localizer`.

Whoever is on the network may send anything, and an adapter may belong to somebody else. So a
message is bounded in length before it is decoded, in rows before it is used, and whatever goes
wrong on the way is counted and never raised.
"""

from collections.abc import Iterator, Sequence
import math
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray
from rclpy.serialization import deserialize_message

from dg_localization.fleet import InputState, LinkKey, Localizer, Rejection
from dg_localization.ros.interface.diagnostics import NONE_MALFORMED, Malformed, shortened
from dg_localization.ros.interface.links import Link
from msg_adapters import (
    BearingReading,
    OdometryReading,
    PeersReading,
    RangeReading,
    adapter_for,
)

Reading = RangeReading | BearingReading | OdometryReading | PeersReading

# A message of one reading has some 100 bytes, one of odometry some 700. Decoding takes time that
# grows with the length: this much takes a few milliseconds in the worst case.
MOST_BYTES = 32_768
# More for the peers: a row of all columns in double precision has 36 bytes, and may be padded.
MOST_BYTES_PER_ROW = 128
# The range of a peer and the ray to it may come in a row each.
ROWS_PER_POINT = 2


class Intake:
    """
    Passes readings of messages on to a localizer, and counts messages that cannot be read.

    Parameters
    ----------
    localizer : Localizer
    use_header_stamp : bool
        Whether a measurement's time is its header's, not that of its arrival.

    Attributes
    ----------
    malformed : dict of str to Malformed
        By topic, the messages that could not be read.

    """

    def __init__(self, localizer: Localizer, use_header_stamp: bool) -> None:
        self._localizer = localizer
        self._use_header_stamp = use_header_stamp
        self._most_rows = ROWS_PER_POINT * len(localizer.config.points)
        self._most_bytes = MOST_BYTES + MOST_BYTES_PER_ROW * self._most_rows
        self.malformed: dict[str, Malformed] = {}

    def take(self, link: Link, data: bytes, now_s: float) -> Rejection | None:
        """
        Take one message; it never raises.

        Parameters
        ----------
        link : Link
            The input that it arrived on.
        data : bytes
            The serialized message.
        now_s : float
            When it arrived.

        Returns
        -------
        Rejection or None
            Why a message that could be read was not taken.

        """
        reading = self.read(link, data)
        if reading is None:
            return None
        try:
            stamp_s = reading.stamp_s if self._use_header_stamp else now_s
            return add_reading(self._localizer, link.key, reading, stamp_s, now_s)
        except Exception as error:
            self._count(link, error)
            return None

    def read(self, link: Link, data: bytes) -> Reading | None:
        """Return what a message contains; None, and the message is counted, when it is wrong."""
        try:
            return self._read(link, data)
        except Exception as error:
            self._count(link, error)
            return None

    def _count(self, link: Link, error: Exception) -> None:
        self.malformed[link.topic] = self.malformed.get(link.topic, NONE_MALFORMED).and_one(
            shortened(f'{type(error).__name__}: {error}')
        )

    def _read(self, link: Link, data: bytes) -> Reading:
        """Return what a message contains; it raises whatever is wrong with it."""
        if len(data) > self._most_bytes:
            raise ValueError(
                f'the message has {len(data)} bytes, for this fleet at most {self._most_bytes} '
                'are read'
            )
        adapter = adapter_for(link.type_name)
        reading: Any = adapter.from_message(deserialize_message(data, adapter.message_class()))
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
        return cast(Reading, reading)

    def states(self, now_s: float) -> dict[LinkKey, InputState]:
        """Return what has arrived, by input."""
        return {state.key: state for state in self._localizer.input_states(now_s)}


def add_reading(
    localizer: Localizer, key: LinkKey, reading: Reading, stamp_s: float, now_s: float
) -> Rejection | None:
    """
    Give one reading to a localizer.

    Parameters
    ----------
    localizer : Localizer
    key : LinkKey
        Who measured whom; the reading itself does not contain it.
    reading : RangeReading, BearingReading, OdometryReading or PeersReading
    stamp_s : float
        When it was measured; the reading's own stamp may be useless.
    now_s : float
        The time now, on the same clock.

    Returns
    -------
    Rejection or None
        Why it was not taken; for peers, the first rejection.

    """
    match reading:
        case RangeReading():
            return localizer.add_range(
                key.observer,
                key.target,
                reading.range_m,
                stamp_s,
                now_s,
                min_range_m=reading.min_range_m,
                max_range_m=reading.max_range_m,
                variance_m2=reading.variance_m2,
            )
        case BearingReading():
            return localizer.add_bearing(key.observer, key.target, reading.ray_xyz, stamp_s, now_s)
        case OdometryReading():
            return localizer.add_odometry(
                key.observer, reading.position_xyz, reading.orientation_xyzw, stamp_s, now_s
            )
        case PeersReading():
            # All rows before the first: a message that cannot be read must not be taken in part.
            readings = list(peer_readings(reading, localizer.config.points))
            return next(iter(localizer.add_peers(key.observer, readings, stamp_s, now_s)), None)


def peer_readings(
    peers: PeersReading, points: Sequence[str]
) -> Iterator[tuple[str, float | NDArray[np.float64]]]:
    """Yield the name of each peer with its range, and with its ray, where there is one."""
    has_rays = np.any(~np.isnan(peers.rays_xyz), axis=1).tolist()
    rows = zip(
        peers.peers.tolist(), peers.ranges_m.tolist(), peers.rays_xyz, has_rays, strict=True
    )
    for peer, range_m, ray_xyz, has_ray in rows:
        # One name for all strangers: a message may hold any number, and every name is kept.
        target = points[peer] if 0 <= peer < len(points) else f'peer beyond {len(points) - 1}'
        # A row without any reading counts as a range that is none.
        if not (has_ray and math.isnan(range_m)):
            yield target, range_m
        if has_ray:
            yield target, ray_xyz
