# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""
Compatibility of the hypotheses of joined pieces.

Pieces that share a face, q points that span a hyperplane, may each be mirrored in it. The apex of
a piece is a point that lies off the hyperplane in every placement. A flat piece has no apex and
passes the sides on: the pieces at all its faces form one site. Two hypotheses are compatible if
they agree on the distances of shared points; constraints between them may rule out either side.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from dg_localization.solver.assemble.combinations import (
    EITHER,
    FREE,
    Apexes,
    Network,
    PieceLink,
    Site,
)
from dg_localization.solver.assemble.solved_pieces import SolvedPiece, SolvedPieces
from dg_localization.solver.box import FloatArray
from dg_localization.solver.contract.sides import farthest_apex
from dg_localization.solver.decompose.graph import BoolArray, Pair, Points, pairs_of
from dg_localization.solver.decompose.rigid_components import RANK_TOLERANCE
from dg_localization.solver.problem import Problem, Side, SideConstraint, points_of
from dg_localization.solver.result import Joint, JointKind
from dg_localization.solver.search.budget import Budget
from dg_localization.solver.search.search import contracted
from dg_localization.solver.subproblem import (
    MOST_CONTRACTED,
    Bounds,
    bounds_within,
    restricted,
    restricted_boxes,
)

MOST_PAIRS = 4096
"""Pieces with more pairs of hypotheses are not compared: all pairs count as compatible."""


