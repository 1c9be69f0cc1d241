# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""One hypothesis for every patch: which choices agree, listed while they are few."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from itertools import product

import numpy as np

from dg_localization.solver.decompose.graph import BoolArray
from dg_localization.solver.patches.known_pairs import KnownPairs, Patch

Choice = dict[int, int]
"""The hypothesis chosen for each patch that has several left."""


class Ambiguities:
    """
    The patches that have several hypotheses left, and which of these go together.

    Parameters
    ----------
    patches : sequence of Patch
        All patches.
    known : KnownPairs
        Their pairs, narrowed.
    stopped : callable
        Whether there is no time left to compare patches.

    """

    def __init__(
        self, patches: Sequence[Patch], known: KnownPairs, stopped: Callable[[], bool]
    ) -> None:
        self._patches = patches
        self.ambiguous = [x for x, patch in enumerate(patches) if patch.left.sum() > 1]
        self._together: dict[int, dict[int, BoolArray]] = {x: {} for x in self.ambiguous}
        for first, second in self._overlapping():
            if stopped():
                # Choices that do not agree are told apart no more, which loses none.
                break
            (low, high), (other_low, other_high) = known.bounds_of_shared(first, second)
            agree = (low[:, None] <= other_high[None]).all(axis=2)
            agree &= (other_low[None] <= high[:, None]).all(axis=2)
            if not agree.all():
                self._together[first][second] = agree
                self._together[second][first] = agree.T

    def _overlapping(self) -> Iterator[tuple[int, int]]:
        """Return the ambiguous patches that share pairs, two at a time, in their order."""
        holders: dict[int, list[int]] = {}
        for second in self.ambiguous:
            points = self._patches[second].points
            n_shared = Counter(first for point in points for first in holders.get(point, ()))
            yield from ((first, second) for first, n in n_shared.items() if n > 1)
            for point in points:
                holders.setdefault(point, []).append(second)

    def drop_unmatched(self) -> bool:
        """Drop hypotheses that a neighbor has no match for; return whether there were any."""
        dropped = False
        waiting = list(self.ambiguous)
        while waiting:
            first = waiting.pop()
            left = self._patches[first].left
            for second, agree in self._together[first].items():
                matched = agree[:, self._patches[second].left].any(axis=1)
                if (left & ~matched).any():
                    left = left & matched
                    self._patches[first].left = left
                    waiting.extend(x for x in self._together[first] if x not in waiting)
                    dropped = True
        return dropped

    def choices(self, most: int) -> list[Choice] | None:
        """Return all choices that agree pair by pair, None where there are more than `most`."""
        listed: list[list[Choice]] = []
        count = 1
        for group in self._groups():
            found = self._choices_of(group, most)
            count *= len(found)
            if count > most:
                return None
            listed.append(found)
        return [
            {patch: x for choice in chosen for patch, x in choice.items()}
            for chosen in product(*listed)
        ]

    def first(self) -> Choice:
        """Return a choice that agrees pair by pair as far as there is one."""
        choice: Choice = {}
        for group in self._groups():
            for found in self._choices_of(group, 0)[:1]:
                choice.update(found)
        return choice

    def _groups(self) -> list[list[int]]:
        """Return the ambiguous patches in groups that do not touch each other."""
        seen: set[int] = set()
        groups = []
        for start in self.ambiguous:
            if start in seen:
                continue
            seen.add(start)
            group = [start]
            for patch in group:
                new = [other for other in self._together[patch] if other not in seen]
                seen.update(new)
                group.extend(new)
            groups.append(group)
        return groups

    def _choices_of(self, group: Sequence[int], most: int) -> list[Choice]:
        """Return the choices of a group that agree, one more than `most` at most."""
        found: list[Choice] = []
        stack: list[Choice] = [{}]
        while stack and len(found) <= most:
            choice = stack.pop()
            if len(choice) == len(group):
                found.append(choice)
                continue
            patch = group[len(choice)]
            for x in reversed(np.flatnonzero(self._patches[patch].left).tolist()):
                others = self._together[patch].items()
                if all(agree[x, choice[y]] for y, agree in others if y in choice):
                    stack.append({**choice, patch: x})
        return found
