# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Set inversion (SIVIA): cover all poses of bodies that all but k readings of each group allow.

A box of poses that more than k readings of a group rule out is discarded, and so is a part that
more than k of them cut off one side of it; the rest is halved (Jaulin, Walter, Set inversion via
interval analysis, Automatica 29(4), 1993; Jaulin, Robust set-membership state estimation,
Automatica 45(1), 2009). The boxes are processed generation by generation: wherever the search
stops, the remaining boxes cover all poses evenly.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.poses.cuts import GROUP, W_SIZE, cut_box
from dg_localization.poses.half_spaces import (
    HALF,
    HIGH,
    LOW,
    RULED_OUT,
    SETTLED,
    VIEW,
    YAW,
    Scratch,
    view_box,
)

SHRUNK_MUCH, SHRUNK_JOINTLY = 0.5, 0.9
"""A box cut to less than this share of its volume is cut again before it is halved or kept: the
poses of several bodies narrow each other."""

FIRST, COUNT, SPENT = 0, 1, 2
"""Columns of the ticket of a box: start and number of its undecided readings, and from `SPENT` on
the number of readings of each group that rule it out."""


@kernel(borrows=True)
def _record(tops: np.ndarray, faces: np.ndarray, box: np.ndarray) -> None:
    """
    Enter the faces that one reading moved into the lists of the greatest cuts, greatest first.

    `tops` (2, 4 n, k + 1) holds lower faces, and upper ones with their sign changed.
    """
    most = tops.shape[2]
    for end in range(2):
        for axis in range(box.shape[1]):
            if faces[end, axis] == box[end, axis]:
                continue
            value = -faces[end, axis] if end == HIGH else faces[end, axis]
            place = most - 1
            if value <= tops[end, axis, place]:
                continue
            while place > 0 and tops[end, axis, place - 1] < value:
                tops[end, axis, place] = tops[end, axis, place - 1]
                place -= 1
            tops[end, axis, place] = value


@kernel(borrows=True)
def _read_all(
    box: np.ndarray,
    table: np.ndarray,
    listed: np.ndarray,
    undecided: np.ndarray,
    most: int,
    spare: np.ndarray,
    scratch: Scratch,
    tops: np.ndarray,
) -> tuple[int, int]:
    """
    Try the first `most` of the listed readings on a box; `spare` more of a group may rule it out.

    Lowers `spare`, and writes the undecided readings and those not tried to `undecided`. Returns
    their number, and the group of which too many rule the box out, or -1.
    """
    view_box(box, scratch.views)
    scratch.smear[:] = 0.0
    tops[:] = -math.inf
    count = 0
    tried = min(most, listed.shape[0])
    for position in range(tried):
        index = listed[position]
        state = cut_box(scratch, box, table[index])
        group = int(table[index, GROUP])
        if state == RULED_OUT:
            spare[group] -= 1
            if spare[group] < 0:
                return count, group
        elif state != SETTLED:
            undecided[count] = index
            count += 1
            _record(tops[group], scratch.faces, box)
    for position in range(tried, listed.shape[0]):
        undecided[count] = listed[position]
        count += 1
    return count, -1


@kernel(borrows=True)
def _cut_to(box: np.ndarray, tops: np.ndarray, spare: np.ndarray) -> tuple[float, int]:
    """
    Cut off the parts of a box that more readings of a group cut off than are tolerated.

    Returns the remaining share of the box, and the group that leaves none of it, or -1.
    """
    share = 1.0
    for axis in range(box.shape[1]):
        width = box[HIGH, axis] - box[LOW, axis]
        for group in range(len(spare)):
            most = spare[group]
            box[LOW, axis] = max(box[LOW, axis], tops[group, LOW, axis, most])
            box[HIGH, axis] = min(box[HIGH, axis], -tops[group, HIGH, axis, most])
            if box[LOW, axis] > box[HIGH, axis]:
                return 0.0, group
        if width > 0.0:
            share *= max(1e-3, (box[HIGH, axis] - box[LOW, axis]) / width)
    return share, -1


