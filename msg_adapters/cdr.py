# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
CDR, the bytes of a message on the wire, for messages of many thousand numbers.

Making such a message field by field, and having it serialized, takes seconds; its arrays are
numpy arrays already. The encoding is that of all ROS 2 middlewares (OMG CDR, little endian), with
padding of zeros: equal values give equal bytes.
"""

from importlib import import_module
import struct
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

# The identifier of plain CDR in little endian; positions are counted after it.
ENCAPSULATION = b'\x00\x01\x00\x00'


class CdrWriter:
    """Writes the fields of a message one after the other, each at its alignment."""

    def __init__(self) -> None:
        self._data = bytearray(ENCAPSULATION)

    def to_bytes(self) -> bytes:
        """Return what was written."""
        return bytes(self._data)

    def _align(self, size: int) -> None:
        self._data += bytes((len(ENCAPSULATION) - len(self._data)) % size)

    def uint8(self, value: int) -> None:
        """Write a byte, or a bool."""
        self._data.append(value)

    def int32(self, value: int) -> None:
        """Write an int32."""
        self._align(4)
        self._data += struct.pack('<i', value)

    def uint32(self, value: int) -> None:
        """Write a uint32, such as the length of a sequence."""
        self._align(4)
        self._data += struct.pack('<I', value)

    def string(self, text: str) -> None:
        """Write a string."""
        data = text.encode()
        self.uint32(len(data) + 1)
        self._data += data
        self._data.append(0)

    def float64s(self, values: ArrayLike) -> None:
        """Write numbers one after the other; a sequence needs its length before."""
        self._numbers(np.asarray(values, dtype='<f8'))

    def float32s(self, values: ArrayLike) -> None:
        """Write numbers in single precision one after the other."""
        self._numbers(np.asarray(values, dtype='<f4'))

    def _numbers(self, values: np.ndarray) -> None:
        if values.size:
            self._align(values.itemsize)
            self._data += values.tobytes()


def message_from_cdr(type_name: str, data: bytes) -> Any:
    """Return the message of a type such as 'geometry_msgs/msg/PoseArray' that the bytes hold."""
    from rclpy.serialization import deserialize_message

    package, kind, name = type_name.split('/')
    return deserialize_message(data, getattr(import_module(f'{package}.{kind}'), name))
