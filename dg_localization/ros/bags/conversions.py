# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
From the bytes of a recorded message to those of the type that is installed.

sensor_msgs/Range has a variance since Iron, and no subscriber of today reads the bytes of before.
"""

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import cache
from io import StringIO
from typing import Any

from dg_localization.ros.bags.storage import Channel

ZSTD_MAGIC = b'\x28\xb5\x2f\xfd'

DISTRIBUTIONS = ('JAZZY', 'IRON', 'HUMBLE', 'GALACTIC', 'FOXY', 'ELOQUENT', 'DASHING')
"""Where a bag does not hold the definition of a type, that of one of these may fit."""


def converter(
    channel: Channel, type_name: str, samples: Sequence[bytes]
) -> Callable[[bytes], bytes] | None:
    """
    Return what makes recorded bytes those of the installed type.

    It is None where the samples, of which some may be damaged, do not fit any definition.
    """
    installed = _typestore('JAZZY')
    if type_name not in installed.types:
        return decompressed
    recorded = _recorded(channel.encoding, channel.definition, type_name)
    stores = [recorded] if recorded else [_typestore(name) for name in DISTRIBUTIONS]
    stores = [store for store in stores if not _renamed(store, installed, type_name)]
    fitting = [_n_fitting(samples, type_name, store) for store in stores]
    if not stores or (samples and not max(fitting)):
        return None
    # The first of those that fit the most: some samples may be damaged.
    return _conversion(stores[fitting.index(max(fitting))], type_name)


@cache
def _conversion(recorded: Any, type_name: str) -> Callable[[bytes], bytes]:
    """Return the conversion from a definition to the installed one."""
    from rosbags.convert.converter import generate_message_converter

    with redirect_stdout(StringIO()):  # it prints the name of every type it converts
        convert = generate_message_converter(
            recorded, _typestore('JAZZY'), type_name, type_name, {}, src_is2=True, dst_is2=True
        )
    return lambda data: bytes(convert(decompressed(data)))


@cache
def _typestore(distribution: str) -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores[f'ROS2_{distribution}'])


@cache
def _recorded(encoding: str, definition: str, type_name: str) -> Any:
    """Return the definition that the bag has; None where there is none that can be parsed."""
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    store = get_typestore(Stores.EMPTY)
    try:
        if encoding == 'ros2msg':
            store.register(get_types_from_msg(definition, type_name))
        else:
            for part in definition.split('=' * 80 + '\n'):
                if part.strip():
                    first, _, rest = part.partition('\n')
                    store.register(get_types_from_idl(rest if first[:4] == 'IDL:' else part))
    except Exception:  # whatever the parsers stumble over
        return None
    return store if type_name in store.fielddefs else None


def _n_fitting(samples: Sequence[bytes], type_name: str, typestore: Any) -> int:
    """Return how many messages can be read by the definition in a typestore."""
    count = 0
    for data in samples:
        try:
            typestore.deserialize_cdr(decompressed(data), type_name)
        except Exception:  # whatever the generated code of rosbags stumbles over
            continue
        count += 1
    return count


def _renamed(recorded: Any, installed: Any, type_name: str) -> bool:
    """
    Return whether a recorded definition has fields that the installed one does not know.

    A converter drops them, and leaves a zero in the field that they should have filled.
    """
    if type_name not in recorded.fielddefs:
        return True
    _, fields = recorded.fielddefs[type_name]
    _, known = installed.fielddefs[type_name]
    return bool({name for name, _ in fields} - {name for name, _ in known})


def decompressed(data: bytes) -> bytes:
    """Return the bytes of a message that the recorder may have compressed."""
    if data[:4] != ZSTD_MAGIC:
        return data
    import zstandard

    return zstandard.ZstdDecompressor().decompressobj().decompress(data)