class Linker:
    """Finds the compatible hypotheses of joined pieces."""

    def __init__(
        self,
        problem: Problem,
        solved: SolvedPieces,
        budget: Budget,
        within: Sequence[Bounds] | None,
    ) -> None:
        self._problem = problem
        self._within = within
        self._pieces = solved.pieces
        self._budget = budget
        self._of_two: dict[tuple[int, ...], tuple[Points, Bounds] | None] = {}
        self._crossing: dict[int, set[int]] = {}
        for i, j in crossing_pairs(problem, solved.pieces):
            self._crossing.setdefault(i, set()).add(j)
            self._crossing.setdefault(j, set()).add(i)

    def network(self, joints: Sequence[Joint]) -> Network:
        """Return the sites and links of all joints; pieces without a link are compatible."""
        faces = [joint for joint in joints if joint.kind is JointKind.REFLECTION]
        network = Network(self._sites(faces))
        for joint in joints:
            if joint.kind is not JointKind.REFLECTION:
                self._add_links(network, joint.pieces, None)
        for site in network.sites:
            self._add_links(network, site.members, site)
        return network

    def _sites(self, joints: Sequence[Joint]) -> list[Site]:
        """Return the sites; joints connected by flat pieces form one site."""
        found = [self._apexes(joint) for joint in joints]
        apexes = [known for known, _ in found]
        group = list(range(len(joints)))
        flat_at: dict[tuple[int, int], int] = {}
        for number, joint in enumerate(joints):
            for piece in joint.pieces:
                if len(self._pieces[piece].points) > MOST_CONTRACTED:
                    continue
                for x in range(self._n(piece)):
                    if (piece, x) in apexes[number]:
                        continue
                    old, new = group[number], group[flat_at.setdefault((piece, x), number)]
                    group = [new if g == old else g for g in group]
        sites: list[Site] = []
        for root in dict.fromkeys(group):
            numbers = [x for x, g in enumerate(group) if g == root]
            if len(numbers) == 1:
                joint = joints[root]
                site = Site(joint.points, list(joint.pieces), apexes[root])
            else:
                site = self._site_of([joints[x] for x in numbers], [apexes[x] for x in numbers])
            site.lost = site.lost.union(*(found[x][1] for x in numbers)) - site.apexes.keys()
            # The sides of all others are relative to the first.
            is_open = {x: site.n_certain(x) < self._n(x) for x in site.members}
            site.members.sort(key=is_open.__getitem__)
            site.number = len(sites)
            sites.append(site)
        return sites

    def _apexes(self, joint: Joint) -> tuple[Apexes, set[tuple[int, int]]]:
        """
        Return the apexes of the hypotheses at a face, and the hypotheses that may have one.

        These have an apex only with some hypotheses of other pieces that bound the face too, or
        were not examined in time.
        """
        apexes: Apexes = {}
        perhaps: set[tuple[int, int]] = set()
        for number in joint.pieces:
            piece = self._pieces[number]
            others: list[SolvedPiece] = []
            face: Bounds | None = None
            for x in range(self._n(number)):
                if self._budget.is_over():
                    perhaps.update((number, y) for y in range(x, self._n(number)))
                    break
                # Most pieces have an apex by their own bounds.
                apex = apex_of(piece, x, joint.points)
                if apex is None:
                    if face is None:
                        # In space a piece may tell one side of the face alone.
                        found = (p for p in self._pieces if p is not piece)
                        others = [p for p in found if len({*joint.points} & {*p.points}) > 1]
                        parts = [other.among(joint.points) for other in others]
                        face = bounds_within(joint.points, parts)
                    apex = apex_of(piece, x, joint.points, face)
                if apex is not None:
                    apexes[number, x] = apex
                elif self._has_apex_with_some(piece, x, joint.points, others):
                    perhaps.add((number, x))
        return apexes, perhaps

    def _has_apex_with_some(
        self, piece: SolvedPiece, x: int, face: Points, others: Sequence[SolvedPiece]
    ) -> bool:
        """Return whether a hypothesis has an apex with some hypothesis of another piece."""
        for other in others:
            n_others = len(other.hypotheses)
            if n_others > 1 and n_others * len(piece.hypotheses) <= MOST_PAIRS:
                for y in range(n_others):
                    bounds = bounds_within(face, [other.among(face, y)])
                    if apex_of(piece, x, face, bounds) is not None:
                        return True
        return False

    def _site_of(self, joints: Sequence[Joint], apexes: Sequence[Apexes]) -> Site:
        """Return one site of joints with flat pieces between them, at the most decisive face."""
        members = sorted({piece for joint in joints for piece in joint.pieces})
        at_faces = tuple(sorted({point for joint in joints for point in joint.points}))
        n_joints = {x: sum(x in joint.pieces for joint in joints) for x in members}
        between = [x for x in members if n_joints[x] > 1]
        # Not flat, a piece is mirrored at each of its faces: one site has no sides for that.
        n_faces = Counter(key for known in apexes for key in known)
        best = Site(joints[0].points, members, {}, is_merged=True)
        for joint, known in zip(joints, apexes, strict=True):
            found = {key: apex for key, apex in known.items() if n_faces[key] == 1}
            for others in apexes:
                for (piece, x), apex in others.items():
                    is_new = (piece, x) not in found and piece not in (*between, *joint.pieces)
                    if is_new and self._is_apex(between, piece, x, (at_faces, joint.points, apex)):
                        found[piece, x] = apex
            if len(found) > len(best.apexes):
                best = Site(joint.points, members, found, is_merged=True)
        best.lost = frozenset().union(*apexes) - best.apexes.keys()
        return best

    def _is_apex(
        self, between: Sequence[int], piece: int, x: int, named: tuple[Points, Points, int]
    ) -> bool:
        """Return whether an apex of a piece is also an apex at another face of flat pieces."""
        at_faces, face, apex = named
        points = tuple(sorted({*at_faces, apex}))
        if len(points) > MOST_CONTRACTED or self._budget.is_over():
            return False
        parts = [self._pieces[number].among(points) for number in between]
        parts.append(self._pieces[piece].among(points, x))
        left = self._contracted(points, parts)
        return left is not None and best_apex(left, points, face, [apex]) is not None

    def _add_links(self, network: Network, members: Sequence[int], site: Site | None) -> None:
        """Link each piece of a joint or site with its first piece."""
        hub = members[0]
        for other in members[1:]:
            link = None if self._budget.is_overdue() else self._link(hub, other, site)
            if link is not None:
                network.links.append(link)
            elif site:
                network.n_unlinked += 1
        if site is None:
            return
        has_open_hub = site.n_certain(hub) < self._n(hub)
        has_open_hub &= sum(site.n_certain(x) > 0 for x in members) > 2
        if has_open_hub or site.lost:
            network.is_exact = False
            network.lists_all_sides &= not site.lost
            self._allow_more(network.links, site, has_open_hub)

    def _allow_more(self, links: Sequence[PieceLink], site: Site, has_open_hub: bool) -> None:
        """Allow either side at a lost apex, or at an apex where the hub of a site has none."""
        for link in links:
            for (x, y), sides in link.allowed.items() if link.site is site else ():
                first, second = (link.first, x), (link.second, y)
                is_open = has_open_hub and first not in site.apexes and second in site.apexes
                if sides == FREE and (is_open or not site.lost.isdisjoint((first, second))):
                    link.allowed[x, y] = EITHER

    def _n(self, piece: int) -> int:
        return len(self._pieces[piece].hypotheses)

    def _link(self, first: int, second: int, site: Site | None) -> PieceLink | None:
        """Return the compatible hypotheses of two pieces; None if all are compatible."""
        pieces = self._pieces[first], self._pieces[second]
        if self._n(first) * self._n(second) > MOST_PAIRS:
            return None
        is_between = self._is_between(*pieces)
        together = _agreeing(pieces)
        if site is None and not is_between and together.all():
            return None
        link = PieceLink(first, second, site)
        for x, y in np.argwhere(together).tolist():
            sides: tuple[Side, ...] = FREE
            if site and (first, x) in site.apexes and (second, y) in site.apexes:
                same = site.apexes[first, x] == site.apexes[second, y]
                sides = (Side.SAME,) if same else EITHER
            if is_between and not self._budget.is_over():
                sides = tuple(s for s in sides if self.bounds_of_two(link, x, y, s) is not None)
            if sides:
                link.allowed[x, y] = sides
        return link

    def _is_between(self, first: SolvedPiece, second: SolvedPiece) -> bool:
        """Return whether a bound or constraint connects two pieces."""
        points = {*first.points, *second.points}
        if len(points) > MOST_CONTRACTED:
            return False
        if self._within is not None or self._problem.constraints_among(points):
            return True
        inside = [set(piece.points) for piece in (first, second)]
        apart = inside[0] - inside[1], inside[1] - inside[0]
        return any(not self._crossing.get(p, set()).isdisjoint(apart[1]) for p in apart[0])

    def bounds_of_two(
        self, link: PieceLink, x: int, y: int, side: int
    ) -> tuple[Points, Bounds] | None:
        """Return the bounds of two hypotheses on given sides; None if they have no placement."""
        key = (link.first, link.second, x, y, side)
        if key in self._of_two:
            return self._of_two[key]
        chosen = (self._pieces[link.first], x), (self._pieces[link.second], y)
        points = tuple(sorted({p for piece, _ in chosen for p in piece.points}))
        decided = []
        if link.site and side:
            ends = [link.site.apexes[link.first, x], link.site.apexes[link.second, y]]
            if ends[0] != ends[1]:
                decided = [SideConstraint(link.site.face, ends[0], ends[1], Side(side))]
        if len(points) > MOST_CONTRACTED:
            named = {point for constraint in decided for point in points_of(constraint)}
            shared = set(chosen[0][0].points) & set(chosen[1][0].points)
            points = tuple(sorted(named or shared))
        decided = [c for c in decided if set(points).issuperset(points_of(c))]
        parts = [piece.among(points, number) for piece, number in chosen]
        bounds = self._contracted(points, parts, decided)
        self._of_two[key] = (points, bounds) if bounds else None
        return self._of_two[key]

    def _contracted(
        self,
        points: Points,
        parts: Sequence[tuple[Points, Bounds]],
        constraints: Sequence[SideConstraint] = (),
    ) -> Bounds | None:
        """Return the bounds of all pairs of some points; None if they have no placement."""
        bounds = bounds_within(points, parts)
        problem = restricted(self._problem, points, bounds, constraints)
        if problem is None:
            return None
        within = restricted_boxes(self._within, points)
        return contracted(problem, self._budget, within)


