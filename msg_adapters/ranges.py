# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""sensor_msgs/Range <-> `RangeReading`, with the sentinel values of REP-117."""

from dataclasses import dataclass
from typing import Any

from msg_adapters.headers import header_to_message, stamp_from_message

TYPE_NAME = 'sensor_msgs/msg/Range'


@dataclass(frozen=True)
class RangeReading:
    """
    One distance reading.

    Attributes
    ----------
    stamp_s : float
        Time of measurement in s; 0.0 when the header was left empty.
    range_m : float
        Distance in m as reported. REP-117: NaN is no reading, +inf is nothing
        within `max_range_m`, -inf is closer than `min_range_m`.
    min_range_m, max_range_m : float or None
        Limits of the sensor in m; None when the message does not give them.
    variance_m2 : float or None
        Variance in m^2; None when the message does not give it.
    frame_id : str
        Frame of the sensor. It tells nothing about who was measured.

    """

    stamp_s: float
    range_m: float
    min_range_m: float | None = None
    max_range_m: float | None = None
    variance_m2: float | None = None
    frame_id: str = ''


def range_from_message(message: Any) -> RangeReading:
    """
    Read a `sensor_msgs/Range`.

    Equal limits of zero and a variance of zero mean "not given", as drivers
    that fill in nothing but the range leave them.

    Parameters
    ----------
    message : sensor_msgs.msg.Range
        Or any object with the same fields; `variance` may be missing, as in
        recordings older than Jazzy.

    """
    limits_given = message.min_range != 0.0 or message.max_range != 0.0
    variance_m2 = float(getattr(message, 'variance', 0.0))
    return RangeReading(
        stamp_s=stamp_from_message(message.header.stamp),
        range_m=float(message.range),
        min_range_m=float(message.min_range) if limits_given else None,
        max_range_m=float(message.max_range) if limits_given else None,
        variance_m2=variance_m2 if variance_m2 != 0.0 else None,
        frame_id=message.header.frame_id,
    )


def range_to_message(reading: RangeReading) -> Any:
    """
    Write a `sensor_msgs/Range`.

    `radiation_type` stays at its default: the message has no value for radio.
    The fields are 32 bit floats, so a range of 8 m is rounded to 0.5 micrometers.
    """
    from sensor_msgs.msg import Range

    return Range(
        header=header_to_message(reading.stamp_s, reading.frame_id),
        range=float(reading.range_m),
        min_range=float(reading.min_range_m or 0.0),
        max_range=float(reading.max_range_m or 0.0),
        variance=float(reading.variance_m2 or 0.0),
    )
