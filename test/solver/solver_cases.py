# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Problems whose truth is known exactly: random fleets on integers."""

from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from dg_localization import Chirality, Problem, Side, SideConstraint, SolverOptions, solve


def sign(number):
    return (number > 0) - (number < 0)


def determinant(rows):
    """Expand a determinant in the arithmetic of its entries, exactly for int and Fraction."""
    if not rows:
        return 1
    minors = ([row[:k] + row[k + 1 :] for row in rows[1:]] for k in range(len(rows)))
    terms = enumerate(zip(rows[0], minors, strict=True))
    return sum((-1) ** k * first * determinant(minor) for k, (first, minor) in terms)


def orientation(points):
    """Return the sign of det[p2 - p1, ..., p(q+1) - p1] for points of exact numbers."""
    origin, *others = points
    return sign(determinant([[x - o for x, o in zip(p, origin, strict=True)] for p in others]))


def squared_distances(positions):
    difference = positions[:, None] - positions[None]
    return (difference * difference).sum(axis=-1)


def exact_squared(positions, i, j):
    """Return the squared distance of two points in rational numbers."""
    ends = positions[[i, j]].tolist()
    return sum((Fraction(x) - Fraction(y)) ** 2 for x, y in zip(*ends, strict=True))


def bounds(n_points, ranges):
    """Return (lower, upper) where `ranges`, {(i, j): (low, high)} in m^2, is all that is known."""
    lower = np.zeros((n_points, n_points))
    upper = np.full((n_points, n_points), np.inf)
    np.fill_diagonal(upper, 0.0)
    for (i, j), (low, high) in ranges.items():
        lower[i, j] = lower[j, i] = low
        upper[i, j] = upper[j, i] = high
    return lower, upper


def problem_of(positions, measured, ranges=(), error=1e-9, **constraints):
    """Return the problem of measured pairs, and of others with their bounds in m^2."""
    squared = squared_distances(np.asarray(positions, dtype=float))
    known = {pair: (squared[pair] * (1 - error), squared[pair] * (1 + error)) for pair in measured}
    for pair, (low, high) in dict(ranges).items():
        least, most = known.get(pair, (0.0, np.inf))
        known[pair] = max(low, least), min(high, most)
    return Problem(*bounds(len(squared), known), len(positions[0]), **constraints)


def pairs_where(condition):
    """Return the pairs of which a symmetric matrix is true."""
    return [(i, j) for i, j in np.argwhere(np.triu(condition, 1)).tolist()]


def braced_grid(rows, columns, error, seed=0, holes=0.0):
    """Return a grid whose points measure the eight about them, and its placement."""
    rng = np.random.default_rng(seed)
    positions = np.stack(np.unravel_index(np.arange(rows * columns), (rows, columns)), axis=1)
    positions = 5.0 * positions + rng.uniform(-1.0, 1.0, positions.shape)
    squared = squared_distances(positions)
    ranges = {
        pair: (squared[pair] * (1 - error) ** 2, squared[pair] * (1 + error) ** 2)
        for pair in pairs_where(squared < 8.5**2)
        if rng.random() >= holes
    }
    return Problem(*bounds(len(positions), ranges)), positions


def box_of(lower, upper):
    """Return the solver's box of bounds, without gaps."""
    return np.stack([lower, upper, np.zeros_like(lower), np.zeros_like(lower)])


def is_in(hypothesis, squared, slack=0.0):
    """Tell whether squared distances lie in a box of a hypothesis."""
    low, high = squared - slack, squared + slack
    return any(((box[0] <= high) & (low <= box[1])).all() for box in hypothesis.boxes)


def covers(result, squared, slack=0.0):
    """Tell whether squared distances lie in a box of some hypothesis."""
    return any(is_in(hypothesis, squared, slack) for hypothesis in result.hypotheses)


def holding(hypotheses, squared, share=0.0):
    """Return the hypotheses whose bounds hold squared distances, up to a share of the largest."""
    slack = share * squared.max()
    low, high = squared - slack, squared + slack
    return [h for h in hypotheses if ((h.lower <= high) & (low <= h.upper)).all()]


def assert_same(result, other, scale=1.0):
    """
    Assert that two answers agree to the last bit, the other one of a fleet `scale` as large.

    Whether a placement is proved, and which one, may depend on the size of a fleet.
    """
    assert result.verdict is other.verdict and result.n_hypotheses == other.n_hypotheses
    counted = [replace(answer.statistics, seconds=0.0) for answer in (result, other)]
    assert counted[0] == counted[1]
    for piece, twin in zip(result.pieces, other.pieces, strict=True):
        for part, same in zip((piece, *piece.patches), (twin, *twin.patches), strict=True):
            assert part.points == same.points
            for h, g in zip(part.hypotheses, same.hypotheses, strict=True):
                assert np.array_equal(scale**2 * h.boxes, g.boxes)
                if scale == 1.0:
                    assert (h.proved, h.flexible) == (g.proved, g.flexible)
                    assert np.array_equal(h.positions, g.positions)


@dataclass(frozen=True)
class Case:
    """A problem, how to solve it, and the placement it was made from."""

    problem: Problem
    options: SolverOptions
    positions: np.ndarray

    @property
    def squared(self):
        return squared_distances(self.positions)

    def solve(self):
        return solve(self.problem, self.options)


