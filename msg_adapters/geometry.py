# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The geometry_msgs pieces that several message families are made of."""

from typing import Any

import numpy as np
from numpy.typing import NDArray


def xyz_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Point or Vector3 as an array of shape (3,)."""
    return np.array([message.x, message.y, message.z], dtype=float)


def xyzw_from_message(message: Any) -> NDArray[np.float64]:
    """Return a Quaternion as an array of shape (4,), scalar last, not normalized."""
    return np.array([message.x, message.y, message.z, message.w], dtype=float)


def point_to_message(xyz: NDArray[np.float64]) -> Any:
    """Return an array of shape (3,) as a Point."""
    from geometry_msgs.msg import Point

    x, y, z = xyz
    return Point(x=float(x), y=float(y), z=float(z))


def vector_to_message(xyz: NDArray[np.float64]) -> Any:
    """Return an array of shape (3,) as a Vector3."""
    from geometry_msgs.msg import Vector3

    x, y, z = xyz
    return Vector3(x=float(x), y=float(y), z=float(z))


def pose_to_message(position_xyz: NDArray[np.float64], xyzw: NDArray[np.float64]) -> Any:
    """Return a position of shape (3,) and a quaternion of shape (4,), scalar last, as a Pose."""
    from geometry_msgs.msg import Pose, Quaternion

    x, y, z, w = xyzw
    return Pose(
        position=point_to_message(position_xyz),
        orientation=Quaternion(x=float(x), y=float(y), z=float(z), w=float(w)),
    )
