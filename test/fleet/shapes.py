# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rotations, and whether a truth lies in a placement."""

import math

import numpy as np

from dg_localization.fleet.rotations import rotation_of_quaternion

TOLERANCE = 1e-7


def turn(axis, angle_rad):
    """Return the rotation about a coordinate axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    matrix = np.eye(3)
    i, j = [(1, 2), (2, 0), (0, 1)][axis]
    matrix[i, i] = matrix[j, j] = c
    matrix[i, j], matrix[j, i] = -s, s
    return matrix


def attitude(yaw, pitch=0.0, roll=0.0):
    """Return the rotation about x, then y, then z."""
    return turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)


def angle_of(rotation):
    """Return the angle of a rotation, small ones to all their digits."""
    axis = rotation - rotation.T
    sine = np.linalg.norm([axis[2, 1], axis[0, 2], axis[1, 0]])
    return math.atan2(sine, np.trace(rotation) - 1.0)


def missing(placement, places, rotations=None, landmarks=None):
    """Return the part of a truth that a placement does not hold; nothing where it holds all."""
    places = np.atleast_2d(places)
    if not _are_in(placement.enclosure_m, places):
        return 'places'
    if landmarks is not None and not _are_in(placement.landmark_enclosure_m, landmarks):
        return 'landmarks'
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    if np.any((apart < placement.lower_m - TOLERANCE) | (apart > placement.upper_m + TOLERANCE)):
        return 'distances'
    for row in () if rotations is None else np.flatnonzero(placement.heading_known):
        stated = rotation_of_quaternion(placement.orientations_xyzw[row])
        half_width_rad = placement.heading_half_width_rad[row]
        if angle_of(stated.T @ rotations[row]) > half_width_rad + TOLERANCE:
            return 'orientations'
    return ''


def _are_in(enclosure_m, places):
    low, high = enclosure_m[:, 0] - TOLERANCE, enclosure_m[:, 1] + TOLERANCE
    return bool(np.all((low <= places) & (places <= high)))


def check_form(placement):
    """Positions lie in their enclosures, and what is unknown is NaN and unbounded."""
    low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    known = np.isfinite(placement.positions_m).all(axis=1)
    assert placement.positions_m.shape == low.shape and (low <= high).all()
    assert (placement.positions_m[known] >= low[known]).all()
    assert (placement.positions_m[known] <= high[known]).all()
    assert np.isinf(low[~known]).all()
    turned = placement.orientations_xyzw[placement.heading_known]
    assert np.allclose(np.linalg.norm(turned, axis=1), 1.0)
    assert np.isnan(placement.orientations_xyzw[~placement.heading_known]).all()
    assert (placement.heading_half_width_rad[~placement.heading_known] == np.pi).all()


def holds(estimate, places, rotations=None):
    """Return whether a truth lies in a placement of an estimate: places, distances, headings."""
    return not all(missing(one, places, rotations) for one in estimate.placements)


def axes_along(edges, dimension):
    """Return axes as columns: x along the first edge, y on the side of the second."""
    if dimension == 2:
        edges = [*edges, *(np.cross([0.0, 0.0, 1.0], edge) for edge in edges)]
    columns = []
    for edge in [*edges, *np.eye(3)]:
        rest = without(columns, edge)
        if np.linalg.norm(rest) > 1e-9 and len(columns) < 2:
            # Again: of points that are nearly in line little is left, and it is not square to x.
            rest = without(columns, rest / np.linalg.norm(rest))
            columns.append(rest / np.linalg.norm(rest))
    return np.column_stack([*columns, np.cross(*columns)])


def without(columns, edge):
    """Return what is left of an edge without its parts along unit columns."""
    return edge - sum(((edge @ column) * column for column in columns), np.zeros(3))


def in_space(coordinates_m):
    """Return coordinates of the plane or of space in space."""
    return np.append(coordinates_m, np.zeros(3 - len(coordinates_m)))


def random_rotation(rng, dimension):
    """Draw a body frame: any in space, about the vertical axis in the plane."""
    if dimension == 2:
        return turn(2, rng.uniform(-3.0, 3.0))
    turned, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    return turned * np.linalg.det(turned)
