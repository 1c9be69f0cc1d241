# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A bag of several files, as the recorder writes it: all messages come, in order of time."""

import shutil

import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")
pytest.importorskip('mcap', reason="mcap, the extra 'bags', is not installed")

from damaged_bags import RANGES_M  # noqa: E402
from rosbags.interfaces import (  # noqa: E402
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from ruamel.yaml import YAML  # noqa: E402
from small_bags import PERIOD_NS, RANGE, START_NS, STORE, range_message  # noqa: E402

from dg_localization.ros.bags.bag import Bag  # noqa: E402
from dg_localization.ros.bags.reading import Reading  # noqa: E402

SPLIT_STEP = 10
SUFFIXES = {StoragePlugin.SQLITE3: '.db3', StoragePlugin.MCAP: '.mcap'}


def times_of(late_ns):
    """
    Return the topics and times of the two files of a bag.

    The last message of the first file was received `late_ns` after the first one of the second.
    """
    rows = [
        (topic, START_NS + step * PERIOD_NS + number)
        for step in range(2 * SPLIT_STEP)
        for number, topic in enumerate(RANGES_M)
    ]
    half = len(rows) // 2
    topic, _ = rows[half - 1]
    rows[half - 1] = topic, rows[half][1] + late_ns
    return rows[:half], rows[half:]


def write_split(bag, plugin, late_ns):
    """Write a bag of two files; return how many messages are in it."""
    bag.mkdir()
    parts = times_of(late_ns)
    names, descriptions = [], []
    for number, rows in enumerate(parts):
        folder = bag.with_name(f'part_{number}')
        with Writer(folder, version=9, storage_plugin=plugin) as writer:
            connections = {t: writer.add_connection(t, RANGE, typestore=STORE) for t in RANGES_M}
            for topic, time_ns in rows:
                writer.write(connections[topic], time_ns, range_message(time_ns, RANGES_M[topic]))
        (storage,) = folder.glob(f'*{SUFFIXES[plugin]}')
        names.append(f'{bag.name}_{number}{SUFFIXES[plugin]}')
        shutil.move(storage, bag / names[-1])
        text = (folder / 'metadata.yaml').read_text()
        descriptions.append(YAML(typ='safe').load(text)['rosbag2_bagfile_information'])
    whole, other = descriptions
    every_ns = [time_ns for rows in parts for _, time_ns in rows]
    whole['relative_file_paths'] = names
    whole['files'] = []
    whole['duration']['nanoseconds'] = max(every_ns) - min(every_ns)
    whole['message_count'] = len(every_ns)
    pairs = zip(
        whole['topics_with_message_count'], other['topics_with_message_count'], strict=True
    )
    for topic, rest in pairs:
        topic['message_count'] += rest['message_count']
    with (bag / 'metadata.yaml').open('w') as file:
        YAML().dump({'rosbag2_bagfile_information': whole}, file)
    return len(every_ns)


@pytest.mark.parametrize('plugin', SUFFIXES, ids=str)
@pytest.mark.parametrize('late_ns', [-1, 5_000_000, 999_000_000])
def test_messages_at_the_end_of_a_file_come_in_order(tmp_path, plugin, late_ns):
    n_messages = write_split(tmp_path / 'bag', plugin, late_ns)
    bag = Bag(tmp_path / 'bag')
    times_ns = [message.time_ns for message in Reading(bag).messages()]
    assert len(times_ns) == n_messages
    assert times_ns == sorted(times_ns)
    assert not bag.damage


def test_receive_times_that_go_back_are_damage_and_come_in_order(tmp_path):
    write_split(tmp_path / 'bag', StoragePlugin.MCAP, -1)
    for late_ns in (3 * 10**9, 3 * 86_400 * 10**9):
        with Writer(tmp_path / f'set_{late_ns}', version=9) as writer:
            connection = writer.add_connection('/a/range/b', RANGE, typestore=STORE)
            for step in (0, 1, 2, 3, 4):
                time_ns = START_NS + step * PERIOD_NS + (late_ns if step == 2 else 0)
                writer.write(connection, time_ns, range_message(time_ns, 3.0))
        bag = Bag(tmp_path / f'set_{late_ns}')
        times_ns = [message.time_ns for message in Reading(bag).messages()]
        assert len(times_ns) == 5 and times_ns == sorted(times_ns)
        (damage,) = bag.damage
        assert f'go back by up to {late_ns / 1e9 - 0.1:.1f} s' in damage


def test_what_was_latched_before_the_start_counts(recorder):
    latched = Qos(
        *(QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL),
        *(QosTime(0, 0), QosTime(0, 0), QosLiveliness.AUTOMATIC, QosTime(0, 0), False),
    )
    recorder.add('/latched', qos=[latched])
    for step in range(10):
        time_ns = START_NS + step * PERIOD_NS
        if step in (1, 3, 7):
            recorder.write('/latched', step, range_message(time_ns, 1.0 + step))
        recorder.write('/volatile', step, range_message(time_ns, 1.0))
    bag = Bag(recorder.close())
    read = list(Reading(bag).messages(0.5))
    assert [message.topic for message in read[:2]] == ['/latched', '/volatile']
    assert read[0].time_ns == bag.start_ns + 5 * PERIOD_NS
    assert len(read) == 1 + 5 + 1
    # The last one before the start, of 0.3 s.
    assert read[0].data == range_message(START_NS + 3 * PERIOD_NS, 4.0)