class CancelAfter:
    """Is set after it was asked `most` times."""

    def __init__(self, most):
        self.left = most

    def is_set(self):
        self.left -= 1
        return self.left < 0


RESOLUTIONS = [1e-6, 1e-3, 1e-2, 0.1]
LARGE_EVERY = 200
"""How many problems there are for one with more points than a first sweep projects."""


def random_case(seed, max_points=9):
    """Return a random problem that its placement solves exactly, in floating point too."""
    rng = np.random.default_rng(seed)
    dimension = int(rng.choice([1, 2, 2, 2, 2, 2, 3]))
    most = min(max_points, 6) if dimension == 3 and rng.random() < 0.9 else max_points
    if seed % LARGE_EVERY == 0:
        most = 3 * max_points
    n_points = int(rng.integers(2, most + 1))
    # At the farthest, squared distances are exact but their sums are rounded.
    reaches = [1, 3, 10, 1000, 10**6, 27_000_000]
    positions = scattered(rng, n_points, dimension, reaches)
    sides, chiralities = known_orientations(rng, positions.tolist(), [0, 0, 1, 3, 10])
    positions = positions * 2.0 ** rng.choice([0, 0, 0, 3, -40, 40])
    squared = squared_distances(positions)
    problem = Problem(*_ranges(rng, squared), dimension, sides, chiralities)
    boxes, seconds = [1, 2, 5, 10, 10, 25], [0.0, 0.0, 0.0, np.inf, np.inf]
    options = drawn_options(rng, squared, RESOLUTIONS, boxes, seconds)
    return Case(problem, options, positions)


def scattered(rng, n_points, dimension, reaches, bodies=()):
    """Scatter points on integers, often with some of them together, or a body in a hyperplane."""
    reach = int(rng.choice(reaches))
    positions = rng.integers(-reach, reach + 1, size=(n_points, dimension))
    shape = rng.choice(['general', 'general', 'general', 'flat body', 'flat', 'line', 'together'])
    if shape == 'flat body':
        body = bodies[rng.integers(len(bodies))] if bodies else range(n_points)
        positions[body, -1] = positions[body[0], -1]
    elif shape == 'flat':
        positions[:, -1] = rng.integers(0, 2, n_points) * (rng.random() < 0.5)
    elif shape == 'line':
        steps = rng.integers(-5, 6, n_points)
        positions = positions[0] + np.outer(steps, rng.integers(-3, 4, dimension))
    elif shape == 'together':
        positions = positions[rng.integers(0, n_points, n_points)]
    return positions


def known_orientations(rng, positions, counts, bodies=()):
    """Return some sides and chiralities, half of them in bodies; flat simplices have either."""
    n_points, dimension = len(positions), len(positions[0])

    def known(*simplex):
        return orientation([positions[point] for point in simplex])

    def some(number):
        pool = range(n_points)
        if bodies:
            body = bodies[rng.integers(len(bodies))]
            pool = body if len(body) >= number and rng.random() < 0.5 else pool
        return [int(point) for point in rng.permutation(pool)[:number]]

    sides, chiralities = [], []
    for _ in range(rng.choice(counts) if n_points >= dimension + 2 else 0):
        *face, first, second = some(dimension + 2)
        side = -known(*face, first) * known(*face, second) or rng.choice([-1, 1])
        sides.append(SideConstraint(tuple(face), first, second, Side(int(side))))
    for _ in range(rng.choice(counts) if n_points >= dimension + 1 else 0):
        points = some(dimension + 1)
        chiralities.append(Chirality(tuple(points), int(known(*points) or rng.choice([-1, 1]))))
    return sides, chiralities


def symmetric(values):
    upper = np.triu(values, 1)
    return upper + upper.T


def bounds_around(rng, squared, widths, alike):
    """Return bounds around squared distances, off centre; `alike` is how often all are as wide."""
    width = rng.choice(widths, size=squared.shape)
    if rng.random() < alike:
        width[:] = width[0, 0]
    width, below = symmetric(width), symmetric(rng.random(squared.shape))
    # Rounding is monotone: neither product crosses the squared distance.
    return squared * (1.0 - width * below), squared * (1.0 + width * (1.0 - below))


def drawn_options(rng, squared, resolutions, max_boxes, tighten_seconds):
    """Draw how to solve a problem; resolutions are parts of its size."""
    size = max(float(np.sqrt(squared.max())), 1e-12)
    return SolverOptions(
        resolution=size * float(rng.choice(resolutions)),
        max_boxes=int(rng.choice(max_boxes)),
        tighten_seconds=float(rng.choice(tighten_seconds)),
    )


def _ranges(rng, squared):
    """Return bounds around squared distances: 0 to 10 % wide, some pairs unknown."""
    widths = [0, 1e-15, 1e-12, 1e-6, 1e-3, 0.01, 0.03, 0.1]
    lower, upper = bounds_around(rng, squared, widths, alike=0.5)
    missing = symmetric(rng.random(squared.shape) < rng.choice([0, 0.2, 0.4, 0.7]))
    return np.where(missing, 0.0, lower), np.where(missing, np.inf, upper)
