# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Links: topics with the observer and the target of their measurements."""

from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rclpy.exceptions import InvalidTopicNameException
from rclpy.validate_topic_name import validate_topic_name

from dg_localization.fleet import FleetConfig, LinkKey, LinkKind, SensorBounds
from dg_localization.fleet.rotations import quaternion_of_euler, rotation_of_quaternion
from dg_localization.ros.interface.parameters.spec import close_name, refused
from dg_localization.ros.interface.parameters.table import fields_of
from msg_adapters import (
    CameraReading,
    IdentifiedReading,
    PeersReading,
    PixelReading,
    adapter_for,
    known_types,
)

# Messages of these readings never name the observer.
NAMELESS = {PeersReading, PixelReading}

# The observer of a link whose messages name their observer.
ANY_OBSERVER = '*'
# Most topics and ids of unknown points that are counted; more if the fleet has more points.
STRANGERS = 16
ANY_NAME = '[A-Za-z][A-Za-z0-9_]*'
WANTED_NAME = 'must begin with a letter and go on with letters, digits and underscores'

# The orientation of the sensor of peers in the body frame of its robot.
TURNS = ('roll', 'pitch', 'yaw')


def _fields(model: str, prefix: str, start: str = '') -> dict[str, tuple[str, str]]:
    """Return the fields of a model of `SensorBounds`, by the names of their parameters."""
    fields = fields_of(getattr(SensorBounds, model), prefix)
    return {start + name: (model, field) for name, field in fields.items()}


# By name what a link string may override: the model in `SensorBounds`, or none, and the field.
OF_RANGES = _fields('range_error', 'range.')
del OF_RANGES['beyond_max_is_far']
OF_BEARINGS = {
    name.removeprefix('bearing.'): ('', field) for name, field in fields_of(SensorBounds).items()
}
OF_ELEVATIONS = _fields('elevation_error', 'elevation.')
OF_PEERS = {name: one for name, one in OF_RANGES.items() if not name.startswith('expected_error')}
OF_PEERS['half_width'] = OF_BEARINGS['half_width']
# Peers may also be ranges, whose bounds have the same names: hence the prefix.
OF_PEERS |= _fields('range_difference_error', 'range_difference.', 'difference_')
STAMP_OFFSET = 'stamp_offset'


class InputKind(NamedTuple):
    """
    A kind of input: the type of topics that a template names, and the fields of the template.

    Links of the kind may state `bounds` of their own, and `others` beside them.
    """

    template_type: str
    fields: tuple[str, ...]
    bounds: Mapping[str, tuple[str, str]] = {}
    others: tuple[str, ...] = ()

    @property
    def overrides(self) -> tuple[str, ...]:
        """The overrides that a link may state."""
        return (*self.bounds, *self.others, STAMP_OFFSET) if self.template_type else ()


ENDS, OBSERVER = ('observer', 'target'), ('observer',)
KINDS = {
    LinkKind.RANGE: InputKind('sensor_msgs/msg/Range', ENDS, OF_RANGES),
    LinkKind.BEARING: InputKind('geometry_msgs/msg/Vector3Stamped', ENDS, OF_BEARINGS),
    LinkKind.ODOMETRY: InputKind('nav_msgs/msg/Odometry', ('robot',)),
    LinkKind.PEERS: InputKind('sensor_msgs/msg/PointCloud2', OBSERVER, OF_PEERS, TURNS),
    LinkKind.ELEVATION: InputKind('geometry_msgs/msg/PointStamped', OBSERVER, OF_ELEVATIONS),
    LinkKind.CAMERA: InputKind('', OBSERVER),
}
KIND_OF_VALUE: dict[type, LinkKind] = {
    adapter_for(one.template_type).value_class: kind
    for kind, one in KINDS.items()
    if one.template_type
}
KIND_OF_VALUE |= {IdentifiedReading: LinkKind.PEERS, PixelReading: LinkKind.PEERS}
KIND_OF_VALUE[CameraReading] = LinkKind.CAMERA


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
        The kind, the observer and the target, which are never taken from a `frame_id`.
    explicit : bool
        Whether it was named explicitly, so that its silence gives a warning.
    overrides : mapping of str to float
        Error bounds that replace those of the fleet, by name without the prefix; the offset of
        stamps; for peers, the orientation of their sensor.

    """

    topic: str
    type_name: str
    key: LinkKey
    explicit: bool = False
    overrides: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def stamp_offset_s(self) -> float:
        """The offset to add to the stamps of the messages."""
        return self.overrides.get(STAMP_OFFSET, 0.0)

    def bounds_within(self, of_all: SensorBounds) -> SensorBounds:
        """Return the error bounds of the link; those that it does not state are of the fleet."""
        stated: dict[str, dict[str, Any]] = defaultdict(dict)
        for name, (model, own_name) in KINDS[self.key.kind].bounds.items():
            if name in self.overrides:
                stated[model][own_name] = self.overrides[name]
        own = stated.pop('', {})
        models = {name: replace(getattr(of_all, name), **one) for name, one in stated.items()}
        return replace(of_all, **own, **models)

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

    Odometry, elevations, peers and cameras have no target; the observer of peers is ``*`` if their
    messages name it. An example is
    ``/uwb_3/to_4 sensor_msgs/msg/Range robot_3 robot_4 max_error=1.2``. ValueError says which part
    is missing or wrong, and what would be right.
    """
    words = text.split()
    names = [word for word in words if '=' not in word]
    if len(names) not in (3, 4):
        raise ValueError("it must read 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'")
    topic, type_name, observer, target = [*names, ''][:4]
    kind = kind_of(type_name)
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


