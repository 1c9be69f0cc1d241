# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Which of the topics that exist are inputs of the fleet, by the templates of their names."""

from collections.abc import Iterable, Iterator
from functools import lru_cache

from dg_localization.ros.interface.links import ANY_OBSERVER, Link, Template

MOST_UNKNOWN = 16
# As many names are remembered: nodes come and go for days, some with names of their own.
MOST_NAMES = 4096


class TopicFinder:
    """
    Finds inputs among topics; each is found once.

    Parameters
    ----------
    templates : iterable of Template
        What topics are named like.
    explicit : iterable of Link
        The links named one by one, which replace what the templates give for the same
        measurement.
    points : iterable of str
        Robots and landmarks of the fleet.

    Attributes
    ----------
    wrong_types : dict of Link to tuple of str
        Inputs whose topic had endpoints of other types when it was last looked at.
    passed_over : list of Link
        What templates give for topics that were new then, and explicit links replace.

    """

    def __init__(
        self, templates: Iterable[Template], explicit: Iterable[Link], points: Iterable[str]
    ) -> None:
        self._templates = tuple(templates)
        self._points = frozenset(points)
        self._explicit = {link.topic: link for link in explicit}
        self._replaced = {link.key for link in self._explicit.values()}
        # What a name means does not change; which types it has does.
        self._link_of = lru_cache(MOST_NAMES)(self._link_named)
        self._found = set(self._explicit)
        self._n_unknown = 0
        self.wrong_types: dict[Link, tuple[str, ...]] = {}
        self.passed_over: list[Link] = []

    def find(self, topics: Iterable[tuple[str, list[str]]]) -> Iterator[Link]:
        """Yield the links that were not found before among all topics, with their types."""
        self.wrong_types, self.passed_over = {}, []
        for topic, type_names in topics:
            link = self._link_of(topic)
            if link is None:
                continue
            if not link.explicit and link.key in self._replaced:
                if link.type_name in type_names and topic not in self._found:
                    self._found.add(topic)
                    self.passed_over.append(link)
                continue
            others = tuple(sorted(set(type_names) - {link.type_name}))
            if others and not self._is_unknown(link):
                self.wrong_types[link] = others
            if link.type_name in type_names and topic not in self._found and self._admits(link):
                self._found.add(topic)
                yield link

    def _link_named(self, topic: str) -> Link | None:
        """Return the link that a topic of this name carries, None when it carries none."""
        if topic in self._explicit:
            return self._explicit[topic]
        links = (template.link_of(topic, self._points) for template in self._templates)
        found = [link for link in links if link is not None]
        wanted = [link for link in found if link.key not in self._replaced]
        # `{observer}/{target}` takes `robot_1/odom` for a range to an unknown name.
        return min(wanted or found, key=self._is_unknown, default=None)

    def _is_unknown(self, link: Link) -> bool:
        return not {link.key.observer, link.key.target} - {'', ANY_OBSERVER} <= self._points

    def _admits(self, link: Link) -> bool:
        """Return False for a link to an unknown name beyond the few that are worth counting."""
        if not self._is_unknown(link):
            return True
        if self._n_unknown == MOST_UNKNOWN:
            return False
        self._n_unknown += 1
        return True
