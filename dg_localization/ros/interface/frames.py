# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The names of the frames that estimates are published in (REP-105)."""

from dg_localization.fleet import FixedFrame, FrameKind

BODY_FRAME = 'base_link'
SHAPE_FRAME = 'fleet'


LONGEST_FRAME_ID = 255
"""Longer names of others are not published, nor are those that cannot be printed."""


def usable_frame_id(name: str) -> str:
    """Return the name of a frame as a message states it; empty where it is not fit to publish."""
    return name if len(name) <= LONGEST_FRAME_ID and name.isprintable() else ''


def check_frame_id(name: str) -> None:
    """Raise ValueError unless `name` can be that of a frame."""
    if not name or '/' in name[:1] or ' ' in name or not usable_frame_id(name):
        raise ValueError(
            "it must be the name of a frame, such as 'map', without blanks and without a slash at "
            'the beginning'
        )


def frame_id(frame: FixedFrame | None, fixed_frame: str) -> str:
    """
    Return the name of a frame, which says what it is tied to.

    Parameters
    ----------
    frame : FixedFrame or None
        The frame of an estimate; None when it has no placements.
    fixed_frame : str
        The name of the frame of the anchors, and of what is empty.

    Returns
    -------
    str
        `fixed_frame`, the odometry or the body frame of a robot, or that of a shape only.

    """
    if frame is None or frame.kind == FrameKind.ANCHORS:
        return fixed_frame
    if frame.kind == FrameKind.ODOMETRY:
        return frame.name
    if frame.kind == FrameKind.HEADING:
        return f'{frame.points[0]}/{BODY_FRAME}'
    return SHAPE_FRAME
