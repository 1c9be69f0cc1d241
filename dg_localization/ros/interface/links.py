# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Links: which topic carries whose measurement of whom."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
import math
import re
from string import Formatter
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dg_localization.fleet import (
    DifferenceErrorModel,
    ElevationErrorModel,
    LinkKey,
    LinkKind,
    RangeErrorModel,
    SensorBounds,
)
from dg_localization.fleet.rotations import quaternion_of_euler, rotation_of_quaternion
from dg_localization.ros.interface.parameters.table import fields_of
from msg_adapters import (
    BearingReading,
    CameraReading,
    ElevationReading,
    IdentifiedReading,
    OdometryReading,
    PeersReading,
    PixelReading,
    RangeReading,
    UnknownTypeError,
    adapter_for,
    known_types,
)

# Their messages never say who measured.
NAMELESS = {PeersReading, PixelReading}

# Stands for the observer in a link whose messages say who measured.
ANY_OBSERVER = '*'
ANY_NAME = '[A-Za-z][A-Za-z0-9_]*'

# How the sensor of peers is turned in the body of its robot.
TURNS = ('roll', 'pitch', 'yaw')
# What a link string may override, by what the link measures.
RANGE_FIELDS = fields_of(RangeErrorModel, 'range.')
del RANGE_FIELDS['beyond_max_is_far']
RANGE_BOUNDS = tuple(name for name in RANGE_FIELDS if not name.startswith('expected_error'))
BEARING_FIELDS = {
    'half_width': 'bearing_half_width_rad',
    'expected_error': 'bearing_expected_error_rad',
}
ELEVATION_FIELDS = fields_of(ElevationErrorModel, 'elevation.')
# Peers may be ranges, too, which have bounds of these names.
DIFFERENCE_FIELDS = {
    f'difference_{name}': field
    for name, field in fields_of(DifferenceErrorModel, 'range_difference.').items()
}
ERROR_MODELS = {
    'range_error': ((LinkKind.RANGE, LinkKind.PEERS), RANGE_FIELDS),
    'elevation_error': ((LinkKind.ELEVATION,), ELEVATION_FIELDS),
    'range_difference_error': ((LinkKind.PEERS,), DIFFERENCE_FIELDS),
}
STAMP_OFFSET = 'stamp_offset'


class InputKind(NamedTuple):
    """
    A kind of input: its readings, its topics, and what its links may override.

    `fields` stand in braces in a template, `template_type` is the type of its topics.
    """

    readings: tuple[type, ...]
    fields: tuple[str, ...]
    overrides: tuple[str, ...]
    template_type: str = ''


KINDS = {
    LinkKind.RANGE: InputKind(
        (RangeReading,),
        ('observer', 'target'),
        (*RANGE_FIELDS, STAMP_OFFSET),
        'sensor_msgs/msg/Range',
    ),
    LinkKind.BEARING: InputKind(
        (BearingReading,),
        ('observer', 'target'),
        (*BEARING_FIELDS, STAMP_OFFSET),
        'geometry_msgs/msg/Vector3Stamped',
    ),
    LinkKind.ODOMETRY: InputKind(
        (OdometryReading,), ('robot',), (STAMP_OFFSET,), 'nav_msgs/msg/Odometry'
    ),
    LinkKind.PEERS: InputKind(
        (PeersReading, IdentifiedReading, PixelReading),
        ('observer',),
        (*RANGE_BOUNDS, 'half_width', *DIFFERENCE_FIELDS, *TURNS, STAMP_OFFSET),
        'sensor_msgs/msg/PointCloud2',
    ),
    LinkKind.ELEVATION: InputKind(
        (ElevationReading,),
        ('observer',),
        (*ELEVATION_FIELDS, STAMP_OFFSET),
        'geometry_msgs/msg/PointStamped',
    ),
    LinkKind.CAMERA: InputKind((CameraReading,), ('observer',), ()),
}
KIND_OF_VALUE = {value: kind for kind, one in KINDS.items() for value in one.readings}


