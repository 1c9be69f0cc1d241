# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""A bag of several files, as the recorder writes it: all messages come, in order of time."""

import shutil

import pytest

pytest.importorskip('rosbags', reason="rosbags, the extra 'bags', is not installed")
pytest.importorskip('mcap', reason="mcap, the extra 'bags', is not installed")

from damaged_bags import PERIOD_NS, RANGE, RANGES_M, START_NS, STORE, range_message  # noqa: E402
from rosbags.rosbag2 import StoragePlugin, Writer  # noqa: E402
from ruamel.yaml import YAML  # noqa: E402

from dg_localization.ros.bags.contents import read_contents  # noqa: E402
from dg_localization.ros.bags.reader import Bag, BagError  # noqa: E402

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
    times_ns = [message.time_ns for message in Bag(tmp_path / 'bag').messages()]
    assert len(times_ns) == n_messages
    assert times_ns == sorted(times_ns)
    assert not read_contents(tmp_path / 'bag').damage


def test_a_message_that_is_much_too_late_is_damage(tmp_path):
    write_split(tmp_path / 'bag', StoragePlugin.MCAP, 1_000_000_001)
    messages = Bag(tmp_path / 'bag').messages()
    read = []
    with pytest.raises(BagError, match='comes after one of'):
        read.extend(iter(lambda: next(messages), None))
    # What had been read before is not lost.
    assert len(read) == 3 * SPLIT_STEP
