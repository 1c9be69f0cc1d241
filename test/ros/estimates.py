# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Placements as the localizer makes them, reports, and how wide a pose says it is."""

from dataclasses import replace
import math
from types import SimpleNamespace

import numpy as np

from dg_localization.fleet import Placement
from dg_localization.ros.interface.diagnostics import Report
from msg_adapters import adapter_for

pose_from_message = adapter_for('geometry_msgs/msg/PoseWithCovarianceStamped').from_message


def placement_at(positions_m, /, **changes):
    """Return a placement without headings, which knows known positions to 0.1 m."""
    positions_m = np.array(positions_m, dtype=float)
    n_robots, dimension = positions_m.shape
    half_widths_m = np.where(np.isnan(positions_m), np.inf, 0.1)
    middles_m = np.nan_to_num(positions_m)
    made = Placement(
        positions_m=positions_m,
        enclosure_m=np.stack([middles_m - half_widths_m, middles_m + half_widths_m], axis=1),
        orientations_xyzw=np.full((n_robots, 4), math.nan),
        heading_known=np.zeros(n_robots, dtype=bool),
        heading_half_width_rad=np.full(n_robots, math.pi),
        proved=True,
        flexible=False,
        mirrored=False,
        landmarks_m=np.zeros((0, dimension)),
        landmark_enclosure_m=np.zeros((0, 2, dimension)),
        lower_m=np.zeros((n_robots, n_robots)),
        upper_m=np.where(np.eye(n_robots, dtype=bool), 0.0, np.inf),
    )
    return replace(made, **changes)


AS_MAP = SimpleNamespace(fixed_frame='map', lifetime_s=1.0, least_deviation_m=0.05)
"""The settings of a node whose frame of anchors is `map`."""


def report_on(estimate, robots, localized_width_m=math.inf, **changes):
    """Return what the diagnostics of a node without trouble are made of."""
    settings = SimpleNamespace(
        fleet=SimpleNamespace(robots=robots),
        lifetime_s=1.0,
        rate_hz=5.0,
        localized_width_m=localized_width_m,
    )
    plain = {'node': 'localizer', 'settings': settings, 'malformed': {}, 'wrong_types': {}}
    return Report(estimate=estimate, **{**plain, **changes})


def half_widths_of(pose):
    """Return how wide a pose says it is, shape (6,)."""
    return np.sqrt(np.diag(pose.covariance))
