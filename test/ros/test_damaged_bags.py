# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Bags that are damaged, split or old: nothing breaks, and nothing is lost silently.

The environment variables DAMAGED_BAG_BITS and DAMAGED_BAG_OTHERS say how many flipped bits, and
how many of the other damages, are tried of each storage.
"""

from collections.abc import Callable, Iterator
from functools import partial
import json
import os
from pathlib import Path
import random
import shutil
import sqlite3
import struct
from typing import Any, NamedTuple

import pytest
from ruamel.yaml import YAML
from sensor_msgs.msg import Range
from small_bags import (
    LATCHED,
    RANGE,
    STORE,
    TRIANGLE,
    Recorder,
    StoragePlugin,
    counts,
    stamped,
    time_ns_of,
    write_parameters,
    write_triangles,
)
import zstandard

from dg_localization.ros.bags import localize_bag as module
from dg_localization.ros.bags.bag import open_bag
from dg_localization.ros.bags.reading import Reading

mcap = pytest.importorskip('mcap.writer', reason="mcap, the extra 'bags', is not installed")

N_BITS = int(os.environ.get('DAMAGED_BAG_BITS', '25'))
N_OTHERS = int(os.environ.get('DAMAGED_BAG_OTHERS', '45'))
STORAGES = ('db3', 'mcap', 'mcap without checksums', 'mcap without chunks')
RANGES_M = {f'/{a}/range/{b}': range_m for (a, b), range_m in TRIANGLE.items()}
DEFINITION, _ = STORE.generate_msgdef(RANGE, ros_version=2)
STEPS = 9
CHUNK, CHUNK_BYTES = 6, 1000
HUGE = (2**31, 2**40, 2**63, 2**64 - 1)
OPCODE_BYTES, LENGTH_BYTES = 1, 8
MAGIC_BYTES = 8


class Damage(NamedTuple):
    """
    One way to damage the bag in a folder.

    It is not noticeable where bytes of a message change that no checksum protects.
    """

    name: str
    change: Callable[[Path], None]
    noticeable: bool = True


def write_bag(path: Path, storage: str) -> None:
    """
    Write an undamaged bag.

    Without chunks there are no checksums either, as rosbag2's preset `fastwrite` has it.
    """
    plugin = StoragePlugin.SQLITE3 if storage == 'db3' else StoragePlugin.MCAP
    write_triangles(path, [range(STEPS)], plugin=plugin)
    if storage != 'db3':
        checksums = storage == 'mcap'
        # As rosbag2 does, the chunks small and many.
        write_mcap(
            storage_of(path),
            dict.fromkeys(RANGES_M, (RANGE, DEFINITION)),
            chunk_size=CHUNK_BYTES,
            compression=getattr(mcap.CompressionType, 'ZSTD' if checksums else 'NONE'),
            use_chunking='chunks' not in storage,
            enable_crcs=checksums,
        )


def storage_of(bag: Path) -> Path:
    (path,) = (path for path in bag.iterdir() if path.suffix in ('.db3', '.mcap'))
    return path


def write_mcap(path: Path, kinds: dict[str, tuple[str, str]], **options: Any) -> None:
    """Write ranges on topics, each with the name of a type and a definition."""
    with path.open('wb') as file:
        writer = mcap.Writer(file, **options)
        writer.start(profile='ros2', library='test')
        channels = {}
        for topic, (type_name, definition) in kinds.items():
            schema = writer.register_schema(type_name, 'ros2msg', definition.encode())
            channels[topic] = writer.register_channel(topic, 'cdr', schema)
        for time_ns in map(time_ns_of, range(STEPS)):
            for topic, channel in channels.items():
                data = stamped(Range(range=RANGES_M.get(topic, 1.0)), time_ns)
                writer.add_message(channel, time_ns, data, time_ns)
        writer.finish()


def flipped_bits(storage: str, data: bytes) -> Iterator[Damage]:
    """Yield flips of single bits, spread evenly, so that no part of the file is left out."""
    for k in range(N_BITS):
        generator = random.Random(f'{storage} {k}')
        place = (k * len(data) + generator.randrange(len(data))) // N_BITS
        bit = generator.randrange(8)
        flipped = bytes([data[place] ^ 1 << bit])
        name = f'bit {bit} of byte {place}'
        yield _spliced(name, place, place + 1, flipped, storage == 'mcap')


def _splice(begin: int, end: int, new: bytes, bag: Path) -> None:
    """Put other bytes in the place of some of the storage."""
    path = storage_of(bag)
    data = path.read_bytes()
    path.write_bytes(data[:begin] + new + data[end:])


def _spliced(name: str, begin: int, end: int, new: bytes = b'', noticed: bool = True) -> Damage:
    return Damage(name, partial(_splice, begin, end, new), noticed)


def _files(data: bytes) -> Iterator[Damage]:
    def a_folder(bag: Path) -> None:
        path = storage_of(bag)
        path.unlink()
        path.mkdir()

    def twice(bag: Path) -> None:
        path = storage_of(bag)
        shutil.copy(path, path.with_stem('again'))

    size = len(data)
    yield Damage('no storage', lambda bag: storage_of(bag).unlink())
    yield Damage('the storage is a folder', a_folder)
    yield _spliced('a file of zero bytes', 0, size)
    for percent in range(10, 100, 10):
        begin = size * percent // 100
        yield _spliced(f'cut at {percent} %', begin, size)
        zeros = bytes(min(512, size - begin))
        yield _spliced(f'512 zeros at {percent} %', begin, begin + 512, zeros, False)
    yield _spliced('zeros behind the end', size, size, bytes(4096))
    yield Damage('a second file of the same', twice)


def _metadata(bag: Path) -> Iterator[Damage]:
    text = (bag / 'metadata.yaml').read_text()

    def write(data: bytes, bag: Path) -> None:
        (bag / 'metadata.yaml').write_bytes(data)

    yield Damage('no metadata.yaml', lambda bag: (bag / 'metadata.yaml').unlink())
    for name, data in (
        ('empty', b''),
        ('binary', bytes(range(256))),
        ('a list', b'- 1\n'),
        ('a number', b'1\n'),
        ('not YAML', b'{{{'),
        ('another document', b'a: 1\n'),
        ('UTF-16', text.encode('utf-16')),
    ):
        yield Damage(f'metadata.yaml: {name}', partial(write, data))
    lines = text.splitlines(keepends=True)
    for k, line in enumerate(lines):
        without = ''.join(lines[:k] + lines[k + 1 :])
        yield Damage(f'metadata.yaml without line {k}', partial(write, without.encode()))
        key, colon, value = line.rstrip('\n').partition(': ')
        for other in ('-1', '99999999999999999999', 'null', '[]', 'text') if colon else ():
            if value != other:
                changed = ''.join(lines[:k] + [f'{key}: {other}\n'] + lines[k + 1 :])
                name = f'metadata.yaml, line {k}, {key.strip(" -")}: {other}'
                yield Damage(name, partial(write, changed.encode()))


def _db3() -> Iterator[Damage]:
    for column in ('timestamp', 'topic_id', 'data'):
        for value in ("'text'", "''", 'NULL', '1.5', "x'00ff'", '-1', '0', str(2**63 - 1)):
            for where in ('rowid = 1', 'rowid = 10', f'rowid = {3 * STEPS}', 'rowid > 0'):
                yield _sql(f'UPDATE messages SET {column} = {value} WHERE {where}')
    for column in ('id', 'name', 'type', 'serialization_format', 'offered_qos_profiles'):
        for value in ("'text'", "''", 'NULL', '7', "x'00ff'", "'{'"):
            yield _sql(f'UPDATE topics SET {column} = {value} WHERE rowid = 1')
    for kind in ('sensor_msgs/msg/PointCloud2', 'std_msgs/msg/String', 'antigravity/msg/X', '.'):
        yield _sql(f"UPDATE topics SET type = '{kind}' WHERE rowid = 2")
    for table in ('messages', 'topics', 'schema', 'metadata', 'message_definitions'):
        yield _sql(f'DROP TABLE {table}')
        yield _sql(f'DELETE FROM {table}')
    yield _sql('DELETE FROM messages WHERE rowid = 5')
    yield _sql('DELETE FROM topics WHERE rowid = 2')
    yield _sql('DROP INDEX timestamp_idx')
    yield _sql("INSERT INTO topics SELECT 9, name, type, 'cdr', '', '' FROM topics WHERE id = 1")
    yield _sql('UPDATE messages SET rowid = 1000 - rowid')
    yield _sql('UPDATE schema SET schema_version = 99')
    yield _sql("UPDATE schema SET schema_version = 'new'")
    yield _sql("UPDATE message_definitions SET encoding = 'json'")
    yield _sql("UPDATE message_definitions SET encoded_message_definition = 'int32 x'")
    yield _sql(
        'UPDATE message_definitions SET encoded_message_definition = '
        "replace(encoded_message_definition, 'float32 range', 'float32 rangf')"
    )
    for first in (1, 2, 3):
        yield _sql(f"UPDATE messages SET data = x'0001' WHERE rowid = {first}")
    yield _sql("UPDATE messages SET data = x'00010000' || randomblob(100) WHERE topic_id = 1")
    yield Damage('a journal that was left', lambda bag: _beside(bag, '-journal'))
    yield Damage('a write-ahead log that was left', lambda bag: _beside(bag, '-wal'))


def _beside(bag: Path, ending: str) -> None:
    path = storage_of(bag)
    path.with_name(path.name + ending).write_bytes(b'x' * 100)


def _sql(statement: str) -> Damage:
    return Damage(statement, partial(_execute, statement))


def _execute(statement: str, bag: Path) -> None:
    with sqlite3.connect(storage_of(bag)) as base:
        # Damage does not respect the constraints of the recorder.
        base.execute('PRAGMA writable_schema = ON')
        base.execute("UPDATE sqlite_master SET sql = replace(sql, 'NOT NULL', '')")
    with sqlite3.connect(storage_of(bag)) as base:
        try:
            base.execute(statement)
        except sqlite3.IntegrityError:
            base.execute('PRAGMA ignore_check_constraints = ON')
    base.close()


def _mcap(data: bytes) -> Iterator[Damage]:
    size = len(data)
    for begin, opcode in _records(data):
        end, record = _end(data, begin), f'record {opcode} at {begin}'
        yield _spliced(f'cut at {record}', begin, size)
        yield _spliced(f'cut in {record}', begin + 11, size)
        for length in HUGE:
            new, first = struct.pack('<Q', length), begin + OPCODE_BYTES
            yield _spliced(f'{record}: length {length}', first, first + LENGTH_BYTES, new)
        yield _spliced(f'{record} is gone', begin, end)
        yield _spliced(f'{record} is twice', end, end, data[begin:end])


def _records(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each record begins, and its opcode."""
    begin = MAGIC_BYTES
    while begin < len(data) - MAGIC_BYTES:
        yield begin, data[begin]
        begin = _end(data, begin)