def crossing_pairs(problem: Problem, pieces: Sequence[SolvedPiece]) -> list[Pair]:
    """Return the pairs with a lower bound that lie in no piece."""
    holders: list[set[int]] = [set() for _ in range(problem.n_points)]
    for number, piece in enumerate(pieces):
        for point in piece.points:
            holders[point].add(number)
    bounded = problem.pairs.pairs[problem.pairs.lower > 0.0].tolist()
    return [(i, j) for i, j in bounded if holders[i].isdisjoint(holders[j])]


def _agreeing(pieces: tuple[SolvedPiece, SolvedPiece]) -> BoolArray:
    """Return which pairs of hypotheses of two pieces agree on the distances of shared points."""
    shared = set(pieces[0].points) & set(pieces[1].points)
    together = np.ones([len(piece.hypotheses) for piece in pieces], dtype=np.bool_)
    for i, j in pairs_of(shared):
        ends = []
        for piece in pieces:
            index = piece.points.index(i), piece.points.index(j)
            ends.append(np.array([h.bounds_of_pair(*index) for h in piece.hypotheses]))
        first, second = ends
        together &= first[:, None, 0] <= second[None, :, 1]
        together &= second[None, :, 0] <= first[:, None, 1]
    return together


def is_degenerate(corners: FloatArray, least_m: float = 0.0) -> bool:
    """
    Return whether the corners of a face, shape (q, q) in m, span no hyperplane.

    Pieces can rotate about such a face. A face narrower than `least_m` also counts as one.
    """
    spans_m = np.linalg.svd(corners[1:] - corners[0], compute_uv=False)
    least_m = max(least_m, RANK_TOLERANCE * spans_m.max(initial=0.0))
    return bool((spans_m <= least_m).any())


