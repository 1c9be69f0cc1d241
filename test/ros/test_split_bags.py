# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A bag of several files, as the recorder writes it: all messages come, in order of time."""

from contextlib import contextmanager
import shutil

import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")
pytest.importorskip('mcap', reason="mcap, the extra 'bags', is not installed")

from rosbags.rosbag2 import StoragePlugin  # noqa: E402
from small_bags import LATCHED, PERIOD_NS, START_NS, Recorder, range_message  # noqa: E402

from dg_localization.ros.bags.bag import open_bag  # noqa: E402
from dg_localization.ros.bags.reading import Reading  # noqa: E402


@contextmanager
def opened(path):
    """Open a bag; yield it and its messages."""
    with open_bag(path) as bag:
        yield bag, list(Reading(bag).messages())


@pytest.mark.parametrize('plugin', list(StoragePlugin), ids=str)
@pytest.mark.parametrize('late_ns', [-1, 5_000_000, 999_000_000])
def test_messages_at_the_end_of_a_file_come_in_order(tmp_path, plugin, late_ns):
    """The last message of the first file was received after the first one of the second."""
    times_ns = [START_NS + step * PERIOD_NS for step in range(20)]
    times_ns[9] = times_ns[10] + late_ns
    (tmp_path / 'bag').mkdir()
    for number, part in enumerate((times_ns[:10], times_ns[10:])):
        recorder = Recorder(tmp_path / str(number), plugin)
        recorder.write_at(part)
        (storage,) = (path for path in recorder.close().iterdir() if path.suffix != '.yaml')
        shutil.move(storage, tmp_path / 'bag' / storage.name)
    with opened(tmp_path / 'bag') as (bag, messages):
        assert [message.time_ns for message in messages] == sorted(times_ns)
        assert not bag.damage


def test_what_was_latched_before_the_start_counts(recorder):
    recorder.add('/latched', qos=[LATCHED])
    for step in range(10):
        time_ns = START_NS + step * PERIOD_NS
        if step in (1, 3, 7):
            recorder.write('/latched', step, range_message(time_ns, 1.0 + step))
        recorder.write('/volatile', step, range_message(time_ns, 1.0))
    with open_bag(recorder.close()) as bag:
        read = list(Reading(bag, start_s=0.5).messages())
    assert [message.topic for message in read[:2]] == ['/latched', '/volatile']
    assert read[0].time_ns == START_NS + 5 * PERIOD_NS
    assert len(read) == 1 + 5 + 1
    # The last one before the start, of 0.3 s.
    assert read[0].data == range_message(START_NS + 3 * PERIOD_NS, 4.0)
