# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Poses that were heard, and the truth."""

import math

import numpy as np

from msg_adapters import adapter_for

ROUNDING = 1e-9

pose_from_message = adapter_for('geometry_msgs/msg/PoseWithCovarianceStamped').from_message


def half_widths_of(pose):
    """Return how wide a pose says it is, shape (6,)."""
    return np.sqrt(np.diag(pose.covariance))


def assert_holds(pose, place_m, yaw_rad):
    """Check that a pose holds a place in the plane and a heading."""
    half_widths = half_widths_of(pose)
    assert (np.abs(pose.position_xyz[:2] - place_m) <= half_widths[:2] + ROUNDING).all()
    z, w = pose.orientation_xyzw[2:]
    turn_rad = math.remainder(2.0 * math.atan2(z, w) - yaw_rad, 2.0 * math.pi)
    assert abs(turn_rad) <= half_widths[5] + ROUNDING