def best_apex(bounds: Bounds, points: Points, face: Points, others: list[int]) -> int | None:
    """Return the point farthest off the hyperplane of a face; None if none is certainly off it."""
    place = {point: x for x, point in enumerate(points)}
    corners, apexes = ([place[point] for point in some] for some in (face, others))
    best = int(
        farthest_apex(np.array(bounds), np.array(corners), np.array(apexes, dtype=np.int64))
    )
    return points[best] if best >= 0 else None


def apex_of(piece: SolvedPiece, x: int, face: Points, of_face: Bounds | None = None) -> int | None:
    """Return a point that is off the hyperplane of a face in every placement of a hypothesis."""
    points, hypothesis = piece.points, piece.hypotheses[x]
    others = [point for point in points if point not in face]
    if len(points) > MOST_CONTRACTED:
        # One placement serves all hypotheses: most points are near the face in each.
        positions = piece.hypotheses[0].positions
        if positions is None:
            return None
        place = {point: row for row, point in enumerate(points)}
        center = positions[[place[point] for point in face]].mean(axis=0)
        away = ((positions[[place[point] for point in others]] - center) ** 2).sum(axis=1)
        others = [others[row] for row in np.argsort(away)[:MOST_CONTRACTED]]
        points = tuple(sorted((*face, *others)))
        bounds = hypothesis.bounds_among([place[point] for point in points])
    else:
        bounds = hypothesis.lower, hypothesis.upper
    if of_face is not None:
        bounds = bounds_within(points, [(points, bounds), (face, of_face)])
    return best_apex(bounds, points, face, others)
