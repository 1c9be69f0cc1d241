# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Unit vectors and the angles between them, in plain floating point."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def unit_vectors(vectors: FloatArray) -> FloatArray:
    """Return the vectors along the last axis scaled to length 1; a zero vector stays."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(lengths > 0.0, lengths, 1.0))


def angles_rad(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the angles between unit vectors along the last axis, in [0, pi]."""
    # Exact to rounding for all angles, unlike the arccosine near 0 and pi.
    difference = np.linalg.norm(first - second, axis=-1)
    total = np.linalg.norm(first + second, axis=-1)
    return np.asarray(2.0 * np.arctan2(difference, total))


def best_rotation(
    start: FloatArray, end: FloatArray, weights: FloatArray | None = None
) -> FloatArray:
    """
    Return the rotation that takes vectors closest to others, by least squares.

    Parameters
    ----------
    start, end : numpy.ndarray, shape (m, q)
    weights : numpy.ndarray, shape (m,), optional

    Returns
    -------
    numpy.ndarray, shape (q, q)

    """
    scaled = end if weights is None else end * weights[:, None]
    if start.shape[1] == 2:
        along = float((scaled * start).sum())
        across = float(start[:, 0] @ scaled[:, 1] - start[:, 1] @ scaled[:, 0])
        length = math.hypot(along, across)
        c, s = (along / length, across / length) if length else (1.0, 0.0)
        return np.array([[c, -s], [s, c]])
    left, _, right = np.linalg.svd(scaled.T @ start)
    signs = np.ones(start.shape[1])
    signs[-1] = np.linalg.det(left @ right)
    return np.asarray(left @ np.diag(signs) @ right)
