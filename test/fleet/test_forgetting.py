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
    Forgotten,
    also_forgotten,
    left_out_until_s,
)
from dg_localization.fleet.window.memory import Observation, Window

ENDS = ('r', 'a')
PAIR = (WORLD, 0)
MANY = np.arange(0.0, 100.0, 0.1)


def forgotten(after_s, before_s, **settings):
    return Forgotten(frozenset([ENDS]), before_s, 'a test', after_s, **settings)


def stamps_without(spans, ends=ENDS):
    window = Window({ends: tuple(Observation(float(stamp_s)) for stamp_s in range(10))})
    return [seen.stamp_s for seen in window.without(spans).observations.get(ends, ())]


def test_observations_are_forgotten_in_spans_and_in_either_order():
    spans = also_forgotten({}, [forgotten(2.0, 4.0), forgotten(6.0, 7.0)])
    assert stamps_without(spans) == stamps_without(spans, ENDS[::-1]) == [0, 1, 2, 5, 6, 8, 9]
    assert stamps_without(spans, ('r', 'b')) == [*range(10)]
    assert stamps_without(also_forgotten(spans, [forgotten(-math.inf, 9.0)])) == []


def test_spans_are_kept_no_longer_than_they_matter():
    spans = also_forgotten({}, [forgotten(2.0, 4.0), forgotten(6.0, 7.0)])
    assert also_forgotten(spans, [forgotten(2.0, 5.0)])[ENDS] == ((6.0, 7.0), (2.0, 5.0))
    assert also_forgotten(spans, [forgotten(-math.inf, 8.0)])[ENDS] == ((-math.inf, 8.0),)
    assert also_forgotten(spans, [], oldest_s=4.0) == {ENDS: ((6.0, 7.0),)}
    assert also_forgotten(spans, [], oldest_s=7.0) == {}


def test_only_what_contradicts_itself_is_left_out_of_the_moment():
    known = left_out_until_s({}, [forgotten(2.0, 4.0, now_too=True), forgotten(6.0, 7.0)])
    assert known == {ENDS: 4.0}
    assert left_out_until_s(known, [forgotten(0.0, 3.0, now_too=True)]) == {ENDS: 4.0}


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


def test_a_doubt_ends_also_where_there_is_never_time_to_try_all():
    doubts = Doubts()
    doubts.settled(PAIR, MANY, 5.0, complete=True)
    doubts.contradicted(PAIR, 6.0)
    assert not doubts.settled(PAIR, MANY, 6.0 + LONGEST_DOUBT_S, complete=False)
    assert doubts.settled(PAIR, MANY, 6.1 + LONGEST_DOUBT_S, complete=False)
    assert doubts.robots == set()


def test_a_doubt_begins_anew_where_measurements_agreed_in_between():
    doubts = Doubts()
    doubts.settled(PAIR, MANY, 5.0, complete=True)
    assert doubts.contradicted(PAIR, 6.0) == 5.0
    assert not doubts.settled(PAIR, np.array([4.0, 6.5]), 7.0, complete=True)
    assert doubts.contradicted(PAIR, 6.1 + LONGEST_DOUBT_S) == 5.0
    # Where nothing new was measured nothing agrees.
    assert not doubts.settled(PAIR, np.array([4.0, 6.5]), 9.0, complete=True)
    assert doubts.contradicted(PAIR, 6.2 + 2.0 * LONGEST_DOUBT_S) == -math.inf


def test_nothing_is_in_doubt_that_is_not_remembered_any_more():
    doubts = Doubts()
    for pair in (PAIR, (0, 1)):
        doubts.settled(pair, MANY, 5.0, complete=True)
        doubts.contradicted(pair, 6.0)
    doubts.keep([(0, 1)], 7.0)
    assert doubts.robots == set() and doubts.about((0, 1)) and not doubts.about(PAIR)
    doubts.keep([(0, 1)], 3.0)
    assert not doubts.about((0, 1))


def test_what_was_not_all_tried_is_not_known_to_agree():
    doubts = Doubts()
    assert doubts.settled(PAIR, MANY, 5.0, complete=True)
    assert doubts.settled(PAIR, MANY, 6.0, complete=False)
    assert doubts.contradicted(PAIR, 7.0) == 5.0


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
