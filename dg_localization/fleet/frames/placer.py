"""
From distances to coordinates: the fixed frame, mirror images, and headings.

The solver bounds the coordinates of a hypothesis in a frame made of its own points: a core of q
points, and one more point that tells the two mirror images apart. What is known of the core in
the fixed frame (coordinates of anchors, or rays of the reference robot) turns that into the fixed
frame. Interval arithmetic, rounded outward, from end to end: the true placement cannot get lost.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations
import math

import numpy as np
from numpy.typing import NDArray

from dg_localization.fleet.anchors import MAX_CORES
from dg_localization.fleet.cartesian import ANGLE_SWEEPS, contract_boxes, tighten_by_angles
from dg_localization.fleet.config import FleetConfig
from dg_localization.fleet.constraints import Constraints, Ray, angles_rad
from dg_localization.fleet.estimate import FixedFrame, LinkKey, Placement
from dg_localization.fleet.headings import Heading, NoHeadingError, best_rotation, estimate_heading
from dg_localization.fleet.snapshot import Snapshot
from dg_localization.interval.angles import rotation_2d
from dg_localization.interval.arrays import (
    Interval,
    cross,
    determinant,
    normalized,
    rotate,
)
from dg_localization.solver.contract.coordinates import enclose_coordinates
from dg_localization.solver.result import Hypothesis

FloatArray = NDArray[np.float64]


MAX_APEXES = 4
"""How many points beside the core are tried for each."""

MAX_BOXES = 16
"""Up to how many boxes of a hypothesis are enclosed one by one instead of by their hull."""

SWEEPS = 20
"""Most passes of the contraction of coordinate boxes."""


@dataclass(frozen=True)
class FramePlan:
    """
    How the points that are connected to the fixed frame get their coordinates.

    Parameters
    ----------
    frame : FixedFrame
    points : tuple of int
        The connected points, the held ones first.
    n_held : int
        How many of them the solver places. The others hang on fewer than q distances: they are
        free to swing, and each would cost the solver a whole circle or sphere of boxes.
    cores : tuple of tuple of int
        Choices of q held points whose place in the fixed frame is known, best first.

    """

    frame: FixedFrame
    points: tuple[int, ...]
    n_held: int
    cores: tuple[tuple[int, ...], ...]

    @property
    def held(self) -> tuple[int, ...]:
        """The points that the solver places."""
        return self.points[: self.n_held]


def _plan(
    frame: FixedFrame,
    constraints: Constraints,
    component: tuple[int, ...],
    cores: tuple[tuple[int, ...], ...],
    kept: Iterable[int] = (),
) -> FramePlan:
    """Return the plan for a connected part of the fleet; the first core and `kept` are held."""
    loose = constraints.loose_points(component, {*cores[0], *kept})
    held = tuple(point for point in component if point not in loose)
    return FramePlan(
        frame=frame,
        points=held + tuple(reversed(loose)),
        n_held=len(held),
        cores=tuple(core for core in cores if not set(core) & set(loose)),
    )


def plan_frames(
    snapshot: Snapshot, constraints: Constraints, alternatives: list[Constraints]
) -> list[FramePlan] | str:
    """
    Choose one fixed frame for all alternatives.

    Parameters
    ----------
    snapshot : Snapshot
    constraints : Constraints
        What all links of a snapshot say, contradictions included.
    alternatives : list of Constraints
        What they say when some are left out.

    Returns
    -------
    list of FramePlan or str
        One plan for each alternative, or a sentence that says why there is no frame.

    """
    config, anchored = snapshot.config, snapshot.anchors.cores
    if anchored:
        names = tuple(config.anchors)
        frame = FixedFrame('anchors', names)
        origin, kept = anchored[0][0], snapshot.anchors.boxes
        plans = [
            _plan(frame, alternative, alternative.component_of(origin), anchored, kept)
            for alternative in alternatives
        ]
        free = {i for i, robot in enumerate(config.robots) if robot not in config.anchors}
        if free and not any(free & set(plan.points) for plan in plans):
            return f'no robot is connected to the anchors {", ".join(names)} by a usable range'
        return plans
    return _plan_from_reference(config, constraints, alternatives)


def _plan_from_reference(
    config: FleetConfig, constraints: Constraints, alternatives: list[Constraints]
) -> list[FramePlan] | str:
    """Return plans in the frame of the reference robot, or why there are none."""
    origin = config.robots.index(config.reference_robot)
    components = [alternative.component_of(origin) for alternative in alternatives]
    if all(len(points) == 1 for points in components):
        return (
            f'reference robot {config.reference_robot} is not connected to any other by a usable '
            'range: nothing fixes the frame'
        )
    headed = [
        _heading_cores(alternative, origin, points)
        for alternative, points in zip(alternatives, components, strict=True)
    ]
    if all(headed):
        frame = FixedFrame('heading', (config.reference_robot,))
        return [
            _plan(frame, alternative, points, cores)
            for alternative, points, cores in zip(alternatives, components, headed, strict=True)
        ]
    core = _robot_core(config, constraints, origin, components)
    frame = FixedFrame('robots', tuple(config.points[i] for i in core))
    return [
        _plan(frame, alternative, points, (core,))
        for alternative, points in zip(alternatives, components, strict=True)
    ]


def _heading_cores(
    constraints: Constraints, origin: int, points: tuple[int, ...]
) -> tuple[tuple[int, ...], ...]:
    """Return sets of the origin and q - 1 of its targets whose rays fix its heading."""
    rays = [
        ray
        for ray in constraints.rays.get(origin, ())
        if ray.target in points
        and ray.half_width_rad < math.pi / 2
        and constraints.lower[origin, ray.target] > 0.0
    ]
    if constraints.dimension == 2:
        rays.sort(key=lambda ray: ray.half_width_rad)
        return tuple((origin, ray.target) for ray in rays[:MAX_CORES])
    margins = {}
    for a, b in combinations(rays, 2):
        angle = float(angles_rad(a.direction, b.direction))
        margin = min(angle, math.pi - angle) - a.half_width_rad - b.half_width_rad
        if margin > 0.0:
            margins[origin, a.target, b.target] = margin
    return tuple(sorted(margins, key=lambda core: -margins[core])[:MAX_CORES])


def _robot_core(
    config: FleetConfig,
    constraints: Constraints,
    origin: int,
    components: list[tuple[int, ...]],
) -> tuple[int, ...]:
    """
    Return the reference robot and the next ones that every alternative connects to it.

    One that may be in the same place as the reference robot gives no direction: such are taken
    only when there are no others. What is left out to resolve a contradiction does not count
    here: the frame should not turn because of it.
    """
    n_robots, n_points = len(config.robots), len(config.points)
    in_order = [*range(origin + 1, n_robots), *range(origin), *range(n_robots, n_points)]
    shared = set.intersection(*(set(points) for points in components))
    connected = [point for point in in_order if point in shared]
    connected.sort(key=lambda point: constraints.lower[origin, point] <= 0.0)
    return (origin, *connected[: config.dimension - 1])


@dataclass(frozen=True)
class _Handed:
    """A choice of handedness: on which side of the core the point `apex` lies."""

    core: tuple[int, ...]
    apex: int
    side: int


class Placer:
    """
    Turns the hypotheses of one problem into placements in the fixed frame.

    Parameters
    ----------
    snapshot : Snapshot
    constraints : Constraints
        What the problem was made of.
    plan : FramePlan
        The frame; the points of the problem are ``plan.held``, in that order.
    dropped : frozenset of LinkKey
        What `constraints` leave out.

    """

    def __init__(
        self,
        snapshot: Snapshot,
        constraints: Constraints,
        plan: FramePlan,
        dropped: frozenset[LinkKey],
    ) -> None:
        self._config = snapshot.config
        self._plan = plan
        self._dropped = dropped
        self._dimension = snapshot.config.dimension
        index = {point: i for i, point in enumerate(plan.points)}
        # A core point that is not connected pads a fleet that is too small for a full frame.
        self._cores = [tuple(index[p] for p in core if p in index) for core in plan.cores]
        self._rays = {
            index[observer]: [
                Ray(index[ray.target], ray.direction, ray.half_width_rad)
                for ray in rays
                if ray.target in index
            ]
            for observer, rays in constraints.rays.items()
            if observer in index
        }
        self._anchors = {
            index[point]: box for point, box in snapshot.anchors.boxes.items() if point in index
        }
        held = set(plan.held)
        self._chiralities = [
            (tuple(index[p] for p in chirality.points), chirality.sign)
            for chirality in constraints.chiralities
            if held.issuperset(chirality.points)
        ]
        renamed = np.full(len(constraints.lower), -1)
        renamed[list(plan.held)] = np.arange(plan.n_held)
        corners = renamed[constraints.angles.corners]
        rows = (corners >= 0).all(axis=1)
        self._corners, self._cosines = corners[rows], constraints.angles.cosines()[rows]
        chosen = np.ix_(plan.points, plan.points)
        self._lower, self._upper = constraints.lower[chosen], constraints.upper[chosen]
        self._to_fixed = [self._core_pose(core) for core in self._cores]

    def placements(self, hypothesis: Hypothesis) -> list[Placement]:
        """
        Return the placements a hypothesis stands for: one, or two that mirror each other.

        None at all when the rays that fix headings rule out every one.
        """
        found: list[tuple[_Handed | None, Interval]] = []
        for handed in self._choices(hypothesis):
            enclosure = self._enclose(hypothesis, handed)
            if enclosure is not None:
                found.append((handed, enclosure))
        if len(found) == 2 and self._chiralities:
            # Only one is true, but which one depends on where in the hypothesis the truth is.
            found = [(None, found[0][1].hull(found[1][1]))]
        if len(found) == 2 and _equal(found[0][1], found[1][1]):
            found = found[:1]
        placements: list[Placement] = []
        for handed, held in found:
            positions = self._fixed_positions(hypothesis, handed, held)
            enclosure = self._with_loose_points(held)
            if enclosure is not None:
                placement = self._finish(hypothesis, positions, enclosure, bool(placements))
                placements += [placement] if placement is not None else []
        return placements

    def most_placements(self, hypothesis: Hypothesis) -> int:
        """Return how many placements a hypothesis stands for at most, without making them."""
        return 1 if self._chiralities else len(self._choices(hypothesis))

    def _choices(self, hypothesis: Hypothesis) -> list[_Handed | None]:
        """Return the handedness that may be: one when a chirality says so, or both."""
        core = self._cores[0]
        others = [p for p in range(self._plan.n_held) if p not in core]
        if len(core) < self._dimension or not others:
            return [None]
        known = {}
        for points, sign in self._chiralities:
            apexes = set(points) - set(core)
            if len(apexes) == 1 and set(core) < set(points):
                apex = apexes.pop()
                known[apex] = sign * _parity(points, (*core, apex))
        apex = _far_apexes(hypothesis, core, list(known) or others)[0]
        sides = [known[apex]] if known else [1, -1]
        return [_Handed(core, apex, side) for side in sides]

    def _enclose(self, hypothesis: Hypothesis, handed: _Handed | None) -> Interval | None:
        """Return the coordinates of all points in the fixed frame, or None when there are none."""
        boxes = hypothesis.boxes
        if len(boxes) > MAX_BOXES:
            boxes = np.stack([hypothesis.lower, hypothesis.upper])[None]
        everyone = range(self._plan.n_held)
        apexes = {}
        if handed is not None:
            for core in self._cores:
                others = [point for point in everyone if point not in core]
                apexes[core] = _far_apexes(hypothesis, core, others)
        total = None
        for lower, upper in boxes:
            enclosure = self._enclose_box(lower, upper, handed, apexes)
            if enclosure is not None:
                total = enclosure if total is None else total.hull(enclosure)
        return total

    def _enclose_box(
        self,
        lower: FloatArray,
        upper: FloatArray,
        handed: _Handed | None,
        apexes: dict[tuple[int, ...], list[int]],
    ) -> Interval | None:
        """Return the coordinates one box of distances allows."""
        lower, upper = np.array(lower), np.array(upper)
        tighten_by_angles(lower, upper, self._corners, self._cosines, ANGLE_SWEEPS)
        if (lower > upper).any():
            return None
        points, side = self._cores[0], 1
        if handed is not None:
            points, side = (*handed.core, handed.apex), handed.side
        local = _enclose_local(lower, upper, points, self._dimension)
        if local is None:
            return None
        fixed = self._contract(self._to_fixed[0](_mirrored(local, side)), lower, upper)
        if fixed is None or handed is None:
            return fixed
        for core, to_fixed in zip(self._cores, self._to_fixed, strict=True):
            for other in apexes[core]:
                side = _orientation(fixed, (*core, other))
                if side == 0 or (core, other) == (handed.core, handed.apex):
                    continue
                local = _enclose_local(lower, upper, (*core, other), self._dimension)
                if local is None:
                    return None
                fixed = fixed.intersect(to_fixed(_mirrored(local, side)))
                if fixed.empty():
                    return None
        fixed = self._contract(fixed, lower, upper)
        if fixed is None:
            return None
        return None if self._contradicts_chirality(fixed) else fixed

    def _contradicts_chirality(self, fixed: Interval) -> bool:
        """Return whether some known handedness is certainly another in these coordinates."""
        if not self._chiralities:
            return False
        corners = fixed[np.array([points for points, _ in self._chiralities])]
        volume = determinant(corners[:, 1:] - corners[:, :1])
        signs = np.array([sign for _, sign in self._chiralities])
        return bool(np.where(signs > 0, volume.upper < 0.0, volume.lower > 0.0).any())

    def _contract(self, fixed: Interval, lower: FloatArray, upper: FloatArray) -> Interval | None:
        """Return the part that the distances and the coordinates of the anchors allow."""
        low, high = np.array(fixed.lower), np.array(fixed.upper)
        if self._plan.frame.kind == 'anchors':
            for point, box in self._anchors.items():
                low[point] = np.maximum(low[point], box.lower)
                high[point] = np.minimum(high[point], box.upper)
        if (low > high).any() or not contract_boxes(low, high, lower, upper, SWEEPS):
            return None
        return Interval(low, high)

    def _with_loose_points(self, held: Interval) -> Interval | None:
        """Return the enclosure of the held points with that of what hangs on them."""
        n_loose = len(self._plan.points) - self._plan.n_held
        unbounded = np.full((n_loose, self._dimension), np.inf)
        low = np.concatenate([held.lower, -unbounded])
        high = np.concatenate([held.upper, unbounded])
        if n_loose and not contract_boxes(low, high, self._lower, self._upper, SWEEPS):
            return None
        return Interval(low, high)

    def _core_pose(self, core: tuple[int, ...]) -> _Pose:
        """Return what is known of the axes that a core makes, in the fixed frame."""
        kind = self._plan.frame.kind
        if kind == 'robots':
            return _Pose(None, None)
        if kind == 'anchors':
            origin = self._anchors[core[0]]
            edges = [self._anchors[point] - origin for point in core[1:]]
            return _Pose(_axes(edges), origin)
        rays = {ray.target: ray for ray in self._rays[core[0]]}
        chosen = [rays[point] for point in core[1:]]
        if self._dimension == 2:
            x, y = chosen[0].direction[:2]
            return _Pose(rotation_2d(math.atan2(y, x), chosen[0].half_width_rad), None)
        edges = [
            Interval.around(ray.direction, 2.0 * math.sin(ray.half_width_rad / 2.0) + 1e-15)
            for ray in chosen
        ]
        return _Pose(_axes(edges), None)

    def _fixed_positions(
        self, hypothesis: Hypothesis, handed: _Handed | None, enclosure: Interval
    ) -> FloatArray:
        """Return the placement of the solver, moved into the fixed frame and its enclosure."""
        if hypothesis.positions is None:
            return np.full(enclosure.lower.shape, np.nan)
        positions = np.array(hypothesis.positions)
        if handed is not None:
            corner = positions[[*handed.core, handed.apex]]
            if np.linalg.det(corner[1:] - corner[0]) * handed.side < 0.0:
                positions[:, -1] *= -1.0
        return np.clip(self._moved(positions), enclosure.lower, enclosure.upper)

    def _moved(self, positions: FloatArray) -> FloatArray:
        """Return positions after the rotation and translation into the fixed frame."""
        kind = self._plan.frame.kind
        if kind == 'anchors':
            points = list(self._anchors)
            targets = np.array([(box.lower + box.upper) / 2.0 for box in self._anchors.values()])
            centre = positions[points].mean(axis=0)
            rotation = best_rotation(positions[points] - centre, targets - targets.mean(axis=0))
            return (positions - centre) @ rotation.T + targets.mean(axis=0)
        core = self._cores[0]
        local = positions - positions[core[0]]
        if kind == 'heading':
            rays = [ray for ray in self._rays[core[0]] if ray.target < self._plan.n_held]
            directions = _unit_rows(local[[ray.target for ray in rays]])
            weights = [1.0 / (ray.half_width_rad + 1e-6) for ray in rays]
            seen = np.array([ray.direction[: self._dimension] for ray in rays])
            rotation = best_rotation(directions, seen, np.array(weights))
        else:
            rotation = _rotation_to_axes(local[list(core[1:])])
        return local @ rotation.T

    def _finish(
        self, hypothesis: Hypothesis, positions: FloatArray, enclosure: Interval, mirrored: bool
    ) -> Placement | None:
        """Return the placement with its headings, or None when no heading agrees with the rays."""
        positions = hang(positions, self._lower, self._upper)
        positions = np.clip(positions, enclosure.lower, enclosure.upper)
        headings = {}
        origin = self._cores[0][0]
        for observer, rays in self._rays.items():
            if self._plan.frame.kind == 'heading' and observer == origin:
                headings[observer] = Heading(np.array([0.0, 0.0, 0.0, 1.0]), 0.0)
                continue
            try:
                heading = estimate_heading(observer, rays, positions, enclosure)
            except NoHeadingError:
                return None
            if heading is not None:
                headings[observer] = heading
        return self._rows(hypothesis, positions, enclosure, headings, mirrored)

    def _holds_loose_points(self, positions: FloatArray) -> bool:
        """Return whether the loose points certainly keep their distances."""
        for i in range(self._plan.n_held, len(positions)):
            gaps = (Interval.point(positions[i]) - Interval.point(positions)).square()
            total = gaps[:, 0]
            for axis in range(1, self._dimension):
                total = total + gaps[:, axis]
            meets = (total.lower >= self._lower[i]) & (total.upper <= self._upper[i])
            meets[i] = True
            if not meets.all():
                return False
        return True

    def _rows(
        self,
        hypothesis: Hypothesis,
        positions: FloatArray,
        enclosure: Interval,
        headings: dict[int, Heading],
        mirrored: bool,
    ) -> Placement:
        """Return a placement with one row for each point of the fleet."""
        n_points, n_robots = len(self._config.points), len(self._config.robots)
        points = list(self._plan.points)
        all_positions = np.full((n_points, self._dimension), np.nan)
        all_positions[points] = positions
        boxes = np.empty((n_points, 2, self._dimension))
        boxes[:, 0], boxes[:, 1] = -np.inf, np.inf
        boxes[points, 0], boxes[points, 1] = enclosure.lower, enclosure.upper
        orientations = np.full((n_robots, 4), np.nan)
        half_widths = np.full(n_robots, np.pi)
        for local, heading in headings.items():
            if points[local] < n_robots:
                orientations[points[local]] = heading.orientation_xyzw
                half_widths[points[local]] = heading.half_width_rad
        return Placement(
            positions_m=all_positions[:n_robots],
            enclosure_m=boxes[:n_robots],
            orientations_xyzw=orientations,
            heading_known=~np.isnan(orientations[:, 0]),
            heading_half_width_rad=half_widths,
            proved=hypothesis.proved and self._holds_loose_points(positions),
            flexible=hypothesis.flexible or len(points) > self._plan.n_held,
            mirrored=mirrored,
            landmarks_m=all_positions[n_robots:],
            landmark_enclosure_m=boxes[n_robots:],
            dropped=tuple(sorted(self._dropped)),
        )


@dataclass(frozen=True)
class _Pose:
    """Where the axes of a core lie in the fixed frame; None means that they coincide."""

    axes: Interval | None
    origin: Interval | None

    def __call__(self, local: Interval) -> Interval:
        """Return coordinates along the axes of the core as coordinates in the fixed frame."""
        turned = local if self.axes is None else rotate(self.axes, local)
        return turned if self.origin is None else turned + self.origin[None, :]


def _axes(edges: list[Interval]) -> Interval:
    """Return the matrix whose columns are the axes that q - 1 edges from the origin make."""
    first = normalized(edges[0])
    if len(edges) == 1:
        x, y = first[0], first[1]
        return Interval.stack([Interval.stack([x, -y]), Interval.stack([y, x])], axis=0)
    third = normalized(cross(first, edges[1]))
    return Interval.stack([first, cross(third, first), third])


def _enclose_local(
    lower: FloatArray, upper: FloatArray, frame: tuple[int, ...], dimension: int
) -> Interval | None:
    """
    Return coordinates in the frame of some points, or None when there is no placement.

    A frame of fewer than q + 1 points is padded with points nothing is known of: they take the
    free places in the frame and bound nothing.
    """
    n_points, n_pads = len(lower), dimension + 1 - len(frame)
    padded_lower = np.zeros((n_points + n_pads, n_points + n_pads))
    padded_upper = np.full(padded_lower.shape, np.inf)
    np.fill_diagonal(padded_upper, 0.0)
    padded_lower[:n_points, :n_points] = lower
    padded_upper[:n_points, :n_points] = upper
    pads = range(n_points, n_points + n_pads)
    try:
        enclosure = enclose_coordinates(padded_lower, padded_upper, (*frame, *pads))
    except ValueError:
        return None
    # By definition of the frame, whether or not a pad lets the solver see it.
    for place, point in enumerate(frame):
        enclosure[point, :, place:] = 0.0
    return Interval(enclosure[:n_points, 0], enclosure[:n_points, 1])


def _far_apexes(hypothesis: Hypothesis, core: tuple[int, ...], candidates: list[int]) -> list[int]:
    """Return the candidates that are farthest from the hyperplane of the core, best first."""
    if len(candidates) < 2:
        return candidates
    edges = None
    if hypothesis.positions is not None:
        edges = hypothesis.positions - hypothesis.positions[core[0]]
    heights = {}
    for apex in candidates:
        local = _enclose_local(hypothesis.lower, hypothesis.upper, (*core, apex), len(core))
        if local is not None:
            span = 0.0 if edges is None else abs(float(np.linalg.det(edges[[*core[1:], apex]])))
            # Certainly far first; those that may lie in the hyperplane by where they seem to be.
            heights[apex] = (local.lower[apex, -1], span)
    ranked = sorted(heights, key=lambda apex: heights[apex], reverse=True)
    return ranked[:MAX_APEXES] or candidates[:1]


def _rotation_to_axes(edges: FloatArray) -> FloatArray:
    """Return the rotation that takes the first edge to +x, the second to the xy plane, y >= 0."""
    basis, triangle = np.linalg.qr(edges.T, mode='complete')
    basis[:, : len(edges)] *= np.where(np.diagonal(triangle) < 0.0, -1.0, 1.0)
    if np.linalg.det(basis) < 0.0:
        basis[:, -1] *= -1.0
    return basis.T


def _unit_rows(vectors: FloatArray) -> FloatArray:
    """Return the rows scaled to length 1; a zero row stays."""
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0.0, lengths, 1.0)


def _parity(points: tuple[int, ...], order: tuple[int, ...]) -> int:
    """Return the sign of the permutation that takes `points` to `order`."""
    places = [order.index(point) for point in points]
    inversions = sum(a > b for a, b in combinations(places, 2))
    return -1 if inversions % 2 else 1


def _orientation(coordinates: Interval, points: tuple[int, ...]) -> int:
    """Return the sign of the determinant of q + 1 points, or 0 when in doubt."""
    chosen = coordinates[list(points)]
    edges = chosen[1:] - chosen[:1]
    return determinant(edges).sign()


def _mirrored(local: Interval, side: int) -> Interval:
    """Return the coordinates, the last one negated when `side` is -1."""
    if side > 0:
        return local
    low, high = np.array(local.lower), np.array(local.upper)
    low[:, -1], high[:, -1] = -local.upper[:, -1], -local.lower[:, -1]
    return Interval(low, high)


def _equal(a: Interval, b: Interval) -> bool:
    """Return whether two enclosures are the same."""
    return bool(np.array_equal(a.lower, b.lower) and np.array_equal(a.upper, b.upper))


def hang(positions: FloatArray, lower: FloatArray, upper: FloatArray) -> FloatArray:
    """
    Return positions with a place for each loose point, one after the other.

    A loose point has fewer than q bounded distances to those before it, so that it may be put
    anywhere on a circle or sphere; it is put on the far side of the fleet.

    Parameters
    ----------
    positions : numpy.ndarray, shape (m, q)
        Of the first m points.
    lower, upper : numpy.ndarray, shape (n, n)
        Squared distances in m^2 of all n points.

    Returns
    -------
    numpy.ndarray, shape (n, q)

    """
    for point in range(len(positions), len(lower)):
        hooks = np.flatnonzero(np.isfinite(upper[point, :point]))
        lengths = np.sqrt((lower[point, hooks] + upper[point, hooks]) / 2.0)
        outward = _unit_rows(positions[hooks[:1]] - positions.mean(axis=0))[0]
        if not outward.any():
            outward = np.eye(positions.shape[1])[0]
        place = positions[hooks[0]] + lengths[0] * outward
        if len(hooks) > 1:
            place = _on_two_spheres(positions[hooks[:2]], lengths[:2], outward)
        positions = np.vstack([positions, place])
    return positions


def _on_two_spheres(centres: FloatArray, radii: FloatArray, preferred: FloatArray) -> FloatArray:
    """Return a point that is on two spheres as nearly as can be, in the preferred direction."""
    gap = centres[1] - centres[0]
    distance = max(float(np.linalg.norm(gap)), 1e-12)
    axis = gap / distance
    along = (radii[0] ** 2 - radii[1] ** 2 + distance**2) / (2.0 * distance)
    along = float(np.clip(along, -radii[0], radii[0]))
    side = preferred - (preferred @ axis) * axis
    if np.linalg.norm(side) < 1e-6:
        side = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    side /= np.linalg.norm(side)
    return np.asarray(centres[0] + along * axis + math.sqrt(radii[0] ** 2 - along**2) * side)
