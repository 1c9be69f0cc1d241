# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is forgotten, and for how long a pair is in doubt that contradicts itself."""

import math

import numpy as np

from dg_localization.fleet.window.carry import WORLD
from dg_localization.fleet.window.forgetting import (
    CONFIRMING,
    LONGEST_DOUBT_S,
    Doubts,
)

PAIR = (WORLD, 0)
MANY = np.arange(0.0, 100.0, 0.1)


def test_measurements_that_agree_again_end_a_doubt():
    doubts = Doubts()
    assert doubts.settled(PAIR, MANY[MANY <= 5.0], 5.0, complete=True)
    assert doubts.contradicted(PAIR, 6.0) == 5.0
    assert doubts.robots == {0}
    assert doubts.contradicted(PAIR, 7.0) == 5.0
    newer_s = 7.0 + 0.1 * np.arange(1, CONFIRMING + 1)
    assert not doubts.settled(PAIR, newer_s[:-1], 8.0, complete=True)
    assert not doubts.settled(PAIR, newer_s, 8.0, complete=False)
    assert doubts.settled(PAIR, newer_s, 8.0, complete=True)
    assert doubts.robots == set()
    assert doubts.contradicted(PAIR, 9.0) == 8.0


def test_a_doubt_begins_anew_where_measurements_agreed_in_between():
    doubts = Doubts()
    doubts.settled(PAIR, MANY, 5.0, complete=True)
    assert doubts.contradicted(PAIR, 6.0) == 5.0
    assert not doubts.settled(PAIR, np.array([4.0, 6.5]), 7.0, complete=True)
    assert doubts.contradicted(PAIR, 6.1 + LONGEST_DOUBT_S) == 5.0
    # Where nothing new was measured nothing agrees.
    assert not doubts.settled(PAIR, np.array([4.0, 6.5]), 9.0, complete=True)
    assert doubts.contradicted(PAIR, 6.2 + 2.0 * LONGEST_DOUBT_S) == -math.inf


def test_all_is_forgotten_where_a_doubt_lasts():
    doubts = Doubts()
    doubts.settled(PAIR, MANY, 5.0, complete=True)
    assert doubts.contradicted(PAIR, 6.0) == 5.0
    assert doubts.contradicted(PAIR, 6.0 + LONGEST_DOUBT_S) == 5.0
    assert doubts.contradicted(PAIR, 6.1 + LONGEST_DOUBT_S) == -math.inf
    assert doubts.robots == set()


def test_all_is_forgotten_of_what_never_agreed_and_where_time_jumps_back():
    doubts = Doubts()
    assert doubts.contradicted(PAIR, 5.0) == -math.inf
    doubts.settled(PAIR, MANY, 6.0, complete=True)
    assert doubts.contradicted(PAIR, 3.0) == -math.inf
    doubts.settled((0, 1), MANY, 6.0, complete=True)
    assert doubts.contradicted((0, 1), 7.0) == 6.0
    assert doubts.robots == set()
