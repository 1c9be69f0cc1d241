# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Names of the ids in messages of drivers, and the matrices of their cameras."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
import re
from typing import Any

from dg_localization.fleet import InputState, LinkKey
from dg_localization.ros.interface.links import ANY_OBSERVER, STRANGERS, Link
from dg_localization.ros.interface.parameters.spec import refused
from msg_adapters import CameraReading, IdentifiedReading, PixelReading

LINE = re.compile(r'(?:"([^"]+)"|([^\s"]\S*))\s+([^\s"]+)')
# Stands in a table for an id that is no robot and no anchor.
IGNORED = '-'
OTHER_UNKNOWN = 'other ids'


def parse_ids(texts: Iterable[str]) -> dict[str, str]:
    """
    Read a table of ids from its lines: ``ID NAME``, with ``-`` for an id that is to be ignored.

    An id with blanks, such as a class of a detector, stands in double quotes:
    ``"potted plant" -``. A wrong line and an id that occurs twice raise ValueError.
    """
    table: dict[str, str] = {}
    for text in texts:
        line = LINE.fullmatch(text.strip())
        if line is None:
            wanted = "it must read 'ID NAME', or '\"ID WITH BLANKS\" NAME'"
            raise ValueError(f"'{text}' is not allowed: {wanted}")
        quoted, plain, name = line.groups()
        if (quoted or plain) in table:
            raise ValueError(f"'{text}' is not allowed: id '{quoted or plain}' is named twice")
        table[quoted or plain] = name
    return table


def ids_from(values: Mapping[str, Any], points: Sequence[str]) -> dict[str, str]:
    """Return the names that ids in messages stand for."""
    with refused("parameter 'ids': "):
        ids = parse_ids(filter(None, values['ids']))
        for name in ids.values():
            if name not in (*points, IGNORED):
                allowed = f"one of {', '.join(points)}, or '{IGNORED}' to ignore the id"
                raise ValueError(f"'{name}' is not allowed, it must be {allowed}")
    return ids


class Identities:
    """
    The names of ids by a table; a name of the fleet is its own id.

    Parameters
    ----------
    table : mapping of str to str
        The result of `parse_ids`.
    points : iterable of str
        Robots and landmarks of the fleet.

    """

    def __init__(self, table: Mapping[str, str], points: Iterable[str]) -> None:
        self._names = {point: point for point in points}
        # Every name is kept, so unknown names are limited.
        self._most_unknown = max(STRANGERS, len(self._names))
        self._names |= table
        self._unknown: set[str] = set()

    def observer(self, link: Link, observer_id: str) -> str:
        """Return the observer; raise ValueError if there is none, or if there are two."""
        named = link.key.observer
        name = self._names.get(observer_id, IGNORED) if observer_id else named
        if name == ANY_OBSERVER:
            advice = f'name the observer in the link of {link.topic} instead of {ANY_OBSERVER}'
            raise ValueError(f'the message does not say who measured: {advice}')
        if name == IGNORED:
            raise ValueError(
                f"observer id '{observer_id}' has no name in the parameter `ids`: name it there"
            )
        if named not in (ANY_OBSERVER, name):
            raise ValueError(f"observer id '{observer_id}' is that of {name}, not of {named}")
        return name

    def targets(self, reading: IdentifiedReading) -> Iterator[tuple[int, str]]:
        """Yield the row and the name of each target that is not ignored."""
        for row, target_id in enumerate(reading.target_ids):
            name = self._names.get(target_id) or self._unknown_name(target_id)
            if name != IGNORED:
                yield row, name

    def _unknown_name(self, target_id: str) -> str:
        """Return a name for an id that is not in the table, so that it is counted and shown."""
        if len(self._unknown) < self._most_unknown:
            self._unknown.add(target_id)
        if target_id not in self._unknown:
            return OTHER_UNKNOWN
        return f'id {target_id[:40]}'


class Cameras:
    """The newest camera matrix of each topic."""

    def __init__(self) -> None:
        self._cameras: dict[Link, CameraReading] = {}
        self._arrivals: dict[LinkKey, tuple[int, float]] = {}

    def keep(self, link: Link, camera: CameraReading, now_s: float) -> None:
        """Keep one camera matrix."""
        # Of two topics with one frame, the newest matrix counts: it comes last.
        self._cameras.pop(link, None)
        self._cameras[link] = camera
        count, _ = self._arrivals.get(link.key, (0, now_s))
        self._arrivals[link.key] = count + 1, now_s

    def rays(self, link: Link, reading: PixelReading) -> IdentifiedReading:
        """Return the rays to pixels; raise ValueError if the matrix of their camera is unknown."""
        cameras = {
            camera.frame_id.removeprefix('/'): camera
            for other, camera in self._cameras.items()
            if other.key.observer == link.key.observer
        }
        camera = cameras.get(reading.frame_id.removeprefix('/'))
        if camera is None:
            others = ', '.join(f"'{frame}'" for frame in cameras)
            hint = f'it has arrived in frames {others}' if others else 'is there a link to it?'
            raise ValueError(
                f'the pixels need a sensor_msgs/msg/CameraInfo of {link.key.observer} in frame '
                f"'{reading.frame_id}', which has not arrived: {hint}"
            )
        return reading.seen_by(camera)

    def states(self, now_s: float) -> Iterator[InputState]:
        """Yield the states of the camera topics; a matrix does not age."""
        for key, (count, stamp_s) in self._arrivals.items():
            yield InputState(key, count, {}, '', max(0.0, now_s - stamp_s), in_use=True)
