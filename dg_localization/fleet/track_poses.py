# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Poses on the track of a robot: the path that its odometry is off by errors of single poses.

The constant errors of odometry do not add up. They are those of a pose off its track.
"""

from __future__ import annotations

from dataclasses import dataclass

from dg_localization.poses import PastPoses


@dataclass(frozen=True)
class TrackPoses:
    """
    Past poses of a robot, seen from the pose that its track has now.

    Parameters
    ----------
    past : PastPoses
    track : PastPoses
        The track pose, seen from the robot now: one pose.

    """

    past: PastPoses
    track: PastPoses


@dataclass(frozen=True)
class TrackStep:
    """
    Where a track is at one sample, seen from an earlier one, or where its robot is, seen from it.

    Parameters
    ----------
    pose : PastPoses
        One pose, with the errors of the turns.
    ball_m : float
        The errors of the ways put it no farther off than this, in any direction.

    """

    pose: PastPoses
    ball_m: float
