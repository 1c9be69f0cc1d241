# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
How the hypotheses of all pieces combine: counted and numbered, never enumerated.

Pieces and links form a graph. Hypotheses that some neighbor has no match for are dropped until
none is left to drop (arc consistency). Then a forest of links is taken, in which the number of
combinations of every subtree follows from those of its branches; a link that would close a loop
only drops hypotheses.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from dg_localization.solver.assemble.links import Link
from dg_localization.solver.decompose.joints import JointKind
from dg_localization.solver.decompose.rigid_components import Points
from dg_localization.solver.problem import Side, SideConstraint


@dataclass(frozen=True)
class Combination:
    """One hypothesis for every piece, and the sides of the apexes for every link of the forest."""

    hypotheses: tuple[int, ...]
    sides: tuple[tuple[Link, Side], ...]

    def constraints(self) -> list[SideConstraint]:
        """Return the sides of the apexes as constraints."""
        return list(self.reflections().values())

    def reflections(self) -> dict[tuple[Points, int, int], SideConstraint]:
        """Return the same for (face, first, second), the two pieces that share a face."""
        return {
            (link.joint.points, link.first, link.second): constraint
            for link, side in self.sides
            if (
                constraint := link.constraint(
                    self.hypotheses[link.first], self.hypotheses[link.second], side
                )
            )
        }


class Combinations:
    """
    All combinations of the hypotheses of pieces that the links allow.

    Parameters
    ----------
    n_hypotheses : list of int
        The number of hypotheses of each piece.
    links : list of Link
        What they allow each other.

    """

    def __init__(self, n_hypotheses: list[int], links: list[Link]) -> None:
        self.left = [set(range(number)) for number in n_hypotheses]
        self.links = links
        self._drop_unmatched()
        self._root_trees()
        self._count()

    @property
    def number(self) -> int:
        """How many there are."""
        number = 1
        for root in self._roots:
            number *= sum(self._below[root].values())
        return number

    @property
    def contradiction(self) -> int | None:
        """A piece that is left without a hypothesis."""
        return next((x for x, left in enumerate(self.left) if not left), None)

    def _drop_unmatched(self) -> None:
        """Drop the hypotheses that a link leaves without a match, until there is none."""
        links_of: list[set[int]] = [set() for _ in self.left]
        for number, link in enumerate(self.links):
            links_of[link.first].add(number)
            links_of[link.second].add(number)
        waiting = set(range(len(self.links)))
        while waiting:
            number = waiting.pop()
            link = self.links[number]
            first, second = self.left[link.first], self.left[link.second]
            together = [(x, y) for x, y in link.allowed if x in first and y in second]
            for piece, matched in (
                (link.first, {x for x, _ in together}),
                (link.second, {y for _, y in together}),
            ):
                if len(matched) < len(self.left[piece]):
                    self.left[piece] = matched
                    waiting |= links_of[piece] - {number}

    def _forest(self) -> list[Link]:
        """Return links that close no loop, reflections before others."""
        tree = list(range(len(self.left)))

        def root_of(piece: int) -> int:
            while tree[piece] != piece:
                tree[piece] = tree[tree[piece]]
                piece = tree[piece]
            return piece

        forest = []
        for link in sorted(self.links, key=lambda k: k.joint.kind is not JointKind.REFLECTION):
            first, second = root_of(link.first), root_of(link.second)
            if first != second:
                tree[second] = first
                forest.append(link)
        return forest

    def _root_trees(self) -> None:
        """Choose the forest: for every piece, the links to those below it."""
        neighbors: list[list[tuple[int, Link]]] = [[] for _ in self.left]
        for link in self._forest():
            neighbors[link.first].append((link.second, link))
            neighbors[link.second].append((link.first, link))
        self._roots: list[int] = []
        self._order: list[int] = []
        self._branches: list[list[tuple[int, Link]]] = [[] for _ in self.left]
        seen = [False] * len(self.left)
        for root in range(len(self.left)):
            if seen[root]:
                continue
            self._roots.append(root)
            seen[root] = True
            queue = deque([root])
            while queue:
                piece = queue.popleft()
                self._order.append(piece)
                for other, link in neighbors[piece]:
                    if not seen[other]:
                        seen[other] = True
                        self._branches[piece].append((other, link))
                        queue.append(other)

    def _count(self) -> None:
        """Count the combinations of every subtree, for each hypothesis at its root."""
        self._below: list[dict[int, int]] = [{} for _ in self.left]
        # For each piece but the roots, what goes with a hypothesis of the piece above it.
        self._choices: list[dict[int, list[tuple[int, Side]]]] = [{} for _ in self.left]
        for piece in reversed(self._order):
            for branch, link in self._branches[piece]:
                self._choices[branch] = self._matches(link, piece, branch)
            for x in sorted(self.left[piece]):
                number = 1
                for branch, _ in self._branches[piece]:
                    number *= self._number(branch, x)
                self._below[piece][x] = number

    def _matches(self, link: Link, above: int, below: int) -> dict[int, list[tuple[int, Side]]]:
        """Return what goes with each hypothesis of the upper one of two linked pieces."""
        matches: dict[int, list[tuple[int, Side]]] = {x: [] for x in self.left[above]}
        for (first, second), sides in sorted(link.allowed.items()):
            x, y = (first, second) if link.first == above else (second, first)
            if x in matches and y in self.left[below]:
                matches[x] += [(y, side) for side in sides]
        return matches

    def _number(self, branch: int, above: int) -> int:
        """Return the combinations of a branch that go with a hypothesis of the piece above it."""
        return sum(self._below[branch][y] for y, _ in self._choices[branch][above])

    def __getitem__(self, rank: int) -> Combination:
        """Return one of the combinations, by its number from 0."""
        hypotheses = [-1] * len(self.left)
        sides: list[tuple[Link, Side]] = []
        for root in self._roots:
            rank, place = divmod(rank, sum(self._below[root].values()))
            x, place = _find(list(self._below[root].items()), place)
            stack = [(root, x, place)]
            while stack:
                piece, x, place = stack.pop()
                hypotheses[piece] = x
                for branch, link in self._branches[piece]:
                    place, inner = divmod(place, self._number(branch, x))
                    choices = self._choices[branch][x]
                    numbers = [(k, self._below[branch][y]) for k, (y, _) in enumerate(choices)]
                    chosen, inner = _find(numbers, inner)
                    y, side = choices[chosen]
                    sides.append((link, side))
                    stack.append((branch, y, inner))
        return Combination(tuple(hypotheses), tuple(sides))


def _find(numbers: list[tuple[int, int]], place: int) -> tuple[int, int]:
    """Return which of several runs of so many numbers a place lies in, and where in the run."""
    for key, number in numbers:
        if place < number:
            return key, place
        place -= number
    raise IndexError(f'{place} more than there are')
