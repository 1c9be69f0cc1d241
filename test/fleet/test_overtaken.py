# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Estimates that hang, fail, or end after a reset do not change later ones."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from itertools import combinations
import math
from threading import Event

from histories import History, localizer_of
import numpy as np
import pytest

import dg_localization.fleet.localizer as localizer_room
from dg_localization.fleet.window.forgetting import Forgotten

TICKS_S = np.arange(1.0, 6.0, 0.5)
ALL_ENDS = frozenset(combinations(('r0', 'r1', 'a0', 'a1', 'a2'), 2))
real = localizer_room.estimate_snapshot


def known_of(estimate):
    """Return what two localizers that know the same agree on."""
    numbers = [placement.number for placement in estimate.placements]
    enclosures = [placement.enclosure_m.tolist() for placement in estimate.placements]
    return numbers, enclosures, estimate.reason, estimate.forgotten, estimate.previous_frame


def forgetting(*arguments):
    """Estimate, and find that nothing may be remembered."""
    estimate, proved = real(*arguments)
    forgotten = Forgotten(ALL_ENDS, math.inf, 'a test', now_too=True)
    return replace(estimate, forgotten=(forgotten,)), proved


def failing(snapshot, *others):
    """Estimate, lose what earlier sets know, and fail then."""
    real(snapshot, *others)
    others[-1].forget(snapshot.config, [Forgotten(ALL_ENDS, math.inf, 'a test')])
    raise RuntimeError('a defect')


def sets_of(localizer):
    return dict(localizer._follower.earlier._sets)


def estimate_by(localizer, snapshot, monkeypatch, how):
    with monkeypatch.context() as patched:
        patched.setattr(localizer_room, 'estimate_snapshot', how)
        return localizer.estimate(snapshot)


@pytest.fixture(params=[0, 3])
def history(request):
    """Two robots with and without anchors, whose pose sets are carried on."""
    return History.draw([1, 5], 2, request.param, 6.0, memory_s=30.0)


def test_an_estimate_that_was_overtaken_changes_nothing(history, monkeypatch):
    hangs, goes_on = Event(), Event()

    def hanging(*arguments):
        hangs.set()
        assert goes_on.wait(60.0)
        return forgetting(*arguments)

    localizer, undisturbed = localizer_of(history), localizer_of(history)
    wanted = [known_of(estimate) for _, estimate in history.play(undisturbed, TICKS_S)]
    found = []
    with ThreadPoolExecutor(1) as pool:
        for time_s, estimate in history.play(localizer, TICKS_S):
            found.append(known_of(estimate))
            if time_s == 2.0:
                snapshot = localizer.snapshot(history.start_s + time_s)
                with monkeypatch.context() as patched:
                    patched.setattr(localizer_room, 'estimate_snapshot', hanging)
                    overtaken = pool.submit(localizer.estimate, snapshot)
                    assert hangs.wait(60.0)
            if time_s == 3.0:
                goes_on.set()
                assert overtaken.result().forgotten
    assert found == wanted


def test_an_estimate_that_fails_changes_nothing(history, monkeypatch):
    localizer = localizer_of(history)
    for time_s, _ in history.play(localizer, TICKS_S):
        known = sets_of(localizer)
        with pytest.raises(RuntimeError, match='a defect'):
            snapshot = localizer.snapshot(history.start_s + time_s)
            estimate_by(localizer, snapshot, monkeypatch, failing)
        assert sets_of(localizer) == known
    assert any(known)


def test_the_estimate_of_a_snapshot_from_before_a_reset_changes_nothing(history, monkeypatch):
    localizer, undisturbed = localizer_of(history), localizer_of(history)
    for time_s, _ in history.play(localizer, TICKS_S):
        snapshot = localizer.snapshot(history.start_s + time_s)
    localizer.reset()
    assert estimate_by(localizer, snapshot, monkeypatch, forgetting).forgotten
    # The clock was set back: it all happens once more.
    anew = zip(history.play(localizer, TICKS_S), history.play(undisturbed, TICKS_S), strict=True)
    for (_, found), (_, wanted) in anew:
        # Numbers are not used again.
        assert known_of(found)[1:4] == known_of(wanted)[1:4]
