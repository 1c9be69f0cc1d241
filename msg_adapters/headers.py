# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Common parts of all message families: headers, geometry_msgs, and CDR.

CDR is the encoding of a message on the wire. Filling a message of many thousand numbers field by
field and serializing it takes seconds, so arrays are written from numpy directly. The encoding is
that of all ROS 2 middlewares (OMG CDR, little endian), padded with zeros: equal values give equal
bytes.
"""

from importlib import import_module
import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray

NS_PER_S = 1_000_000_000
# The identifier of plain CDR in little endian; positions are counted after it.
ENCAPSULATION = b'\x00\x01\x00\x00'


class CdrWriter:
    """
    Writes the fields of a message one after the other, each at its alignment.

    The kinds of fields are `B` a byte or a bool, `i` and `I` 32 bits, `s` a string, `f` and `d` an
    array of numbers (the length of a sequence is a separate field before it), `b` bytes, and `h` a
    `std_msgs/Header` of a stamp in s and a frame.
    """

    def __init__(self, kinds: str, *values: Any) -> None:
        self._data = bytearray(ENCAPSULATION)
        self.write(kinds, *values)

    def to_bytes(self) -> bytes:
        """Return the bytes written so far."""
        return bytes(self._data)

    def _align(self, size: int) -> None:
        self._data += bytes((len(ENCAPSULATION) - len(self._data)) % size)

    def write(self, kinds: str, *values: Any) -> None:
        """Write a value of each kind; raise ValueError if a stamp is not finite."""
        for kind, value in zip(kinds, values, strict=True):
            if kind == 'h':
                stamp_s, frame_id = value
                self.write('iIs', *split_time('stamp', stamp_s), frame_id)
            elif kind == 's':
                data = value.encode() + b'\0'
                self.write('Ib', len(data), data)
            elif kind == 'b':
                self._data += value
            elif kind in 'fd':
                array = np.asarray(value, dtype=f'<{kind}')
                if array.size:
                    self._align(array.itemsize)
                    self._data += array.tobytes()
            else:
                self._align(struct.calcsize(kind))
                self._data += struct.pack(f'<{kind}', value)


def to_cdr(kinds: str, *values: Any) -> bytes:
    """Return the bytes of a message whose fields are of these kinds."""
    return CdrWriter(kinds, *values).to_bytes()


def message_class(type_name: str) -> Any:
    """Import the class of a type such as 'geometry_msgs/msg/PoseArray'."""
    package, kind, name = type_name.split('/')
    return getattr(import_module(f'{package}.{kind}'), name)


def stamp_from_message(stamp: Any) -> float:
    """
    Return a `builtin_interfaces/Time` in seconds.

    A double resolves 0.24 microseconds at today's UNIX times.

    Parameters
    ----------
    stamp : builtin_interfaces.msg.Time
        Or any object with the same fields, such as those of `rosbags`.

    Returns
    -------
    float
        Seconds since the epoch of the clock; 0.0 for an empty header. Negative seconds are
        returned as stated: they are too old for any use.

    Raises
    ------
    ValueError
        If its nanoseconds are a second or more: its seconds cannot be trusted either.

    """
    if not 0 <= stamp.nanosec < NS_PER_S:
        raise ValueError(f'nanosec {stamp.nanosec} of the stamp must be below {NS_PER_S}')
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def header_of(message: Any) -> dict[str, Any]:
    """Return the stamp in s and the frame of a message that has a header."""
    stamp_s = stamp_from_message(message.header.stamp)
    return {'stamp_s': stamp_s, 'frame_id': message.header.frame_id}


def split_time(name: str, time_s: float) -> tuple[int, int]:
    """Return whole seconds and the remaining nanoseconds; `name` is used in the error."""
    if not abs(time_s) < float('inf'):
        raise ValueError(f'{name} {time_s} s is not finite')
    return divmod(round(time_s * NS_PER_S), NS_PER_S)


def header_to_message(stamp_s: float, frame_id: str) -> Any:
    """
    Return a `std_msgs/Header` with a stamp in s, rounded to the nearest nanosecond, and a frame.

    Raises
    ------
    ValueError
        If the stamp is not finite.

    """
    from builtin_interfaces.msg import Time
    from std_msgs.msg import Header

    sec, nanosec = split_time('stamp', stamp_s)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=frame_id)


def xyz_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Point or Vector3 as an array of shape (3,)."""
    return np.array([message.x, message.y, message.z], dtype=float)


def xyzw_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Quaternion as an array of shape (4,), scalar last, not normalized."""
    return np.array([message.x, message.y, message.z, message.w], dtype=float)
