# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The examples that convert recordings: what they write is localized, with the truth inside."""

import math
from pathlib import Path
import re

import numpy as np
import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")

import convert_lias  # noqa: E402
import convert_mrclam  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from dg_localization.calibration.truth import TrueTrack  # noqa: E402
from dg_localization.ros.bags.offline import BagLocalizer  # noqa: E402
from dg_localization.ros.executables import localize_bag  # noqa: E402

MRCLAM = 'data/mrclam/excerpt_D7_t800_822'
LIAS = 'data/lias_uwb'


def read(bag):
    """Return the messages of a bag by topic, with their receive times in s."""
    store, found = get_typestore(Stores.ROS2_JAZZY), {}
    with AnyReader([bag], default_typestore=store) as reader:
        for connection, time_ns, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((time_ns * 1e-9, message))
    return found


def true_tracks(messages, robots):
    tracks = {}
    for robot in robots:
        stamps, poses = zip(*((t, m.pose) for t, m in messages[f'/{robot}/truth']), strict=True)
        places = [(p.position.x, p.position.y, p.position.z) for p in poses]
        turns = [(q.x, q.y, q.z, q.w) for q in (p.orientation for p in poses)]
        tracks[robot] = TrueTrack(stamps, places, turns)
    return tracks


@pytest.fixture
def localize(tmp_path, monkeypatch):
    """Localize a bag with its parameters; return the estimates with their times in s."""

    def run(bag, *arguments):
        found, tick = [], BagLocalizer.tick

        def recorded(self, time_ns, stop):
            estimate = tick(self, time_ns, stop)
            found.append((time_ns * 1e-9, estimate))
            return estimate

        monkeypatch.setattr(BagLocalizer, 'tick', recorded)
        paths = ('-o', tmp_path / 'answers', '--params', f'{bag}.yaml')
        assert localize_bag([str(text) for text in (bag, *paths, *arguments)]) == 0
        return found

    return run


def holds(placement, places, yaws):
    """Return whether a placement holds the true places, and the headings that it knows."""
    low, high = placement.enclosure_m[:, 0], placement.enclosure_m[:, 1]
    for row in np.flatnonzero(placement.heading_known):
        z, w = placement.orientations_xyzw[row, 2:]
        error = math.remainder(2.0 * math.atan2(z, w) - yaws[row], 2.0 * math.pi)
        if abs(error) > placement.heading_half_width_rad[row]:
            return False
    return bool(np.all((low <= places) & (places <= high)))


def count_held(estimates, tracks, robots):
    """Count the answers, and how many hold the truth."""
    answers = held = 0
    for time_s, estimate in estimates:
        places = np.array([tracks[robot].positions_at([time_s])[0, :2] for robot in robots])
        turns = np.array([tracks[robot].rotations_at([time_s])[0] for robot in robots])
        if not estimate.placements or np.isnan(places).any():
            continue
        yaws = np.arctan2(turns[:, 1, 0], turns[:, 0, 0])
        answers += 1
        held += any(holds(placement, places, yaws) for placement in estimate.placements)
    return answers, held


def test_mrclam_is_localized_with_the_truth_inside(tmp_path, shared, localize):
    bag, robots = tmp_path / 'mrclam', [f'r{number}' for number in range(1, 6)]
    assert convert_mrclam.convert(shared / MRCLAM, bag) == 1
    tracks = true_tracks(read(bag), robots)
    estimates = localize(bag, '--start', '6', '--duration', '5')
    assert all(
        estimate.frame.kind == 'anchors' for _, estimate in estimates if estimate.placements
    )
    assert count_held(estimates, tracks, robots) == (5, 5)


def test_lias_is_localized_with_the_truth_inside(tmp_path, shared, localize):
    bag, tags = tmp_path / 'lias', list(convert_lias.TAGS)
    table = shared / LIAS / 'UWB_static_exp_8_14_pos1_deg_120.csv'
    assert convert_lias.convert(shared / LIAS / 'geometry.json', table, bag) == 3
    tracks = true_tracks(read(bag), tags)
    estimates = localize(bag, '--duration', '10')
    answers, held = count_held(estimates, tracks, tags)
    assert answers >= 19 and held == answers
    widths = [
        np.ptp(placement.enclosure_m, axis=1).max()
        for _, estimate in estimates
        for placement in estimate.placements
    ]
    assert np.median(widths) < 1.0


def test_the_table_of_ranges_in_the_docs_is_localized(tmp_path, monkeypatch, localize):
    page = (Path(convert_lias.__file__).parent / 'bags.md').read_text(encoding='utf-8')
    (code,) = re.findall(r'```python\n(.*?)```', page, re.DOTALL)
    triangle = [('a', 'b', 3.0), ('a', 'c', 4.0), ('b', 'c', 5.0)]
    rows = [f'{10.0 + 0.1 * k},{o},{t},{d}' for k in range(20) for o, t, d in triangle]
    monkeypatch.chdir(tmp_path)
    Path('ranges.csv').write_text('\n'.join(['stamp,observer,target,range', *rows]))
    Path('my_bag.yaml').write_text("/**: {ros__parameters: {robots: ['a', 'b', 'c']}}")
    exec(compile(code, 'bags.md', 'exec'), {})
    found = localize(tmp_path / 'my_bag')
    assert len(found) > 5 and all(len(estimate.placements) == 2 for _, estimate in found)
