# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""tf2_msgs/TFMessage <-> `Transform`, one for each frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msg_adapters.cdr import CdrWriter
from msg_adapters.headers import (
    stamp_from_message,
    write_header,
    xyz_from_message,
    xyzw_from_message,
)

TYPE_NAME = 'tf2_msgs/msg/TFMessage'


@dataclass(frozen=True, eq=False)
class Transform:
    """
    Where a frame is in another one.

    Attributes
    ----------
    stamp_s : float
        Time in s.
    frame_id, child_frame_id : str
        The frame that coordinates are given in, and the one that is placed in it.
    translation_m : ndarray, shape (3,)
        Origin of the child.
    rotation_xyzw : ndarray, shape (4,)
        Quaternion from child to parent, scalar last.

    """

    stamp_s: float
    frame_id: str
    child_frame_id: str
    translation_m: NDArray[np.float64]
    rotation_xyzw: NDArray[np.float64]


def transforms_to_cdr(transforms: Sequence[Transform]) -> bytes:
    """Write a serialized `tf2_msgs/TFMessage`."""
    writer = CdrWriter()
    writer.uint32(len(transforms))
    for transform in transforms:
        write_header(writer, transform.stamp_s, transform.frame_id)
        writer.string(transform.child_frame_id)
        writer.float64s(transform.translation_m)
        writer.float64s(transform.rotation_xyzw)
    return writer.to_bytes()


def transforms_from_message(message: Any) -> list[Transform]:
    """Read a `tf2_msgs/TFMessage`."""
    return [
        Transform(
            stamp_s=stamp_from_message(entry.header.stamp),
            frame_id=entry.header.frame_id,
            child_frame_id=entry.child_frame_id,
            translation_m=xyz_from_message(entry.transform.translation),
            rotation_xyzw=xyzw_from_message(entry.transform.rotation),
        )
        for entry in message.transforms
    ]
