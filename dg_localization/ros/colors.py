# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The colors of robots in pictures."""

ROBOT_COLORS = ('#0072B2', '#E69F00', '#009E73', '#D55E00', '#CC79A7', '#56B4E9')
"""Told apart by people of every color vision (Okabe and Ito); further robots begin again."""


def color_of(robot: int) -> str:
    """Return the color of a robot, by its place among the robots."""
    return ROBOT_COLORS[robot % len(ROBOT_COLORS)]