@kernel(borrows=True)
def _split_axis(box: np.ndarray, view: np.ndarray, smear: np.ndarray) -> tuple[int, float]:
    """
    Return the axis along which the undecided readings change most, and the change in m.

    For several bodies only the yaws are halved: their places are known from the moment.
    """
    axis, change = 0, 0.0
    first, step = (0, 1) if box.shape[1] == 4 else (YAW, 4)
    for candidate in range(first, box.shape[1], step):
        half = view[candidate // 4, HALF + candidate % 4]
        if half > 0.0:
            width = box[HIGH, candidate] - box[LOW, candidate]
            along = smear[candidate] * (width / half)
            if along > change:
                axis, change = candidate, along
    return axis, change


@kernel
def examine(
    boxes: np.ndarray,
    tickets: np.ndarray,
    pool: np.ndarray,
    table: np.ndarray,
    limits: tuple[int, float, int, int],
    next_boxes: np.ndarray,
    next_tickets: np.ndarray,
    next_pool: np.ndarray,
    kept: np.ndarray,
    guilty: np.ndarray,
) -> tuple[int, int, int, int]:
    """
    Cut boxes (m, 2, 4 n), and halve the undecided ones.

    `tickets` (m, SPENT + groups) locate the undecided readings of each box in `pool`; `limits` are
    max_outliers, resolution_m, the number of boxes that the cover may gain, and the number of
    readings to try. `next_boxes`, `next_tickets` and `next_pool` receive the next generation, with
    room for 2 m boxes and all their readings, `kept` (m + 1, 2, 4 n) receives the finished boxes,
    and `guilty` (groups) counts the boxes that each group ruled out.

    Returns the number of processed boxes, and the numbers of used entries of `next_boxes`,
    `next_pool` and `kept`.
    """
    max_outliers, resolution_m, gain, most = limits
    axes, groups = boxes.shape[2], guilty.shape[0]
    view, faces = np.empty((axes // 4 + 1, VIEW)), np.empty((2, axes))
    tops = np.empty((groups, 2, axes, max_outliers + 1))
    scratch = Scratch(view, faces, np.empty(axes), np.empty(W_SIZE))
    spare = np.empty(groups, np.int64)
    shrunk = SHRUNK_MUCH if axes == 4 else SHRUNK_JOINTLY
    following, listed, done = 0, 0, 0
    for number in range(boxes.shape[0]):
        if following + done - number >= gain:
            return number, following, listed, done
        box = kept[done]
        box[:] = boxes[number]
        first, count = tickets[number, FIRST], tickets[number, COUNT]
        spare[:] = max_outliers - tickets[number, SPENT:]
        untried = max(0, count - most)
        undecided = next_pool[listed : listed + count]
        count, group = _read_all(
            box, table, pool[first : first + count], undecided, most, spare, scratch, tops
        )
        share = 0.0
        if group < 0:
            share, group = _cut_to(box, tops, spare)
        if group >= 0:
            guilty[group] += 1
            continue
        axis, change = _split_axis(box, view, scratch.smear)
        middle = 0.5 * box[LOW, axis] + 0.5 * box[HIGH, axis]
        small = change <= resolution_m or not box[LOW, axis] < middle < box[HIGH, axis]
        again = untried > 0 or share < shrunk
        if count <= spare.min() and untried == 0 or small and not again:
            done += 1
            continue
        halves = 1 if small or share < shrunk else 2
        for half in range(halves):
            next_boxes[following] = box
            if halves == 2:
                next_boxes[following, 1 - half, axis] = middle
            next_tickets[following, FIRST] = listed
            next_tickets[following, COUNT] = count
            next_tickets[following, SPENT:] = max_outliers - spare
            following += 1
        listed += count
    return boxes.shape[0], following, listed, done
