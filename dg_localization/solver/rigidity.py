"""
What a placement can still do: rigidity and the spread that measurement errors explain.

The rows of the rigidity matrix are the gradients of the squared distances that were measured. Its
kernel holds the motions of the whole fleet and, where its rank is lower than
q n - q (q + 1) / 2, motions that no measurement resists: a flex.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from dg_localization.solver.box import FloatArray

RANK_TOLERANCE = 1e-6
"""Singular values below this fraction of the largest count as zero."""

SMALLEST_ERROR = 1e-13
"""Exact measurements count as having this relative error, so that weights stay finite."""


def _gradients(
    positions: FloatArray, pairs: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> FloatArray:
    """Return the gradient of each pair's squared distance, shape (pairs, n q)."""
    n_points, dimension = positions.shape
    first, second = pairs
    difference = 2.0 * (positions[first] - positions[second])
    rows = np.zeros((len(first), n_points, dimension))
    index = np.arange(len(first))
    rows[index, first] = difference
    rows[index, second] = -difference
    return rows.reshape(len(first), n_points * dimension)


def _n_rigid_motions(n_points: int, dimension: int) -> int:
    """Return the number of motions that keep the distances of points in general position."""
    span = min(n_points - 1, dimension)
    return dimension + span * (2 * dimension - span - 1) // 2


def is_flexible(positions: FloatArray, measured: NDArray[np.bool_]) -> bool:
    """
    Tell whether the measured distances leave a placement free to move.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        A placement in m.
    measured : ndarray of bool, shape (n, n)
        The pairs whose distance is bounded by a measurement.

    Returns
    -------
    bool
        True when the rank of the rigidity matrix is lower than that of all distances together.

    """
    n_points, dimension = positions.shape
    if n_points == 1:
        return False
    first, second = np.nonzero(np.triu(measured, 1))
    rigid_rank = n_points * dimension - _n_rigid_motions(n_points, dimension)
    if len(first) < rigid_rank:
        return True
    rows = _gradients(positions, (first, second))
    norms = np.linalg.norm(rows, axis=1, keepdims=True)
    singular = np.linalg.svd(rows / np.maximum(norms, 1e-300), compute_uv=False)
    return int(np.sum(singular > RANK_TOLERANCE * singular[0])) < rigid_rank


def explained_widths(
    positions: FloatArray, measured: NDArray[np.bool_], half_widths: FloatArray
) -> FloatArray:
    """
    Return the width of every squared distance that the measurement errors explain.

    To first order a placement answers to errors e of the measured squared distances by
    P e, where P is the weighted least-squares inverse of the rigidity matrix.

    Parameters
    ----------
    positions : ndarray, shape (n, q)
        A placement in m at which the fleet is rigid.
    measured : ndarray of bool, shape (n, n)
        The measured pairs.
    half_widths : ndarray, shape (n, n)
        Half the width of the measured intervals in m^2.

    Returns
    -------
    ndarray, shape (n, n)
        Widths in m^2.

    """
    n_points, dimension = positions.shape
    first, second = np.nonzero(np.triu(measured, 1))
    edges = first, second
    pairs = np.triu_indices(n_points, 1)
    error = half_widths[edges]
    lengths_m2 = ((positions[edges[0]] - positions[edges[1]]) ** 2).sum(axis=1)
    error = np.maximum(error, SMALLEST_ERROR * max(float(lengths_m2.max()), 1e-300))
    weighted = _gradients(positions, edges) / error[:, None]
    inverse = np.linalg.pinv(weighted, rcond=1e-9)
    spread = np.abs(_gradients(positions, pairs) @ inverse).sum(axis=1)
    widths = np.zeros((n_points, n_points))
    widths[pairs] = 2.0 * spread
    return widths + widths.T