def _end(data: bytes, begin: int) -> int:
    (length,) = struct.unpack_from('<Q', data, begin + OPCODE_BYTES)
    return begin + OPCODE_BYTES + LENGTH_BYTES + length


@pytest.fixture
def run(localize, capsys, monkeypatch):
    """Localize a bag; return the exit code, the report, the answers and what was printed."""
    # The parameters are read only once: a node is made for that, which takes longer than the rest.
    task = module.read_task(write_parameters(localize.folder), [])
    monkeypatch.setattr(module, 'read_task', lambda *_: task)

    def run(bag):
        with monkeypatch.context() as patched:
            # JSON is YAML; the writer of answers would take longer for YAML than all the rest.
            patched.setattr(YAML, 'dump', lambda _, tree, stream: json.dump(tree, stream))
            code, report = localize(bag)
        answers = localize.output / 'out.mcap'
        found = answers.read_bytes() if answers.exists() else None
        printed = capsys.readouterr()
        return code, report, found, printed.out + printed.err

    return run


def wrong_about(ended, answers, damage):
    """Return what a run on a damaged bag did wrong; empty when nothing."""
    code, report, found, printed = ended
    if code not in (0, 1):
        return f'exit code {code}'
    if report is None and found is not None:
        return 'answers without a report'
    if code == 1 and report is None and not printed.strip():
        return 'it failed without a word'
    if code == 1 and report is not None and not (report['ending'] or report['damage']):
        return 'it failed, and the report does not say why'
    said = report is not None and bool(report['rejected'] or report['notices'])
    if code == 0 and found != answers and not said:
        if damage.noticeable:
            return 'answers are lost or changed without a word'
        if found is None:
            return 'no answers and exit code 0'
    return ''