@dataclass(frozen=True)
class Link:
    """
    One input topic.

    Attributes
    ----------
    topic : str
        Name of the topic.
    type_name : str
        Its message type, one that has an adapter.
    key : LinkKey
        What is measured, by whom, of whom; identity comes from here, never from a `frame_id`.
    explicit : bool
        Whether it was named one by one, so that its silence is worth a warning.
    overrides : mapping of str to float
        Error bounds that differ from the fleet's, by their name without the prefix; what is added
        to stamps; for peers, how their sensor is turned.

    """

    topic: str
    type_name: str
    key: LinkKey
    explicit: bool = False
    overrides: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def stamp_offset_s(self) -> float:
        """What is added to the stamps of the messages."""
        return self.overrides.get(STAMP_OFFSET, 0.0)

    def bounds_within(self, of_all: SensorBounds) -> SensorBounds:
        """Return the error bounds of the link, those of the fleet where it states none."""
        kind, stated = self.key.kind, dict[str, Any]()
        if kind in (LinkKind.BEARING, LinkKind.PEERS):
            stated |= self._stated(BEARING_FIELDS)
        for name, (kinds, fields) in ERROR_MODELS.items():
            if kind in kinds:
                stated[name] = replace(getattr(of_all, name), **self._stated(fields))
        return replace(of_all, **stated)

    def _stated(self, fields: Mapping[str, str]) -> dict[str, Any]:
        """Return the fields that the overrides state."""
        stated = fields.keys() & self.overrides
        return {fields[name]: self.overrides[name] for name in stated}

    def turned(self, rays_xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rays of a sensor of peers, shape (k, 3), in the body frame of the observer."""
        roll_rad, pitch_rad, yaw_rad = (self.overrides.get(name, 0.0) for name in TURNS)
        if not (roll_rad or pitch_rad or yaw_rad):
            return rays_xyz
        turn = rotation_of_quaternion(quaternion_of_euler(roll_rad, pitch_rad, yaw_rad))
        return rays_xyz @ turn.T


def parse_link(text: str) -> Link:
    """
    Read a link from its string: ``TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]``.

    Odometry, elevations, peers and cameras have no target; the observer of peers is ``*`` where
    their messages say who measured. For example
    ``/uwb_3/to_4 sensor_msgs/msg/Range robot_3 robot_4 max_error=1.2``. ValueError
    says which part is missing or wrong, and what would be right.
    """
    words = text.split()
    names = [word for word in words if '=' not in word]
    if len(names) not in (3, 4):
        raise ValueError("it must read 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'")
    topic, type_name, observer, target = [*names, ''][:4]
    kind = _kind_of(type_name)
    if bool(target) != ('target' in KINDS[kind].fields):
        wanted = 'takes no target' if target else 'needs an observer and a target'
        raise ValueError(f'a link of type {type_name} {wanted}')
    if observer == ANY_OBSERVER and kind is not LinkKind.PEERS:
        raise ValueError(f'a link of type {type_name} needs the name of its observer')
    if observer == ANY_OBSERVER and adapter_for(type_name).value_class in NAMELESS:
        raise ValueError(
            f'messages of type {type_name} do not say who measured; name the observer'
        )
    if observer == target:
        raise ValueError(f"'{observer}' cannot measure itself; name two different points")
    check_topic(topic)
    overrides: dict[str, float] = {}
    for name, value in (_parse_override(word, kind) for word in words if '=' in word):
        if name in overrides:
            raise ValueError(f"'{name}' is named twice, name it once")
        overrides[name] = value
    return Link(topic, type_name, LinkKey(kind, observer, target), True, overrides)


def _kind_of(type_name: str) -> LinkKind:
    inputs = [name for name in known_types() if adapter_for(name).value_class in KIND_OF_VALUE]
    if type_name not in inputs:
        last = type_name.rpartition('/')[2]
        meant = [name for name in inputs if name.rpartition('/')[2] == last]
        wanted = (
            f"did you mean '{meant[0]}'?" if meant else f'it must be one of {", ".join(inputs)}'
        )
        raise ValueError(f"type '{type_name}' is no input; {wanted}")
    adapter = adapter_for(type_name)
    try:
        adapter.message_class()
    except UnknownTypeError as error:
        raise ValueError(str(error)) from None
    return KIND_OF_VALUE[adapter.value_class]


def _parse_override(word: str, kind: LinkKind) -> tuple[str, float]:
    name, _, text = word.partition('=')
    if name not in KINDS[kind].overrides:
        allowed = ', '.join(KINDS[kind].overrides) or 'nothing'
        article = 'an' if kind[0] in 'aeiou' else 'a'
        raise ValueError(
            f"'{name}' cannot be overridden here; {article} {kind} link allows {allowed}"
        )
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ValueError(f"'{word}' must end in a finite number")
    return name, value


@dataclass(frozen=True)
class Template:
    """
    A way to name the topics of one kind of measurement.

    Attributes
    ----------
    text : str
        The topic with the names of `fields` in braces; empty for no topics.
    type_name : str
        Message type of these topics.
    overrides : mapping of str to float
        Those of its links.

    """

    text: str
    type_name: str
    overrides: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def kind(self) -> LinkKind:
        """What the topics measure."""
        return _kind_of(self.type_name)

    @property
    def fields(self) -> tuple[str, ...]:
        """What must stand in braces."""
        return KINDS[self.kind].fields

    @property
    def shape(self) -> str:
        """The text with nothing in its braces: templates of one shape give the same topics."""
        return re.sub(r'{\w+}', '{}', self.text)

    def check(self) -> None:
        """Raise ValueError unless the text is empty or holds each of `fields` once."""
        if not self.text:
            return
        try:
            parsed = [part[1:] for part in Formatter().parse(self.text) if part[1] is not None]
        except ValueError as error:
            raise ValueError(f'it is no template: {error}') from None
        # A format, as in {robot:>9}, is no part of a name, and may ask for any length.
        if sorted(parsed, key=str) != [(name, '', None) for name in sorted(self.fields)]:
            wanted = ' and '.join(f'{{{name}}}' for name in self.fields)
            raise ValueError(f'it must hold {wanted} once, nothing else in braces, or be empty')
        check_topic(self.text.format(**dict.fromkeys(self.fields, 'name')))

    def check_names(self, points: Iterable[str]) -> None:
        """Raise ValueError if two pairs of robots, anchors and sensors have the same topic."""
        if not self.text or 'target' not in self.fields:
            return
        names = list(points)
        _, between = (text for text, field, *_ in Formatter().parse(self.text) if field)
        if set(between) - set(''.join(names)):
            # What no name contains tells where one ends and the other begins.
            return
        ends_of: dict[str, tuple[str, str]] = {}
        for observer, target in permutations(names, 2):
            topic = self.text.format(observer=observer, target=target)
            first = ends_of.setdefault(topic, (observer, target))
            if first != (observer, target):
                raise ValueError(
                    f"'{topic}' is that of {first[0]} and {first[1]}, and of {observer} and "
                    f'{target}: the names must be told apart, by a / between them for example'
                )

    def resolved(self, resolve: Callable[[str], str]) -> 'Template':
        """Return the template with the full name, by a function from topics to full names."""
        if not self.text:
            return self
        text = resolve(self.text.format(**{name: _stand_in(name) for name in self.fields}))
        for name in self.fields:
            text = text.replace(_stand_in(name), f'{{{name}}}')
        return replace(self, text=text)

    def link_of(self, topic: str, points: Iterable[str]) -> Link | None:
        """
        Return the link that a topic of this name carries, None when it carries none.

        Names of the fleet are looked for first, so that `/uwb/robot_1_robot_2` is understood. A
        topic of one point of the fleet and one stranger is a link too: its readings are counted
        and rejected, so that the diagnostics name a misspelled or forgotten robot.
        """
        known = '|'.join(re.escape(point) for point in points)
        ends = [(known, known), (known, ANY_NAME), (ANY_NAME, known)]
        for observer, target in ends if 'target' in self.fields else ends[:1]:
            names = {'observer': observer, 'target': target, 'robot': known}
            match = self._pattern(names).fullmatch(topic)
            if match:
                found = match.groupdict()
                key = LinkKey(
                    self.kind, found.get('observer') or found['robot'], found.get('target', '')
                )
                if key.observer == key.target:
                    return None
                return Link(topic, self.type_name, key, overrides=self.overrides)
        return None

    def _pattern(self, names: Mapping[str, str]) -> re.Pattern[str]:
        parts = [
            re.escape(literal) + (f'(?P<{name}>{names[name]})' if name else '')
            for literal, name, _, _ in Formatter().parse(self.text)
        ]
        return re.compile(''.join(parts))


def _stand_in(field_name: str) -> str:
    """Return a name that stands for a field where braces are not allowed."""
    return f'FIELD_{field_name}_FIELD'


def check_topic(topic: str) -> None:
    """Raise ValueError unless `topic` is a name that ROS allows."""
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException as error:
        reason = str(error).partition('\n')[0]
        raise ValueError(f"'{topic}' is no topic name: {reason}") from None
