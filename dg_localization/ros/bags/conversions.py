# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""From the bytes of a recorded message to those of the type that is installed."""

from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from functools import cached_property
from io import StringIO
from typing import Any

DISTRIBUTIONS = ('JAZZY', 'IRON', 'HUMBLE', 'GALACTIC', 'FOXY', 'ELOQUENT', 'DASHING')
"""Where a bag does not hold the definitions of its types, those of one of these may fit."""


class Conversions:
    """
    Conversions of the types of a bag; topics of one type share them, since each is compiled.

    Parameters
    ----------
    recorded : rosbags.typesys.store.Typestore
        The definitions in the bag.

    """

    def __init__(self, recorded: Any) -> None:
        self._recorded = recorded
        self._known: dict[tuple[str, int], Callable[[bytes], Any]] = {}

    def of(self, info: Any, samples: Sequence[bytes]) -> Callable[[bytes], bytes] | None:
        """
        Return what makes recorded bytes those of the installed type.

        Parameters
        ----------
        info : rosbags.interfaces.TopicInfo
        samples : sequence of bytes
            Messages of the topic, some of which may be damaged.

        Returns
        -------
        callable or None
            None where they do not fit any definition of the type.

        """
        from rosbags.interfaces import MessageDefinitionFormat

        if info.msgtype not in self._installed.types:
            return bytes
        candidates = self._of_distributions
        if info.msgdef.format != MessageDefinitionFormat.NONE:
            candidates = [self._recorded]
        candidates = [
            one for one in candidates if not _renamed(one, self._installed, info.msgtype)
        ]
        fitting = [_n_fitting(samples, info.msgtype, one) for one in candidates]
        if not candidates or (samples and not max(fitting)):
            return None
        # The first of those that fit the most: some samples may be damaged.
        convert = self._conversion(info.msgtype, candidates[fitting.index(max(fitting))])
        return lambda data: bytes(convert(data))

    @cached_property
    def _installed(self) -> Any:
        from rosbags.typesys import Stores, get_typestore

        return get_typestore(Stores.ROS2_JAZZY)

    @cached_property
    def _of_distributions(self) -> list[Any]:
        from rosbags.typesys import Stores, get_typestore

        return [get_typestore(Stores[f'ROS2_{name}']) for name in DISTRIBUTIONS]

    def _conversion(self, type_name: str, recorded: Any) -> Callable[[bytes], Any]:
        """Return the conversion from a definition to the installed one."""
        from rosbags.convert.converter import generate_message_converter

        key = type_name, id(recorded)
        if key not in self._known:
            with redirect_stdout(StringIO()):  # it prints the name of every type it converts
                self._known[key] = generate_message_converter(
                    recorded, self._installed, type_name, type_name, {}, src_is2=True, dst_is2=True
                )
        return self._known[key]


def _n_fitting(samples: Sequence[bytes], type_name: str, typestore: Any) -> int:
    """Return how many messages can be read by the definition in a typestore."""
    count = 0
    for data in samples:
        try:
            typestore.deserialize_cdr(data, type_name)
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