def kind_of(type_name: str) -> LinkKind:
    """Return the kind of messages of a type; raise ValueError if they are no input."""
    inputs = [name for name in known_types() if adapter_for(name).value_class in KIND_OF_VALUE]
    if type_name not in inputs:
        hint = close_name(type_name, inputs) or f'; it must be one of {", ".join(inputs)}'
        raise ValueError(f"type '{type_name}' is no input{hint}")
    adapter = adapter_for(type_name)
    # This raises if the package is not installed.
    adapter.message_class()
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


def check_topic(topic: str) -> None:
    """Raise ValueError unless `topic` is a name that ROS allows."""
    try:
        validate_topic_name(topic)
    except InvalidTopicNameException as error:
        reason = str(error).partition('\n')[0]
        raise ValueError(f"'{topic}' is no topic name: {reason}") from None


def stated_offset(values: Mapping[str, Any], kind: LinkKind) -> dict[str, float]:
    """Return the overrides of links of a kind that do not state them."""
    offset_s = values.get(f'{kind}.{STAMP_OFFSET}', 0.0)
    return {STAMP_OFFSET: offset_s} if offset_s else {}


def links_from(values: Mapping[str, Any], resolve: Callable[[str], str]) -> tuple[Link, ...]:
    """Return the explicit links with the full names of their topics."""
    links = []
    # A list of one empty string is how ROS 1 and 2 users write an empty list of strings.
    for text in filter(None, values['links']):
        with refused(f"parameter 'links': '{text}' is not allowed: "):
            link = parse_link(text)
            topic = resolve(link.topic)
            if resolve(topic) != topic:
                # A subscription to this topic would be remapped once more.
                raise ValueError(
                    f"its topic is remapped to '{topic}', and that to '{resolve(topic)}': name "
                    'the topic that is meant'
                )
        overrides = {**stated_offset(values, link.key.kind), **link.overrides}
        links.append(replace(link, topic=topic, overrides=overrides))
    with refused("parameter 'links': "):
        for topic, count in Counter(link.topic for link in links).items():
            if count > 1:
                raise ValueError(f"topic '{topic}' is named twice, it can carry one link only")
        for key, count in Counter(link.key for link in links).items():
            if key.kind is LinkKind.ODOMETRY and count > 1:
                # The robot does not move from a pose of one source to a pose of the other.
                text = f"the odometry of '{key.observer}' is named {count} times, not once"
                raise ValueError(text)
    return tuple(links)


def check_links(links: Iterable[Link], fleet: FleetConfig) -> None:
    """Refuse links with invalid bounds, and links between two points of one robot."""
    for link in links:
        with refused(f"parameter 'links': the bounds of '{link.topic}' are not allowed: "):
            link.bounds_within(fleet.sensor_bounds)
        robot, other = map(fleet.robot_of, link.key.ends)
        with refused("parameter 'links': "):
            if robot == other:
                raise ValueError(
                    f"{'->'.join(link.key.ends)} is not allowed, both are on robot '{robot}', it "
                    'must join points of two robots or anchors'
                )
