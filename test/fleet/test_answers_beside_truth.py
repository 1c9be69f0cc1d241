# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The truth in the frame of an answer: as histories compute it by themselves, and by hand."""

from histories import History, localizer_of
import numpy as np
import pytest

from dg_localization.calibration.truth import FleetTruth, TrueTrack
from dg_localization.fleet import FrameKind
from dg_localization.fleet.rotations import quaternion_of

TICKS_S = np.arange(1.0, 6.0, 1.0)


def dense_track(history, robot):
    """Return the true track of a robot, with a sample at every time that is asked for."""
    times_s = np.union1d(np.arange(0.0, 6.5, 0.1), TICKS_S)
    places, turns = zip(*[history.drives[robot].pose(time_s) for time_s in times_s], strict=True)
    if history.config.dimension == 2:
        places = np.array(places) + [0.0, 0.0, 7.0]
    # The stamps are large in some histories, and are kept as the odometry has them.
    stamps_s = history.start_s + times_s
    return TrueTrack(stamps_s, places, [quaternion_of(turn) for turn in turns])


@pytest.mark.parametrize('dimension', [2, 3])
def test_the_truth_is_put_in_every_kind_of_frame(dimension):
    seen = set()
    for seed in range(16):
        history = History.draw(
            seed, 3, (0, 0, 3)[seed % 3], 6.0, dimension=dimension, cameras=seed % 2 == 0
        )
        if history.config.stamp_error_s > 0.0:
            continue
        fleet, localizer = history.config, localizer_of(history)
        if seed % 4 == 0:
            localizer.add_odometry = lambda *_: None
        tracks = {name: dense_track(history, row) for row, name in enumerate(fleet.robots)}
        for name, anchor in fleet.anchors.items():
            tracks[name] = TrueTrack.at_rest(anchor.coordinates_m)
        for time_s, estimate in history.play(localizer, TICKS_S):
            snapshot = localizer.snapshot(history.start_s + time_s)
            answers = [estimate, *estimate.groups] if estimate.frame else estimate.groups
            for answer in answers:
                if answer.frame.kind == 'robots' and len(answer.frame.points) < dimension:
                    continue  # other axes are any
                wanted_m, turns, _ = history.truth(time_s, answer.frame)
                found = FleetTruth(fleet, tracks).beside(answer.frame, snapshot)
                # Samples of a time of 1.7e9 s are as far apart as its rounding.
                close = {'rtol': 0.0, 'atol': 1e-5}
                np.testing.assert_allclose(found.positions_m, wanted_m, **close)
                np.testing.assert_allclose(found.rotations, turns, **close)
                if answer.placements:
                    missed = [found.outside(one).any() for one in answer.placements]
                    assert not all(missed)
                seen.add(answer.frame.kind)
    assert seen >= set(FrameKind) - ({FrameKind.HEADING} if dimension == 3 else set())
