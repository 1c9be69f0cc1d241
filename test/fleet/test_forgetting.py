# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""What is forgotten, and for how long a pair is in doubt that contradicts itself."""

import numpy as np

from dg_localization.fleet.window.forgetting import CONFIRMING, Doubts
from dg_localization.fleet.window.memory import WORLD

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
