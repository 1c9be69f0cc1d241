# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Inputs of the fleet among the topics that exist, found by templates of their names."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
import re
from typing import Any

from dg_localization.fleet import LinkKey, LinkKind
from dg_localization.ros.interface.links import (
    ANY_NAME,
    ANY_OBSERVER,
    KINDS,
    STRANGERS,
    Link,
    check_topic,
    stated_offset,
)
from dg_localization.ros.interface.parameters.spec import refused

FIELD = re.compile(r'{(.*?)}')


@dataclass(frozen=True)
class Template:
    """
    A template for the names of the topics of one kind of measurement.

    Attributes
    ----------
    text : str
        The topic with the names of `fields` in braces.
    kind : LinkKind
        The kind of measurement.
    overrides : mapping of str to float
        The overrides of its links.

    """

    text: str
    kind: LinkKind
    overrides: Mapping[str, float] = field(default_factory=dict, hash=False)

    @property
    def fields(self) -> tuple[str, ...]:
        """The names that must stand in braces."""
        return KINDS[self.kind].fields

    def check(self) -> None:
        """Raise ValueError unless the text holds each of `fields` once."""
        # A format, as in {robot:>9}, is not allowed: it may ask for any length.
        braces = {'{', '}'}.intersection(FIELD.sub('', self.text))
        if braces or sorted(FIELD.findall(self.text)) != sorted(self.fields):
            wanted = ' and '.join(f'{{{name}}}' for name in self.fields)
            raise ValueError(f'it must be empty, or hold {wanted} once and no other braces')
        check_topic(FIELD.sub('name', self.text))

    def check_names(self, points: Iterable[str]) -> None:
        """Raise ValueError if two pairs of robots, anchors and sensors have the same topic."""
        if 'target' not in self.fields:
            return
        names = list(points)
        _, _, between, *_ = FIELD.split(self.text)
        if set(between) - set(''.join(names)):
            # A character that no name contains separates the two names.
            return
        ends_of: dict[str, tuple[str, str]] = {}
        for observer, target in permutations(names, 2):
            topic = self.text.format(observer=observer, target=target)
            first = ends_of.setdefault(topic, (observer, target))
            if first != (observer, target):
                raise ValueError(
                    f"'{topic}' is the topic of {first[0]} and {first[1]}, and of {observer} and "
                    f'{target}: separate the two names in the template, for example by a /'
                )

    def resolved(self, resolve: Callable[[str], str]) -> 'Template':
        """Return the template with its full name, by a function that resolves topics."""
        # Braces are not allowed in the name of a topic.
        text = resolve(FIELD.sub(r'FIELD_\1_FIELD', self.text))
        return replace(self, text=re.sub(r'FIELD_(\w+?)_FIELD', r'{\1}', text))

    def link_of(self, topic: str, points: Iterable[str]) -> Link | None:
        """
        Return the link of a topic with this name; None if the template does not match.

        Names of the fleet are tried first, so that `/uwb/robot_1_robot_2` is understood. A topic
        of one point of the fleet and an unknown name is a link too: its readings are counted and
        rejected, so that the diagnostics name a misspelled or forgotten robot.
        """
        known = '|'.join(re.escape(point) for point in points)
        ends = [(known, known), (known, ANY_NAME), (ANY_NAME, known)]
        # Braces are escaped, too.
        pattern = re.sub(r'\\{(\w+)\\}', r'(?P<\1>{\1})', re.escape(self.text))
        for observer, target in ends if 'target' in self.fields else ends[:1]:
            named = pattern.format(observer=observer, target=target, robot=known)
            match = re.fullmatch(named, topic)
            if match:
                found = match.groupdict()
                key = LinkKey(
                    self.kind, found.get('observer') or found['robot'], found.get('target', '')
                )
                if key.observer == key.target:
                    return None
                return Link(topic, KINDS[self.kind].template_type, key, overrides=self.overrides)
        return None


def templates_from(
    values: Mapping[str, Any], resolve: Callable[[str], str], points: Sequence[str]
) -> tuple[Template, ...]:
    """Return the templates with full names of topics; refuse two with the same topics."""
    found: dict[str, Template] = {}
    for kind in (kind for kind, one in KINDS.items() if one.template_type):
        name = f'{kind}.topic'
        if not values[name]:
            continue
        template = Template(values[name], kind, stated_offset(values, kind))
        with refused(f"parameter '{name}': '{template.text}' is not allowed, "):
            template.check()
            template = template.resolved(resolve)
            template.check_names(points)
            # Templates that differ in the names of their fields only give the same topics.
            first = found.setdefault(FIELD.sub('{}', template.text), template)
            if first is not template:
                raise ValueError(
                    f"its topics are those of '{first.kind}.topic', it must have topics of its own"
                )
    return tuple(found.values())


class TopicFinder:
    """
    Finds inputs among topics, each of them once.

    Parameters
    ----------
    templates : iterable of Template
        Templates of the names of topics.
    explicit : iterable of Link
        Explicit links, which replace links from templates for the same measurement.
    points : iterable of str
        Robots and landmarks of the fleet.

    Attributes
    ----------
    wrong_types : dict of Link to tuple of str
        Inputs whose topic had endpoints of other types in the last search.
    passed_over : list of Link
        Links of topics that were new then, which explicit links replace.

    """

    def __init__(
        self, templates: Iterable[Template], explicit: Iterable[Link], points: Iterable[str]
    ) -> None:
        self._templates = tuple(templates)
        self._points = frozenset(points)
        self._explicit = {link.topic: link for link in explicit}
        self._replaced = {link.key for link in self._explicit.values()}
        # By the name of each topic that exists: its types may change, its link does not.
        self._link_of: dict[str, Link | None] = {}
        self._found = set(self._explicit)
        self._n_unknown = 0
        self.wrong_types: dict[Link, tuple[str, ...]] = {}
        self.passed_over: list[Link] = []

    def find(self, topics: Iterable[tuple[str, list[str]]]) -> Iterator[Link]:
        """Yield the links of topics that were not found before; `topics` come with their types."""
        self.wrong_types, self.passed_over = {}, []
        known, self._link_of = self._link_of, {}
        for topic, type_names in topics:
            link = known[topic] if topic in known else self._link_named(topic)
            self._link_of[topic] = link
            if link is None:
                continue
            if not link.explicit and link.key in self._replaced:
                if link.type_name in type_names and topic not in self._found:
                    self._found.add(topic)
                    self.passed_over.append(link)
                continue
            others = tuple(sorted(set(type_names) - {link.type_name}))
            is_unknown = self._is_unknown(link)
            if others and not is_unknown:
                self.wrong_types[link] = others
            if link.type_name in type_names and topic not in self._found:
                # Every name is kept in the counts, so unknown names are limited.
                self._n_unknown += is_unknown
                if not is_unknown or self._n_unknown <= max(STRANGERS, len(self._points)):
                    self._found.add(topic)
                    yield link

    def _link_named(self, topic: str) -> Link | None:
        """Return the link of a topic with this name; None if no template matches."""
        if topic in self._explicit:
            return self._explicit[topic]
        links = (template.link_of(topic, self._points) for template in self._templates)
        found = [link for link in links if link is not None]
        wanted = [link for link in found if link.key not in self._replaced]
        # `{observer}/{target}` also matches `robot_1/odom`, as a range to an unknown name.
        return min(wanted or found, key=self._is_unknown, default=None)

    def _is_unknown(self, link: Link) -> bool:
        return not {link.key.observer, link.key.target} - {'', ANY_OBSERVER} <= self._points
