"""
Pendant points: held by fewer than q distances, free to swing on a circle or a sphere.

The solver does not place them. Here they get a place, bounds, and a check of their distances.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.directions import unit_vectors
from dg_localization.interval.arrays import Interval, squared_norm
from dg_localization.solver.contract.coordinate_boxes import contract_coordinate_boxes

FloatArray = NDArray[np.float64]

SWEEPS = 20
"""Most passes of the contraction of coordinate boxes."""


def place_pendant_points(
    positions: FloatArray, lower: FloatArray, upper: FloatArray
) -> FloatArray:
    """
    Return positions with a place for each pendant point, one after the other.

    A pendant point may be anywhere on its circle or sphere; it is put on the far side of the
    fleet.

    Parameters
    ----------
    positions : numpy.ndarray, shape (m, q)
        Of the first m points, in m.
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2 of all n points.

    Returns
    -------
    numpy.ndarray, shape (n, q)

    """
    for point in range(len(positions), len(lower)):
        neighbors = np.flatnonzero(np.isfinite(upper[point, :point]))
        distances_m = np.sqrt((lower[point, neighbors] + upper[point, neighbors]) / 2.0)
        outward = unit_vectors(positions[neighbors[:1]] - positions.mean(axis=0))[0]
        if not outward.any():
            outward = np.eye(positions.shape[1])[0]
        place = positions[neighbors[0]] + distances_m[0] * outward
        if len(neighbors) > 1:
            place = _on_two_spheres(positions[neighbors[:2]], distances_m[:2], outward)
        positions = np.vstack([positions, place])
    return positions


def _on_two_spheres(centers: FloatArray, radii_m: FloatArray, preferred: FloatArray) -> FloatArray:
    """Return a point that is on two spheres as nearly as can be, in the preferred direction."""
    difference = centers[1] - centers[0]
    distance = max(float(np.linalg.norm(difference)), 1e-12)
    axis = difference / distance
    along = (radii_m[0] ** 2 - radii_m[1] ** 2 + distance**2) / (2.0 * distance)
    along = float(np.clip(along, -radii_m[0], radii_m[0]))
    across = preferred - (preferred @ axis) * axis
    if np.linalg.norm(across) < 1e-6:
        across = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    across /= np.linalg.norm(across)
    height = math.sqrt(radii_m[0] ** 2 - along**2)
    return np.asarray(centers[0] + along * axis + height * across)


def enclose_pendant_points(
    solved: Interval, lower: FloatArray, upper: FloatArray
) -> Interval | None:
    """
    Return the enclosure of the solved points with that of the pendant points.

    Parameters
    ----------
    solved : Interval, shape (m, q)
        Coordinates of the first m points, in m.
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2 of all n points.

    Returns
    -------
    Interval, shape (n, q), or None
        None when the distances leave some point no place.

    """
    n_solved, dimension = solved.lower.shape
    unbounded = np.full((len(lower) - n_solved, dimension), np.inf)
    low = np.concatenate([solved.lower, -unbounded])
    high = np.concatenate([solved.upper, unbounded])
    if len(unbounded) and not contract_coordinate_boxes(low, high, lower, upper, SWEEPS):
        return None
    return Interval(low, high)


def keep_distances(
    positions: FloatArray, n_solved: int, lower: FloatArray, upper: FloatArray
) -> bool:
    """
    Return whether the pendant points certainly keep their distances.

    Parameters
    ----------
    positions : numpy.ndarray, shape (n, q)
        Of all points, in m.
    n_solved : int
        How many are not pendant; they come first.
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2.

    """
    for i in range(n_solved, len(positions)):
        squared = squared_norm(Interval.point(positions[i]) - Interval.point(positions))
        kept = (squared.lower >= lower[i]) & (squared.upper <= upper[i])
        kept[i] = True
        if not kept.all():
            return False
    return True
