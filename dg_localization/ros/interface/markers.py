# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""An estimate as markers for a viewer: one namespace for each thing to switch on and off."""

from collections.abc import Iterator
from colorsys import hsv_to_rgb
from itertools import combinations, product

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet import Estimate, LinkState, Placement
from dg_localization.fleet.rotations import rotation_of_quaternion
from dg_localization.ros.interface.poses import in_space
from msg_adapters import Marker, MarkerScene, Shape

ROBOT_DIAMETER_M = 0.3
NAME_HEIGHT_M = 0.3
LINE_WIDTH_M = 0.03
HEADING_LENGTH_M = 0.6

FRESH_RGBA = np.array([0.2, 0.8, 0.3, 0.8])
STALE_RGBA = np.array([0.6, 0.6, 0.6, 0.4])
CONTRADICTING_RGBA = np.array([0.9, 0.1, 0.1, 1.0])
LANDMARK_RGBA = np.array([0.8, 0.8, 0.8, 1.0])

# Neighboring numbers differ by the golden angle, so that few hypotheses are told apart well. The
# first is blue: a link is green or red by its state.
FIRST_HUE = 0.58
HUE_STEP = 0.381966
NAME_RGBA = np.array([1.0, 1.0, 1.0, 1.0])
# More placements on top of each other show nothing, and cost every viewer time.
MOST_DRAWN = 32

LOOKS = {
    'robots': (Shape.SPHERE_LIST, ROBOT_DIAMETER_M),
    'headings': (Shape.LINE_LIST, 2.0 * LINE_WIDTH_M),
    'enclosures': (Shape.LINE_LIST, LINE_WIDTH_M),
    'links': (Shape.LINE_LIST, LINE_WIDTH_M),
}
Group = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Things of as many points each, shape (k, m, 3), and one color, or one of each."""


def scene(estimate: Estimate, frame_id: str, lifetime_s: float) -> MarkerScene:
    """
    Return robots, headings, names, enclosures and links of the first `MOST_DRAWN` placements.

    Each placement has a color of its own; links are green, gray when stale, red when they
    contradict others. What is not known or not bounded is left out.
    """
    rows = {name: i for i, name in enumerate((*estimate.robots, *estimate.landmarks))}
    # A link of a sensor is drawn from its robot.
    ends = {
        link: [rows.get(name.partition('/')[0], -1) for name in link.key.ends]
        for link in estimate.links
    }
    drawn = {link: pair for link, pair in ends.items() if min(pair) >= 0}
    pairs = np.reshape([*drawn.values()], (-1, 2)).astype(int)
    link_colors = np.reshape([_link_color(link) for link in drawn], (-1, 4))
    groups: dict[str, list[Group]] = {name: [] for name in LOOKS}
    for number, placement in enumerate(estimate.placements[:MOST_DRAWN]):
        color, points_m = _color(number), _points(placement)
        robots_m, landmarks_m = np.split(points_m, [len(estimate.robots)])
        tips_m = HEADING_LENGTH_M * rotation_of_quaternion(placement.best_headings[0])[:, :, 0]
        tips_m[~placement.heading_known] = np.nan
        groups['robots'] += [(robots_m[:, None], color), (landmarks_m[:, None], LANDMARK_RGBA)]
        groups['headings'].append((np.stack([robots_m, robots_m + tips_m], axis=1), color))
        groups['enclosures'].append((in_space(_edges(placement.enclosure_m)), color))
        groups['links'].append((points_m[pairs], link_colors))
    markers = [*(_marker(name, groups[name]) for name in LOOKS), *_names(estimate)]
    shown = tuple(marker for marker in markers if len(marker.points_m))
    return MarkerScene(estimate.stamp_s, frame_id, shown, lifetime_s)


def _color(hypothesis: int) -> NDArray[np.float64]:
    return np.array([*hsv_to_rgb((FIRST_HUE + hypothesis * HUE_STEP) % 1.0, 0.8, 0.95), 0.9])


def _points(placement: Placement) -> NDArray[np.float64]:
    """Return the robots, then the landmarks, shape (n + m, 3)."""
    return in_space(np.concatenate([placement.positions_m, placement.landmarks_m]))


def _marker(namespace: str, groups: list[Group]) -> Marker:
    """Join what is known of groups of things to one marker."""
    points_m, colors = [np.zeros((0, 3))], [np.zeros((0, 4))]
    for things_m, color in groups:
        is_known = np.isfinite(things_m).all(axis=(1, 2))
        points_m.append(things_m[is_known].reshape(-1, 3))
        of_things = np.broadcast_to(color, (len(things_m), 4))[is_known]
        colors.append(np.repeat(of_things, things_m.shape[1], axis=0))
    shape, size_m = LOOKS[namespace]
    return Marker(namespace, 0, shape, np.concatenate(points_m), np.concatenate(colors), size_m)


def _edges(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of boxes of shape (k, 2, q), two rows each, shape (k, m, q)."""
    dimension = boxes.shape[2]
    corners = [np.array(choice) for choice in product((0, 1), repeat=dimension)]
    pairs = [pair for pair in combinations(corners, 2) if np.abs(pair[0] - pair[1]).sum() == 1]
    # For each row, which of the two bounds it has in each coordinate.
    bounds = np.array([corner for pair in pairs for corner in pair])
    return boxes[:, bounds, np.arange(dimension)]


def _link_color(link: LinkState) -> NDArray[np.float64]:
    if link.contradicts:
        return CONTRADICTING_RGBA
    return STALE_RGBA if link.stale else FRESH_RGBA


def _names(estimate: Estimate) -> Iterator[Marker]:
    """Yield the name of each point, once where placements have it at about the same place."""
    names = (*estimate.robots, *estimate.landmarks)
    # Beside the point for those who look from above, and above it for the others.
    offset = np.array([0.0, ROBOT_DIAMETER_M, ROBOT_DIAMETER_M])
    named: list[list[NDArray[np.float64]]] = [[] for _ in names]
    for number, placement in enumerate(estimate.placements[:MOST_DRAWN]):
        for row, (name, point) in enumerate(zip(names, _points(placement), strict=True)):
            nearby = any(np.linalg.norm(point - other) < NAME_HEIGHT_M for other in named[row])
            if nearby or not np.isfinite(point).all():
                continue
            named[row].append(point)
            yield Marker(
                namespace='names',
                identifier=number * len(names) + row,
                shape=Shape.TEXT,
                points_m=(point + offset)[None, :],
                colors_rgba=NAME_RGBA[None, :],
                size_m=NAME_HEIGHT_M,
                text=name,
            )
