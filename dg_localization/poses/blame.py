# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Suspects among the readings of a window that do not all agree.

A set that tolerates k wrong readings is covered by boxes. Readings that rule out a whole box are
wrong if the true poses are in it: in the box that holds the true poses, only wrong readings do so.
The smallest such sets of readings are the suspects.
"""

from __future__ import annotations

from collections.abc import Callable
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.interval.environment import default_environment
from dg_localization.interval.kernels import kernel
from dg_localization.poses.cover import Cover
from dg_localization.poses.cuts import W_SIZE, cut_box
from dg_localization.poses.half_spaces import RULED_OUT, VIEW, Scratch, view_box
from dg_localization.poses.readings import PairReadings
from dg_localization.poses.search import PairOptions, cover_poses

FEW_BOXES = 64
"""Most boxes of the search that checks whether all readings agree in a box."""

CHUNK = 64
"""Boxes examined together."""


@kernel
def rule_out(boxes: np.ndarray, table: np.ndarray, ruled_out: np.ndarray) -> None:
    """
    Find which readings rule out which whole boxes.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (n, 2, 4)
    table : numpy.ndarray, shape (m, COLUMNS)
    ruled_out : numpy.ndarray of bool, shape (n, m)
        Receives the result.

    """
    view, faces = np.empty((2, VIEW)), np.empty((2, 4))
    scratch = Scratch(view, faces, np.zeros(4), np.empty(W_SIZE))
    for number in range(boxes.shape[0]):
        view_box(boxes[number], view)
        for index in range(table.shape[0]):
            state = cut_box(scratch, boxes[number], table[index])
            ruled_out[number, index] = state == RULED_OUT


@default_environment()
def find_suspects(
    readings: PairReadings, cover: Cover, *, stopped: Callable[[], bool] = lambda: False
) -> NDArray[np.intp]:
    """
    Return readings that explain why not all readings agree.

    Parameters
    ----------
    readings : PairReadings
    cover : Cover
        The poses that all but a tolerated number of readings allow.
    stopped : callable, optional
        Called between bounded steps; when it returns true, only results proved so far are used.

    Returns
    -------
    numpy.ndarray of int
        Indices into the readings, ascending; empty if no contradiction between them is proved.
        Otherwise some reading is wrong. If at most as many are wrong as the cover tolerates, the
        result holds all readings that rule out the box of the true poses, unless another box is
        ruled out by only a part of them. Readings that rule out that box only in combination may
        be missing: a reading that exceeds its bound by little may not be named.

    """
    table = readings.table
    ruled_out = np.zeros((len(cover), len(readings)), np.bool_)
    parts = math.ceil(len(cover) / CHUNK)
    for part in range(parts):
        # Spread over the cover: if all agree somewhere, the first part usually shows it.
        chosen = slice(part, None, parts)
        boxes, found = np.ascontiguousarray(cover.boxes[chosen]), ruled_out[chosen].copy()
        rule_out(boxes, table, found)
        ruled_out[chosen] = found
        if _agree_within(readings, boxes[~found.any(axis=1)], stopped):
            return np.empty(0, np.intp)
    sets = np.unique(ruled_out[ruled_out.any(axis=1)], axis=0)
    sizes = sets.sum(axis=1)
    # A set contains another if both share as many readings as the other has.
    shared = sets.astype(np.int64) @ sets.T.astype(np.int64)
    contains = (shared == sizes[None]) & (sizes[None] < sizes[:, None])
    return np.flatnonzero(sets[~contains.any(axis=1)].any(axis=0))


def _agree_within(readings: PairReadings, boxes: np.ndarray, stopped: Callable[[], bool]) -> bool:
    """Return whether all readings may agree somewhere in the boxes."""
    if not len(boxes):
        return False
    options = PairOptions(max_boxes=max(FEW_BOXES, 2 * len(boxes)))
    return not cover_poses(readings, options, within=Cover(boxes), stopped=stopped).empty
