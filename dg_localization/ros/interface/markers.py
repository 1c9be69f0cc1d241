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


def scene(estimate: Estimate, frame_id: str, lifetime_s: float) -> MarkerScene:
    """
    Return robots, headings, names, enclosures and links of the first `MOST_DRAWN` placements.

    Each placement has a color of its own; links are green, gray when stale, red when they
    contradict others. What is not known or not bounded is left out.
    """
    drawn = []
    if estimate.placements:
        drawn = [
            _robots(estimate),
            _headings(estimate),
            _enclosures(estimate),
            _links(estimate),
            *_names(estimate),
        ]
    shown = tuple(marker for marker in drawn if len(marker.points_m))
    return MarkerScene(estimate.stamp_s, frame_id, shown, lifetime_s)


def _drawn(estimate: Estimate) -> tuple[Placement, ...]:
    return estimate.placements[:MOST_DRAWN]


def _color(hypothesis: int) -> NDArray[np.float64]:
    return np.array([*hsv_to_rgb((FIRST_HUE + hypothesis * HUE_STEP) % 1.0, 0.8, 0.95), 0.9])


def _points(placement: Placement) -> NDArray[np.float64]:
    """Return the robots, then the landmarks, shape (n + m, 3)."""
    return in_space(np.concatenate([placement.positions_m, placement.landmarks_m]))


def _marker(
    namespace: str,
    shape: Shape,
    groups: list[tuple[NDArray[np.float64], NDArray[np.float64]]],
    size_m: float,
) -> Marker:
    """Join groups of points, with one color for all or for each of a group, to one marker."""
    points = [np.reshape(points, (-1, 3)) for points, _ in groups]
    colors = [
        np.broadcast_to(color, (len(part), 4))
        for part, (_, color) in zip(points, groups, strict=True)
    ]
    return Marker(
        namespace,
        0,
        shape,
        np.concatenate([np.zeros((0, 3)), *points]),
        np.concatenate([np.zeros((0, 4)), *colors]),
        size_m,
    )


def _known(points: NDArray[np.float64]) -> NDArray[np.float64]:
    return points[np.isfinite(points).all(axis=-1)]


def _robots(estimate: Estimate) -> Marker:
    groups = []
    for number, placement in enumerate(_drawn(estimate)):
        groups.append((_known(in_space(placement.positions_m)), _color(number)))
        groups.append((_known(in_space(placement.landmarks_m)), LANDMARK_RGBA))
    return _marker('robots', Shape.SPHERE_LIST, groups, ROBOT_DIAMETER_M)


def _headings(estimate: Estimate) -> Marker:
    groups = []
    for number, placement in enumerate(_drawn(estimate)):
        starts = in_space(placement.positions_m)
        rotations = rotation_of_quaternion(placement.best_headings[0])
        ends = starts + HEADING_LENGTH_M * rotations[:, :, 0]
        segments = np.stack([starts, ends], axis=1)
        is_known = placement.heading_known & np.isfinite(segments).all(axis=(1, 2))
        groups.append((segments[is_known], _color(number)))
    return _marker('headings', Shape.LINE_LIST, groups, 2.0 * LINE_WIDTH_M)


def _enclosures(estimate: Estimate) -> Marker:
    groups = []
    for number, placement in enumerate(_drawn(estimate)):
        is_bounded = np.isfinite(placement.enclosure_m).all(axis=(1, 2))
        groups.append((in_space(_edges(placement.enclosure_m[is_bounded])), _color(number)))
    return _marker('enclosures', Shape.LINE_LIST, groups, LINE_WIDTH_M)


def _edges(boxes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of boxes of shape (k, 2, q), two rows each, box by box."""
    dimension = boxes.shape[2]
    corners = [np.array(choice) for choice in product((0, 1), repeat=dimension)]
    pairs = [pair for pair in combinations(corners, 2) if np.abs(pair[0] - pair[1]).sum() == 1]
    # For each row, which of the two bounds it has in each coordinate.
    bounds = np.array([corner for pair in pairs for corner in pair])
    return boxes[:, bounds, np.arange(dimension)].reshape(-1, dimension)


def _links(estimate: Estimate) -> Marker:
    row = {name: i for i, name in enumerate((*estimate.robots, *estimate.landmarks))}
    # A link of a sensor is drawn from its robot.
    ends_of = {
        link: tuple(
            row.get(name.partition('/')[0]) for name in (link.key.observer, link.key.target)
        )
        for link in estimate.links
    }
    links = [link for link in estimate.links if None not in ends_of[link]]
    ends = np.array([ends_of[link] for link in links], dtype=int)
    colors = np.reshape([_link_color(link) for link in links], (-1, 4))
    groups = []
    for placement in _drawn(estimate):
        segments = _points(placement)[ends.reshape(-1, 2)]
        is_known = np.isfinite(segments).all(axis=(1, 2))
        groups.append((segments[is_known], np.repeat(colors[is_known], 2, axis=0)))
    return _marker('links', Shape.LINE_LIST, groups, LINE_WIDTH_M)


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
    for number, placement in enumerate(_drawn(estimate)):
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