@pytest.mark.parametrize('storage', STORAGES)
def test_a_damaged_bag_never_loses_anything_silently(run, tmp_path, storage):
    whole, bag = tmp_path / 'whole', tmp_path / 'bag'
    write_bag(whole, storage)
    code, report, answers, _ = run(whole)
    assert code == 0 and report['ticks'] == 4 and report['damage'] == [] and answers
    data = storage_of(whole).read_bytes()
    others = [*_files(data), *_metadata(whole), *(_db3() if storage == 'db3' else _mcap(data))]
    random.Random(storage).shuffle(others)
    failures = []
    for damage in (*flipped_bits(storage, data), *others[:N_OTHERS]):
        shutil.rmtree(bag, ignore_errors=True)
        shutil.copytree(whole, bag)
        damage.change(bag)
        try:
            wrong = wrong_about(run(bag), answers, damage)
        except Exception as error:  # what a user would see as a traceback
            wrong = f'{type(error).__name__}: {error}'
        if wrong:
            failures.append(f'{damage.name}: {wrong}')
    assert not failures, '\n'.join(failures)


@pytest.mark.parametrize('storage', ['mcap', 'db3'])
def test_a_bag_damaged_in_the_middle_gives_what_is_before(localize, tmp_path, storage, capsys):
    bag = tmp_path / 'bag'
    if storage == 'mcap':
        write_bag(bag, storage)
        data = bytearray(storage_of(bag).read_bytes())
        last_chunk = {opcode: begin for begin, opcode in _records(data)}[CHUNK]
        data[last_chunk + 100] ^= 1
    else:
        recorder = Recorder(bag, StoragePlugin.SQLITE3)
        recorder.write_triangle(range(21))
        # One large message, whose pages the storage chains, holds the damage.
        recorder.write_range('/a/range/b', 21, 3.0, frame_id='x' * 40_000)
        recorder.write_triangle(range(22, 42))
        data = bytearray(storage_of(recorder.close()).read_bytes())
        page = (data.index(b'x' * 4000) // 4096 + 1) * 4096
        data[page : page + 8192] = bytes(8192)
    storage_of(bag).write_bytes(data)
    code, report = localize(bag)
    assert code == 1 and report['ending'] == ''
    assert report['ticks'] == counts(localize.output)['/localizer/feasible_poses']
    assert 0 < report['ticks'] < 4 if storage == 'mcap' else report['ticks'] == 10
    assert any('what follows is not read' in text for text in report['damage'])
    assert 'The bag is damaged' in capsys.readouterr().out


def test_a_topic_of_which_nothing_can_be_read_is_damage(localize, recorder, capsys):
    recorder.write_triangle(range(11))
    for step in range(11):
        recorder.write('/b/range/a', step, b'\x00\x01\x00\x00damaged')
    code, report = localize(recorder.close())
    assert code == 1 and report['accepted'] == 33 and report['ticks'] == 5
    assert 'The bag is damaged: /b/range/a' in capsys.readouterr().out


@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_a_bag_without_messages_is_refused_with_a_sentence(localize, tmp_path, plugin, capsys):
    recorder = Recorder(tmp_path / 'bag', plugin)
    recorder.add('/a/range/b')
    assert localize(recorder.close()) == (1, None)
    assert 'it has no messages' in capsys.readouterr().err


@pytest.mark.parametrize('time_ns', [-1, time_ns_of(10**10), 2**63 - 1])
def test_a_damaged_time_does_not_make_a_bag_of_centuries(localize, tmp_path, time_ns, capsys):
    bag = write_triangles(tmp_path / 'bag', [range(11)], plugin=StoragePlugin.SQLITE3)
    with sqlite3.connect(storage_of(bag)) as base:
        base.execute('UPDATE messages SET timestamp = ? WHERE id = 5', [time_ns])
    code, report = localize(bag)
    assert code == 1 and report['ticks'] == 5
    assert 'receive times of 1 messages are not within' in capsys.readouterr().out


@pytest.mark.parametrize('step', [0, 15, 30], ids=['first', 'in the middle', 'last'])
@pytest.mark.parametrize('days', [-3, 3], ids=['early', 'late'])
def test_a_gap_of_days_is_named_and_skipped(localize, recorder, step, days, capsys):
    """One message was received days before or after all others, wherever it is in the file."""
    recorder.write_triangle(range(step))
    recorder.write_range('/a/range/b', step + days * 864_000, 3.0, stamp_ns=time_ns_of(step))
    recorder.write_triangle(range(step, 31))
    code, report = localize(recorder.close())
    (gap,) = report['gaps']
    assert 15 <= report['ticks'] <= 15 + 50 + 1
    assert gap['last_s'] - gap['first_s'] == pytest.approx(3 * 86_400, abs=60)
    told = capsys.readouterr().out
    assert 'Nothing was received from' in told and 'days, ' in told
    # A time that goes back within the file is damage.
    in_order = step == 0 and days < 0
    assert any('receive times go back by up to' in text for text in report['damage']) != in_order
    assert code == bool(report['damage'])


@pytest.mark.parametrize(
    ('before', 'after', 'said'),
    [
        ('storage_identifier: mcap', 'storage_identifier: ""', ''),
        ('version: 9', 'version: 10', ''),
        ('version: 9', 'version: x', ''),
        ('bag.mcap', 'other.mcap', 'files are missing: other.mcap'),
        ('rosbag2_bagfile_information:', '{{{', 'metadata.yaml cannot be used'),
        ('name: /b/range/c', 'name: /b/range/x', '/b/range/c: the files hold 21 messages'),
    ],
)
def test_a_bag_with_broken_metadata_is_read(localize, triangle_bag, before, after, said):
    path = triangle_bag / 'metadata.yaml'
    assert before in path.read_text()
    path.write_text(path.read_text().replace(before, after))
    _, report = localize(triangle_bag)
    found = [*report['damage'], *report['notices']]
    assert report['ticks'] == 10 and report['accepted'] == 63
    assert any(text.startswith(said) for text in found) if said else not found


def test_topics_whose_definitions_cannot_be_parsed_are_passed_over(localize, tmp_path):
    """Topics of service introspection have the definition of a service."""
    text = 'int32 x\n---\n=== bad ===\nint32 y'
    kinds = {
        '/a/range/b': (RANGE, DEFINITION),
        # Some converters leave out the folder.
        '/a/range/c': ('sensor_msgs/Range', DEFINITION),
        # A definition of a known type that is damaged.
        '/b/range/c': (RANGE, text),
        '/x/_service_event': ('std_srvs/srv/Trigger_Event', text),
    }
    write_mcap(tmp_path / 'bag.mcap', kinds)
    code, report = localize(tmp_path / 'bag.mcap')
    assert code == 0 and report['accepted'] == 3 * STEPS and report['damage'] == []
    assert report['notices'] == ['topics that are no input: 1 (/x/_service_event)']


@pytest.mark.parametrize('suffix', ['zst', 'zstd'])
@pytest.mark.parametrize('plugin', list(StoragePlugin))
def test_a_file_that_is_compressed_as_a_whole_is_read(localize, tmp_path, plugin, suffix):
    storage = storage_of(write_triangles(tmp_path / 'bag', [range(21)], plugin=plugin))
    packed = tmp_path / f'{storage.name}.{suffix}'
    packed.write_bytes(zstandard.compress(storage.read_bytes()))
    code, report = localize(packed)
    assert code == 0 and report['ticks'] == 10 and report['damage'] == []
    # Compressed in the folder: first a copy beside the file, then in its place.
    shutil.copy(packed, storage.parent)
    for notices in ([f'{packed.name} is passed over, as a copy of {storage.name}'], []):
        code, report = localize(storage.parent)
        assert (code, report['accepted'], report['notices']) == (0, 63, notices)
        storage.unlink(missing_ok=True)
    packed.write_bytes(packed.read_bytes()[:100])
    assert localize(packed) == (1, None)


def test_a_database_of_eloquent_is_read(localize, tmp_path):
    """It has neither profiles nor definitions, and Range has no variance."""
    plugin = StoragePlugin.SQLITE3
    storage = storage_of(write_triangles(tmp_path / 'bag', [range(21)], plugin=plugin))
    with sqlite3.connect(storage) as base:
        for table in ('schema', 'metadata', 'message_definitions'):
            base.execute(f'DROP TABLE {table}')
        for column in ('offered_qos_profiles', 'type_description_hash'):
            base.execute(f'ALTER TABLE topics DROP COLUMN {column}')
        base.execute('UPDATE messages SET data = substr(data, 1, length(data) - 4)')
    code, report = localize(storage)
    assert code == 0 and report['accepted'] == 63


@pytest.mark.parametrize('plugin', list(StoragePlugin), ids=str)
@pytest.mark.parametrize('late', [-1e-8, 0.05, 9.99])
def test_messages_at_the_end_of_a_file_come_in_order(tmp_path, plugin, late):
    """The last message of the first file was received after the first one of the second."""
    steps = [*range(9), 10 + late, *range(10, 20)]
    (tmp_path / 'bag').mkdir()
    for number, part in enumerate((steps[:10], steps[10:])):
        recorder = Recorder(tmp_path / str(number), plugin)
        for step in part:
            recorder.write_range('/a/range/b', step, 3.0)
        storage = storage_of(recorder.close())
        shutil.move(storage, tmp_path / 'bag' / storage.name)
    with open_bag(tmp_path / 'bag') as bag:
        times_ns = [message.time_ns for message in Reading(bag).messages()]
        assert times_ns == sorted(map(time_ns_of, steps)) and not bag.damage


def test_what_was_latched_before_the_start_counts(recorder):
    recorder.add('/latched', qos=[LATCHED])
    for step in range(10):
        if step in (1, 3, 7):
            recorder.write_range('/latched', step, 1.0 + step)
        recorder.write_range('/volatile', step, 1.0)
    with open_bag(recorder.close()) as bag:
        read = list(Reading(bag, start_s=0.5).messages())
    assert [message.topic for message in read[:2]] == ['/latched', '/volatile']
    assert read[0].time_ns == time_ns_of(5) and len(read) == 1 + 5 + 1
    # The last one before the start, of 0.3 s.
    assert read[0].data == stamped(Range(range=4.0), time_ns_of(3))
