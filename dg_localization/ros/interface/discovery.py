"""Which of the topics that exist are inputs of the fleet, by the templates of their names."""

from collections.abc import Iterable, Iterator

from dg_localization.ros.interface.links import Link, Template

MAX_STRANGERS = 16


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

    """

    def __init__(
        self, templates: Iterable[Template], explicit: Iterable[Link], points: Iterable[str]
    ) -> None:
        self._templates = tuple(templates)
        self._points = frozenset(points)
        self._replaced = {link.key for link in explicit}
        self._judged = {link.topic for link in explicit}
        self._strangers = 0

    def find(self, topics: Iterable[tuple[str, list[str]]]) -> Iterator[Link]:
        """
        Yield the links among topics not seen before.

        Parameters
        ----------
        topics : iterable of (str, list of str)
            Names and their types, as `rclpy.node.Node.get_topic_names_and_types` gives them.

        """
        for topic, type_names in topics:
            if topic in self._judged:
                continue
            self._judged.add(topic)
            link = self._named(topic)
            if link is not None and link.type_name in type_names and self._is_welcome(link):
                yield link

    def _named(self, topic: str) -> Link | None:
        links = (template.link_of(topic, self._points) for template in self._templates)
        wanted = (link for link in links if link is not None and link.key not in self._replaced)
        return next(wanted, None)

    def _is_welcome(self, link: Link) -> bool:
        """Return False for a link to a stranger beyond the few that are worth counting."""
        if {link.key.observer, link.key.target} - {''} <= self._points:
            return True
        self._strangers += 1
        return self._strangers <= MAX_STRANGERS
