# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Combinations of the hypotheses of all pieces: their count without a list, and their list.

Hypotheses without a match in some neighbor are dropped until none is left to drop (arc
consistency). A forest of links counts the combinations: each subtree multiplies the counts of its
branches. A link that would close a loop only drops hypotheses, so the count is then an upper
bound. The list follows the forest depth first and checks every link.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import product

from dg_localization.solver.decompose.graph import Points
from dg_localization.solver.problem import Side, SideConstraint

FREE = (Side.FREE,)
EITHER = (Side.SAME, Side.OPPOSITE)

Apexes = dict[tuple[int, int], int]
"""The apex of each piece and hypothesis that has one."""


@dataclass
class Site:
    """Pieces on the two sides of one hyperplane; the first one serves as reference."""

    face: Points
    members: list[int]
    apexes: Apexes
    is_merged: bool = False  # whether it has the faces of several joints
    lost: frozenset[tuple[int, int]] = frozenset()  # with an apex only at another of these faces
    number: int = 0  # its index among the sites

    def n_certain(self, piece: int) -> int:
        """Return the number of hypotheses of a piece that have an apex."""
        return sum(number == piece for number, _ in self.apexes)


@dataclass
class PieceLink:
    """Two pieces, and the allowed sides of their apexes for each compatible pair of hypotheses."""

    first: int
    second: int
    site: Site | None = None
    allowed: dict[tuple[int, int], tuple[Side, ...]] = field(default_factory=dict)

    @property
    def number(self) -> int:
        """The number of its site, -1 without one."""
        return self.site.number if self.site else -1


@dataclass
class Network:
    """The sites and links of all pieces; not exact if the links allow too many combinations."""

    sites: list[Site] = field(default_factory=list)
    links: list[PieceLink] = field(default_factory=list)
    n_unlinked: int = 0  # the number of pieces at sites whose sides no link tells
    is_exact: bool = True
    lists_all_sides: bool = True  # false if one combination of the list stands for several


@dataclass(frozen=True)
class Combination:
    """
    A hypothesis for every piece, and the sides of their apexes.

    If only some pieces have a hypothesis, it stands for all combinations that extend it.
    """

    hypotheses: dict[int, int]
    sides: dict[tuple[int, int], int]  # 1 or -1 for a site, by its number, and a piece

    def constraints(self, sites: list[Site]) -> list[SideConstraint]:
        """Return the side constraints of all apexes relative to the first apex of each site."""
        found = []
        for site in sites:
            chosen = [
                (site.apexes[piece, self.hypotheses[piece]], self.sides[site.number, piece])
                for piece in site.members
                if (site.number, piece) in self.sides
            ]
            for apex, sign in chosen[1:]:
                first, first_sign = chosen[0]
                # Two pieces may have one apex in common.
                if apex != first:
                    side = Side.SAME if sign == first_sign else Side.OPPOSITE
                    found.append(SideConstraint(site.face, first, apex, side))
        return found


