# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Small bags, and every systematic way to damage them.

A damage is a function that changes the bag in a folder; its name says what it does. The same
number of cases gives the same damages.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
import random
import shutil
import sqlite3
import struct
from typing import Any

import pytest
from sensor_msgs.msg import Range
from small_bags import RANGE, STORE, TRIANGLE, StoragePlugin, stamped, time_ns_of, write_triangles

mcap = pytest.importorskip('mcap.writer', reason="mcap, the extra 'bags', is not installed")

RANGES_M = {f'/{a}/range/{b}': range_m for (a, b), range_m in TRIANGLE.items()}
DEFINITION, _ = STORE.generate_msgdef(RANGE, ros_version=2)
STEPS = 9
CHUNK_BYTES = 1000
CHUNK = 6
HUGE = (2**31, 2**40, 2**63, 2**64 - 1)
OPCODE_BYTES, LENGTH_BYTES = 1, 8
MAGIC_BYTES = 8


@dataclass(frozen=True)
class Damage:
    """
    One way to damage a bag.

    Attributes
    ----------
    name : str
    change : callable
        Changes the bag in the folder that it is given.
    noticeable : bool
        False where it cannot be noticed: bytes of a message that no checksum protects.

    """

    name: str
    change: Callable[[Path], None]
    noticeable: bool = True


def write_bag(path: Path, storage: str) -> None:
    """
    Write an undamaged bag.

    Parameters
    ----------
    path : Path
        A folder that does not exist.
    storage : {'db3', 'mcap', 'mcap without checksums', 'mcap without chunks'}
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


def damages(bag: Path, storage: str, n_bits: int) -> Iterator[Damage]:
    """
    Yield every damage to a bag.

    Parameters
    ----------
    bag : Path
        The undamaged bag.
    storage : str
        As for `write_bag`.
    n_bits : int
        How many single bits to flip are tried.

    """
    data = storage_of(bag).read_bytes()
    yield from _files(data)
    yield from _metadata(bag)
    for k in range(n_bits):
        generator = random.Random(f'{storage} {k}')
        # Spread evenly, so that no part of the file is left out.
        place = (k * len(data) + generator.randrange(len(data))) // n_bits
        bit = generator.randrange(8)
        flipped = bytes([data[place] ^ 1 << bit])
        name = f'bit {bit} of byte {place}'
        yield _spliced(name, place, place + 1, flipped, storage == 'mcap')
    yield from _db3() if storage == 'db3' else _mcap(data)


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
        # The constraints of the recorder are none of whoever damages a file.
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
    for begin, opcode in mcap_records(data):
        end, record = _end(data, begin), f'record {opcode} at {begin}'
        yield _spliced(f'cut at {record}', begin, size)
        yield _spliced(f'cut in {record}', begin + 11, size)
        for length in HUGE:
            new, first = struct.pack('<Q', length), begin + OPCODE_BYTES
            yield _spliced(f'{record}: length {length}', first, first + LENGTH_BYTES, new)
        yield _spliced(f'{record} is gone', begin, end)
        yield _spliced(f'{record} is twice', end, end, data[begin:end])


def mcap_records(data: bytes) -> Iterator[tuple[int, int]]:
    """Yield where each record begins, and its opcode."""
    begin = MAGIC_BYTES
    while begin < len(data) - MAGIC_BYTES:
        yield begin, data[begin]
        begin = _end(data, begin)


def _end(data: bytes, begin: int) -> int:
    (length,) = struct.unpack_from('<Q', data, begin + OPCODE_BYTES)
    return begin + OPCODE_BYTES + LENGTH_BYTES + length
