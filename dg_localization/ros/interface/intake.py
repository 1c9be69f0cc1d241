"""From messages to the ROS-free `Localizer`; what is wrong with a message is counted."""

from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import InputState, LinkKey, Localizer, Rejection
from dg_localization.ros.interface.diagnostics import NONE_MALFORMED, Malformed
from dg_localization.ros.interface.links import Link
from msg_adapters import BearingReading, OdometryReading, PeersReading, RangeReading

Reading = RangeReading | BearingReading | OdometryReading | PeersReading


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
        self.malformed: dict[str, Malformed] = {}

    def take(self, link: Link, read: Callable[[], Reading], now_s: float) -> Rejection | None:
        """
        Take one message; it never raises.

        Parameters
        ----------
        link : Link
            The input that it arrived on.
        read : callable
            Returns the reading. It may raise anything: the message may be damaged, and the
            adapter may belong to a type of somebody else.
        now_s : float
            When it arrived.

        Returns
        -------
        Rejection or None
            Why a message that could be read was not taken.

        """
        try:
            reading = read()
        except Exception as error:
            self.malformed[link.topic] = self.malformed.get(link.topic, NONE_MALFORMED).and_one(
                f'{type(error).__name__}: {error}'
            )
            return None
        stamp_s = reading.stamp_s if self._use_header_stamp else now_s
        return add_reading(self._localizer, link.key, reading, stamp_s, now_s)

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
            readings = _peer_readings(reading, localizer.config.points)
            return next(iter(localizer.add_peers(key.observer, readings, stamp_s, now_s)), None)


def _peer_readings(
    peers: PeersReading, points: Sequence[str]
) -> Iterator[tuple[str, float | NDArray[np.float64]]]:
    """Yield the name of each peer with its range, and with its ray, where there is one."""
    rows = zip(peers.peers.tolist(), peers.ranges_m.tolist(), peers.rays_xyz, strict=True)
    for peer, range_m, ray_xyz in rows:
        # One name for all strangers: a message may hold any number, and every name is kept.
        target = points[peer] if 0 <= peer < len(points) else f'peer beyond {len(points) - 1}'
        has_ray = not np.isnan(ray_xyz).all()
        # A row without any reading counts as a range that is none.
        if not (np.isnan(range_m) and has_ray):
            yield target, range_m
        if has_ray:
            yield target, ray_xyz