class Combinations:
    """All combinations of the hypotheses of pieces that a network allows."""

    def __init__(self, n_hypotheses: list[int], network: Network) -> None:
        self.left = [set(range(number)) for number in n_hypotheses]
        self.sites = network.sites
        self._sites_of: list[list[int]] = [[] for _ in self.left]
        for site in network.sites:
            for piece in site.members:
                self._sites_of[piece].append(site.number)
        self._links_of: list[list[PieceLink]] = [[] for _ in self.left]
        for link in network.links:
            self._links_of[link.first].append(link)
            self._links_of[link.second].append(link)
        self._drop_unmatched(network.links)
        # Whether `number` excludes all combinations that a link rules out.
        self.is_exact = network.is_exact and network.n_unlinked == 0
        self.lists_all_sides = network.lists_all_sides
        self.forest: list[PieceLink] = []
        self._order: list[int] = []
        self._roots: list[int] = []
        self._branches: list[list[tuple[int, PieceLink]]] = [[] for _ in self.left]
        self._plant(network.links)
        self.number = self._count() << network.n_unlinked

    @property
    def contradiction(self) -> int | None:
        """A piece without a remaining hypothesis, or None."""
        return next((x for x, left in enumerate(self.left) if not left), None)

    def _drop_unmatched(self, links: list[PieceLink]) -> None:
        """Drop hypotheses without a match across a link, until every one has a match."""
        waiting = list(links)
        while waiting:
            link = waiting.pop()
            first, second = self.left[link.first], self.left[link.second]
            together = [(x, y) for x, y in link.allowed if x in first and y in second]
            for piece, matched in (
                (link.first, {x for x, _ in together}),
                (link.second, {y for _, y in together}),
            ):
                if len(matched) < len(self.left[piece]):
                    self.left[piece] = matched
                    waiting += [k for k in self._links_of[piece] if k is not link]

    def _plant(self, links: list[PieceLink]) -> None:
        """Choose a forest of links, links of sites first, and an order from its roots."""
        tree = list(range(len(self.left)))
        neighbors: list[list[tuple[int, PieceLink]]] = [[] for _ in self.left]
        for link in sorted(links, key=lambda k: k.site is None):
            first, second = tree[link.first], tree[link.second]
            if first == second:
                self.is_exact = False
                continue
            tree = [first if root == second else root for root in tree]
            self.forest.append(link)
            neighbors[link.first].append((link.second, link))
            neighbors[link.second].append((link.first, link))
        seen: set[int] = set()
        for root in range(len(self.left)):
            if root in seen:
                continue
            self._roots.append(root)
            seen.add(root)
            queue = deque([root])
            while queue:
                piece = queue.popleft()
                self._order.append(piece)
                for other, link in neighbors[piece]:
                    if other not in seen:
                        seen.add(other)
                        self._branches[piece].append((other, link))
                        queue.append(other)

    def _count(self) -> int:
        """Return the number of combinations of the forest."""
        below: list[dict[int, int]] = [{} for _ in self.left]
        for piece in reversed(self._order):
            below[piece] = dict.fromkeys(self.left[piece], 1)
            for branch, link in self._branches[piece]:
                ways = dict.fromkeys(self.left[piece], 0)
                for (first, second), sides in link.allowed.items():
                    x, y = (first, second) if link.first == piece else (second, first)
                    if x in ways:
                        ways[x] += len(sides) * below[branch].get(y, 0)
                for x in ways:
                    below[piece][x] *= ways[x]
        number = 1
        for root in self._roots:
            number *= sum(below[root].values())
        return number

    def listed(self, is_possible: Callable[[Combination], bool]) -> Iterator[Combination]:
        """List the combinations, without extensions of partial ones that are not possible."""
        stack = [Combination({}, {})]
        while stack:
            begun = stack.pop()
            if len(begun.hypotheses) == len(self._order):
                yield begun
                continue
            further = list(self._further(begun, self._order[len(begun.hypotheses)]))
            if len(further) > 1:
                further = [c for c in further if is_possible(c)]
            stack += reversed(further)

    def _further(self, begun: Combination, piece: int) -> Iterator[Combination]:
        """Return the extensions of a combination by one more piece."""
        for x in sorted(self.left[piece]):
            numbers = [n for n in self._sites_of[piece] if (piece, x) in self.sites[n].apexes]
            # The first apex of a site gets the sign 1: other sides are relative to it.
            options = [
                (1, -1) if any(site == number for site, _ in begun.sides) else (1,)
                for number in numbers
            ]
            for signs in product(*options):
                sides = {(n, piece): sign for n, sign in zip(numbers, signs, strict=True)}
                new = Combination({**begun.hypotheses, piece: x}, {**begun.sides, **sides})
                if all(self._allows(link, new) for link in self._links_of[piece]):
                    yield new

    def _allows(self, link: PieceLink, begun: Combination) -> bool:
        """Return whether a link allows the choices of its two pieces, if both are made."""
        first, second = (begun.hypotheses.get(x) for x in (link.first, link.second))
        if first is None or second is None:
            return True
        sides = link.allowed.get((first, second), ())
        if not sides or link.site is None:
            return bool(sides)
        signs = [begun.sides.get((link.site.number, x)) for x in (link.first, link.second)]
        if None in signs:
            return True
        return (Side.SAME if signs[0] == signs[1] else Side.OPPOSITE) in sides
