# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Set inversion: cover every relative pose that all but k readings of a window allow.

A box of poses that more than k readings rule out goes, and so does what more than k readings cut
off one side of it; the rest is halved (Jaulin, Walter, Set inversion via interval analysis,
Automatica 29(4), 1993; Jaulin, Robust set-membership state estimation, Automatica 45(1), 2009).
The boxes are worked off generation by generation: wherever the search stops, those that are left
cover all poses evenly.
"""

from __future__ import annotations

import math

import numpy as np

from dg_localization.interval.kernels import kernel
from dg_localization.pairs.cuts import W_SIZE, cut_box
from dg_localization.pairs.half_spaces import (
    HALF,
    HIGH,
    LOW,
    RULED_OUT,
    SETTLED,
    VIEW,
    view_box,
)

LEAST_CUT = 0.5
"""A box cut to less than this share of its volume is cut again before it is halved or kept."""

SPENT, FIRST, COUNT = 0, 1, 2
"""Of a box: readings that rule it out, and where those still undecided are listed."""


@kernel(borrows=True)
def _record(tops: np.ndarray, faces: np.ndarray, box: np.ndarray) -> None:
    """
    Enter the faces that one reading moved into the lists of the greatest cuts, greatest first.

    `tops` (2, 4, k + 1) holds lower faces, and upper ones with their sign changed.
    """
    most = tops.shape[2]
    for end in range(2):
        for axis in range(4):
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
def read_all(
    box: np.ndarray,
    table: np.ndarray,
    listed: np.ndarray,
    undecided: np.ndarray,
    most: int,
    spare: int,
    work: tuple,
) -> tuple[int, int]:
    """
    Try the first `most` of the listed readings on a box, of which `spare` may rule it out.

    Writes to `undecided` the readings that are, and those not tried; returns their number, and how
    many rule the box out: spare + 1 where they are more than `spare`.
    """
    view, faces, smear, w, tops = work
    view_box(box, view)
    smear[:] = 0.0
    tops[:] = -math.inf
    count, ruled_out = 0, 0
    tried = min(most, listed.shape[0])
    for position in range(tried):
        index = listed[position]
        state = cut_box(faces, smear, w, box, view, table[index])
        if state == RULED_OUT:
            ruled_out += 1
            if ruled_out > spare:
                return count, ruled_out
        elif state != SETTLED:
            undecided[count] = index
            count += 1
            _record(tops, faces, box)
    for position in range(tried, listed.shape[0]):
        undecided[count] = listed[position]
        count += 1
    return count, ruled_out


@kernel(borrows=True)
def cut_to(box: np.ndarray, tops: np.ndarray, spare: int) -> float:
    """Cut a box where more than `spare` readings do; return the share left, zero for none."""
    share = 1.0
    for axis in range(4):
        width = box[HIGH, axis] - box[LOW, axis]
        box[LOW, axis] = max(box[LOW, axis], tops[LOW, axis, spare])
        box[HIGH, axis] = min(box[HIGH, axis], -tops[HIGH, axis, spare])
        if box[LOW, axis] > box[HIGH, axis]:
            return 0.0
        if width > 0.0:
            share *= max(1e-3, (box[HIGH, axis] - box[LOW, axis]) / width)
    return share


@kernel(borrows=True)
def _split_axis(box: np.ndarray, view: np.ndarray, smear: np.ndarray) -> tuple[int, float]:
    """Return the axis along which the undecided readings change most, and by how much in m."""
    axis, change = 0, 0.0
    for candidate in range(4):
        half = view[HALF + candidate]
        if half > 0.0:
            width = box[HIGH, candidate] - box[LOW, candidate]
            along = smear[candidate] * (width / half)
            if along > change:
                axis, change = candidate, along
    return axis, change


@kernel
def _pass_on(
    box: np.ndarray, axis: int, halves: int, boxes: np.ndarray, tickets: np.ndarray, ticket: tuple
) -> None:
    """Write a box, whole or in halves, to the next generation."""
    middle = 0.5 * box[LOW, axis] + 0.5 * box[HIGH, axis]
    for half in range(halves):
        boxes[half] = box
        if halves == 2:
            boxes[half, 1 - half, axis] = middle
        tickets[half, SPENT] = ticket[SPENT]
        tickets[half, FIRST] = ticket[FIRST]
        tickets[half, COUNT] = ticket[COUNT]


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
) -> tuple[int, int, int, int]:
    """
    Cut boxes, and halve what remains undecided.

    Parameters
    ----------
    boxes : numpy.ndarray, shape (n, 2, 4)
    tickets : numpy.ndarray of int, shape (n, 3)
        Of each box: how many readings ruled it out before, and the part of `pool` (first, count)
        that lists those still undecided.
    pool : numpy.ndarray of int
    table : numpy.ndarray, shape (m, COLUMNS)
    limits : tuple
        max_outliers, resolution_m, how many boxes the cover may gain, how many readings to try.
    next_boxes, next_tickets, next_pool : numpy.ndarray
        Receive the boxes of the next generation: room for 2 n boxes, and for all their readings.
    kept : numpy.ndarray, shape (n + 1, 2, 4)
        Receives the boxes that are done.

    Returns
    -------
    processed, following, listed, done : int
        How many boxes were processed, and how many entries of `next_boxes`, `next_pool` and `kept`
        are in use.

    """
    max_outliers, resolution_m, gain, most = limits
    view, faces, smear, w = np.empty(VIEW), np.empty((2, 4)), np.empty(4), np.empty(W_SIZE)
    tops = np.empty((2, 4, max_outliers + 1))
    work = (view, faces, smear, w, tops)
    following, listed, done = 0, 0, 0
    for number in range(boxes.shape[0]):
        if following + done - number >= gain:
            return number, following, listed, done
        box = kept[done]
        box[:] = boxes[number]
        spent, first, count = tickets[number]
        untried = max(0, count - most)
        undecided = next_pool[listed : listed + count]
        count, ruled_out = read_all(
            box, table, pool[first : first + count], undecided, most, max_outliers - spent, work
        )
        spent += ruled_out
        if spent > max_outliers:
            continue
        share = cut_to(box, tops, max_outliers - spent)
        if share == 0.0:
            continue
        axis, change = _split_axis(box, view, smear)
        middle = 0.5 * box[LOW, axis] + 0.5 * box[HIGH, axis]
        small = change <= resolution_m or not box[LOW, axis] < middle < box[HIGH, axis]
        again = untried > 0 or share < LEAST_CUT
        if count <= max_outliers - spent and untried == 0 or small and not again:
            done += 1
            continue
        halves = 1 if small or share < LEAST_CUT else 2
        end = following + halves
        ticket = (spent, listed, count)
        _pass_on(box, axis, halves, next_boxes[following:end], next_tickets[following:end], ticket)
        following = end
        listed += count
    return boxes.shape[0], following, listed, done
