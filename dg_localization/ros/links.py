"""Links: which topic carries whose measurement of whom."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from string import Formatter

from dg_localization.fleet import LinkKey, LinkKind
from msg_adapters import (
    BearingReading,
    OdometryReading,
    RangeReading,
    UnknownTypeError,
    adapter_for,
    known_types,
)

KIND_OF_VALUE = {
    RangeReading: LinkKind.RANGE,
    BearingReading: LinkKind.BEARING,
    OdometryReading: LinkKind.ODOMETRY,
}

# What a link string may override, by what the link measures.
OVERRIDES = {
    LinkKind.RANGE: (
        'min_error',
        'max_error',
        'min_error_relative',
        'max_error_relative',
        'sigma_factor',
    ),
    LinkKind.BEARING: ('half_width',),
    LinkKind.ODOMETRY: (),
}


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
        Error bounds that differ from the fleet's, by their name without the prefix.

    """

    topic: str
    type_name: str
    key: LinkKey
    explicit: bool = False
    overrides: Mapping[str, float] = field(default_factory=dict)


def parse_link(text: str) -> Link:
    """
    Read a link from its string: ``TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]``.

    Odometry has no target. For example
    ``/uwb/3_4 sensor_msgs/msg/Range robot_3 robot_4 max_error=1.2``.

    Parameters
    ----------
    text : str
        The string, with blanks between the parts.

    Returns
    -------
    Link

    Raises
    ------
    ValueError
        If a part is missing or wrong; the message says which and what would be right.

    """
    words = text.split()
    names = [word for word in words if '=' not in word]
    if len(names) not in (3, 4):
        raise ValueError("it must read 'TOPIC TYPE OBSERVER [TARGET] [NAME=VALUE ...]'")
    topic, type_name, observer, target = [*names, ''][:4]
    kind = _kind_of(type_name)
    if bool(target) == (kind is LinkKind.ODOMETRY):
        wanted = 'takes no target' if target else 'needs an observer and a target'
        raise ValueError(f'a link of type {type_name} {wanted}')
    if observer == target:
        raise ValueError(f"'{observer}' cannot measure itself; name two different points")
    overrides = dict(_parse_override(word, kind) for word in words if '=' in word)
    return Link(topic, type_name, LinkKey(kind, observer, target), True, overrides)


def _kind_of(type_name: str) -> LinkKind:
    inputs = [name for name in known_types() if adapter_for(name).value_class in KIND_OF_VALUE]
    if type_name not in inputs:
        raise ValueError(f"type '{type_name}' is no input; it must be one of {', '.join(inputs)}")
    adapter = adapter_for(type_name)
    try:
        adapter.message_class()
    except UnknownTypeError as error:
        raise ValueError(str(error)) from None
    return KIND_OF_VALUE[adapter.value_class]


def _parse_override(word: str, kind: LinkKind) -> tuple[str, float]:
    name, _, value = word.partition('=')
    if name not in OVERRIDES[kind]:
        allowed = ', '.join(OVERRIDES[kind]) or 'nothing'
        raise ValueError(f"'{name}' cannot be overridden here; a {kind} link allows {allowed}")
    try:
        return name, float(value)
    except ValueError:
        raise ValueError(f"'{word}' must end in a number") from None


def check_template(template: str, fields: tuple[str, ...]) -> None:
    """
    Raise ValueError unless a topic template is empty or holds each of `fields` in braces.

    An empty template stands for no topics.
    """
    if not template:
        return
    try:
        found = {name for _, name, _, _ in Formatter().parse(template) if name is not None}
    except ValueError as error:
        raise ValueError(f'it is no template: {error}') from None
    if found != set(fields):
        wanted = ' and '.join(f'{{{name}}}' for name in fields)
        raise ValueError(f'it must hold {wanted} and nothing else in braces, or be empty')


@dataclass(frozen=True)
class Templates:
    """Topic names of ranges, bearings and odometry with {observer}, {target} and {robot}."""

    range: str
    bearing: str
    odometry: str

    def expand(self, robots: Iterable[str], points: Iterable[str]) -> Iterator[Link]:
        """Yield a link from each robot to each other point, and for each robot's odometry."""
        pairs = ((LinkKind.RANGE, self.range), (LinkKind.BEARING, self.bearing))
        type_names = {
            LinkKind.RANGE: 'sensor_msgs/msg/Range',
            LinkKind.BEARING: 'geometry_msgs/msg/Vector3Stamped',
        }
        points = tuple(points)
        for robot in robots:
            for kind, template in pairs:
                for target in points:
                    if template and target != robot:
                        topic = template.format(observer=robot, target=target)
                        yield Link(topic, type_names[kind], LinkKey(kind, robot, target))
            if self.odometry:
                topic = self.odometry.format(robot=robot)
                key = LinkKey(LinkKind.ODOMETRY, robot, '')
                yield Link(topic, 'nav_msgs/msg/Odometry', key)


def all_links(
    templates: Templates, explicit: Iterable[Link], robots: Iterable[str], points: Iterable[str]
) -> tuple[Link, ...]:
    """
    Return the explicit links and those of the templates that no explicit one replaces.

    An explicit link replaces what the templates give for the same measurement.
    """
    explicit = tuple(explicit)
    named = {link.key for link in explicit}
    expanded = (link for link in templates.expand(robots, points) if link.key not in named)
    return explicit + tuple(expanded)
