# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""The mutations: where, what is broken by which change, and the tests that should notice."""

from __future__ import annotations

from typing import NamedTuple


class Mutation(NamedTuple):
    """
    One break.

    Attributes
    ----------
    path : str
        The file, from the root of the repository.
    what : str
        What is broken, in a few words.
    old, new : str
        Text that occurs once in the file, and what takes its place.
    tests : tuple of str
        The fastest tests that should notice.

    """

    path: str
    what: str
    old: str
    new: str
    tests: tuple[str, ...]

    @property
    def name(self) -> str:
        """The file and what is broken."""
        return f'{self.path}: {self.what}'


def _in(
    package: str, module: str, tests: tuple[str, ...], *breaks: tuple[str, str, str]
) -> list[Mutation]:
    """Return the mutations of one file."""
    path = f'dg_localization/{package}/{module}.py'
    return [Mutation(path, *parts, tests) for parts in breaks]


INTERVAL = [
    *_in(
        'interval',
        'rounding',
        ('test/interval/test_rounding.py',),
        (
            'upper bounds are not rounded up',
            'return x + (abs(x) * UNIT + TINIEST)',
            'return x',
        ),
        (
            'the step down forgets the tiniest numbers',
            'return x - (abs(x) * UNIT + TINIEST)',
            'return x - abs(x) * UNIT',
        ),
        (
            'an overflow below stays minus infinity as an upper bound',
            'x = max(x, -LARGEST)\n    ',
            '',
        ),
    ),
    *_in(
        'interval',
        'scalars',
        ('test/interval/test_rounding.py',),
        (
            'the square forgets that zero lies within',
            'smallest = max(0.0, low, -high)',
            'smallest = min(abs(low), abs(high))',
        ),
        (
            'the root has no negative branch',
            'return hull(minus_low, minus_high, plus_low, plus_high)',
            'return plus_low, plus_high',
        ),
        (
            'a product forgets one corner',
            '        _times(a_low, b_high),\n',
            '',
        ),
    ),
    *_in(
        'interval',
        'angles',
        ('test/interval/test_arrays.py',),
        (
            'the maximum of the cosine within an interval is forgotten',
            'np.where(top, 1.0, np.minimum(high, 1.0))',
            'np.minimum(high, 1.0)',
        ),
        (
            'the minimum of the cosine within an interval is forgotten',
            'np.where(bottom, -1.0, np.maximum(low, -1.0))',
            'np.maximum(low, -1.0)',
        ),
    ),
    *_in(
        'interval',
        'bounds',
        ('test/interval/test_rounding.py',),
        (
            'stamps count as exact',
            'step_up(step_up(abs(first_s - second_s)) + unit_s)',
            'abs(first_s - second_s)',
        ),
    ),
]

HUNT = 'test/solver/test_never_loses.py'
PROJECTION = ('test/solver/test_projection.py', HUNT)
LINE = ('test/solver/test_projection.py', 'test/solver/test_sides.py', HUNT)

CONTRACT = [
    *_in(
        'solver',
        'contract/line',
        LINE,
        (
            'the near branch forgets that either may be the longer one',
            'up(max(ij[1] - jk[0], jk[1] - ij[0]))',
            'up(ij[1] - jk[0])',
        ),
        (
            'the far branch on the line ends too soon',
            'far = down(ij[0] + jk[0]), up(ij[1] + jk[1])',
            'far = down(ij[0] + jk[0]), up(ij[0] + jk[1])',
        ),
        (
            'the far branch beyond a gap is forgotten',
            'last_low, last_high = max(gap_high, far_low), min(high, far_high)',
            'last_low, last_high = math.inf, -math.inf',
        ),
        (
            'the middle part is only that of the far branch',
            'middle_low, middle_high = max(gap_high, near_low), min(high, near_high)',
            'pass',
        ),
        (
            'the ends of a gap are not rounded on the way to the line',
            'gap_low = sqrt_up(box[GAP_LOWER, x, y])\n'
            '                gap_high = sqrt_down(box[GAP_UPPER, x, y])',
            'gap_low = math.sqrt(box[GAP_LOWER, x, y])\n'
            '                gap_high = math.sqrt(box[GAP_UPPER, x, y])',
        ),
        (
            'the ends of a gap are not rounded on the way back',
            'gap_low = square_up(distance[GAP_LOWER, x, y])\n'
            '                gap_high = square_down(distance[GAP_UPPER, x, y])',
            'gap_low = distance[GAP_LOWER, x, y] ** 2\n'
            '                gap_high = distance[GAP_UPPER, x, y] ** 2',
        ),
        (
            'same and opposite sides are exchanged',
            '    if side < 0:\n        return max(0.0, down(j_low - jk_high))',
            '    if side > 0:\n        return max(0.0, down(j_low - jk_high))',
        ),
        (
            'the wrong branch is dropped by a known side',
            'elif side > 0:\n            near_low',
            'elif side < 0:\n            near_low',
        ),
        (
            'sides are looked up by the rows of points, not by the points',
            'triple = points[x], points[z], points[y]',
            'triple = x, z, y',
        ),
    ),
    *_in(
        'solver',
        'contract/axis_bounds',
        PROJECTION,
        (
            'the minimum of the coordinate within the axis is forgotten',
            'low = sqrt_down(low_difference)\n',
            'low = -_coordinate_up(-low_difference, d_lower, -0.5 * d_lower)\n',
        ),
        (
            'the maximum of the coordinate at the short axis is forgotten',
            'high = max(high, _coordinate_up(high_difference, d_lower, 0.5 * d_lower))',
            'high = max(high, _coordinate_up(high_difference, d_upper, 0.5 * d_upper))',
        ),
        (
            'the extremum of the height at a right angle is forgotten',
            'if right_at_a | right_at_b:',
            'if right_at_a:',
        ),
        (
            'the height is not concave: one corner is enough',
            'low = min(low_1, low_2, low_3, low_4)',
            'low = min(low_1, low_3)',
        ),
        (
            'a difference takes the wrong end of the axis',
            '(d_lower if high > 0.0 else d_upper)',
            '(d_upper if high > 0.0 else d_lower)',
        ),
    ),
    *_in(
        'solver',
        'contract/projection',
        PROJECTION,
        (
            'the projected distance takes the least part along the axis for its lower bound',
            'square_high = square_up(max(-along_lower[y], along_upper[y]))',
            'square_high = square_up(min(-along_lower[y], along_upper[y]))',
        ),
        (
            'a gap is projected without the spread along the axis',
            'gap_high = down(box[GAP_UPPER, i, j] - square_high)',
            'gap_high = down(box[GAP_UPPER, i, j] - square_low)',
        ),
    ),
    *_in(
        'solver',
        'contract/back_projection',
        PROJECTION,
        (
            'the minimum of the far distance within the axis is forgotten',
            'd = min(max(t_upper, d_lower), d_upper)',
            'd = d_lower',
        ),
        (
            'the axis: between both branches the wrong end of the coordinate',
            'minus_high = up(t_upper - u_least)',
            'minus_high = up(t_lower - u_least)',
        ),
        (
            'a coordinate is narrowed by the wrong end of the difference',
            'down(ends[T_LOWER, x] - high)',
            'down(ends[T_LOWER, x] - low)',
        ),
        (
            'a gap of the height is carried over without the coordinate',
            'up(height_gap[0] + square[1])',
            'up(height_gap[0] + square[0])',
        ),
        (
            'the ends of a gap of a pair are not rounded',
            'gap_low = up(across[GAP_LOWER, x, y] + square_high)\n'
            '        gap_high = down(across[GAP_UPPER, x, y] + square_low)',
            'gap_low = across[GAP_LOWER, x, y] + square_high\n'
            '        gap_high = across[GAP_UPPER, x, y] + square_low',
        ),
    ),
    *_in(
        'solver',
        'contract/triangles',
        ('test/solver/test_triangles.py',),
        (
            'the triangle inequality takes two lower bounds',
            'down(distance[LOWER, i, j] - distance[UPPER, j, k])',
            'down(distance[LOWER, i, j] - distance[LOWER, j, k])',
        ),
        (
            'the way through a third point is too short by its lower bound',
            'through = up(ij_high + distance[UPPER, j, k])',
            'through = up(ij_high + distance[LOWER, j, k])',
        ),
    ),
    *_in(
        'solver',
        'contract/triangles',
        ('test/solver/test_triangles.py',),
        (
            'the minimum opposite an angle within an edge is forgotten',
            'y = min(max(x * high_cosine, sides[free, 0]), sides[free, 1])',
            'y = sides[free, 0]',
        ),
        (
            'the side at an obtuse angle takes the wrong end',
            '(d_lower_m if low_cosine >= 0.0 else d_upper_m) * low_cosine',
            '(d_upper_m if low_cosine >= 0.0 else d_lower_m) * low_cosine',
        ),
    ),
    *_in(
        'solver',
        'contract/coordinates',
        (f'{HUNT}::test_no_truth_is_lost_where_pieces_in_space_are_placed_point_by_point',),
        (
            'the least distance cuts off what lies on the far side',
            'if left < new_low and new_low < right:',
            'if new_low < right:',
        ),
        (
            'the other axes contribute nothing to the least distance',
            'nearest = sqrt_down(down(s_lower_m2 - most))',
            'nearest = sqrt_down(down(s_lower_m2 - least))',
        ),
    ),
    *_in(
        'solver',
        'contract/linearization',
        ('test/solver/test_linearization.py',),
        (
            'the square of the displacement is left out of the residual',
            'down(down(box[LOWER, i, j] - at_reference_m2) - high)',
            'down(box[LOWER, i, j] - at_reference_m2)',
        ),
        (
            'a negative multiplier takes the end of a positive one',
            'low += min(at_lower, at_upper)',
            'low += at_lower',
        ),
        (
            'what the combination leaves over is ignored',
            'return down(low - slack), up(high + slack)',
            'return low, high',
        ),
    ),
    *_in(
        'solver',
        'contract/sides',
        ('test/solver/test_sides.py', 'test/solver/test_result.py'),
        (
            'two chiralities of unequal sign count as equal',
            'if known.sign == chiralities[0].sign else',
            'if known.sign != chiralities[0].sign else',
        ),
    ),
]

BOX = ('test/solver/test_box.py',)
SEARCH = (
    'test/solver/test_result.py::test_what_stops_a_search_leaves_a_complete_cover',
    'test/solver/test_extreme_sizes.py::test_looks_within_one_box',
)

SEARCHING = [
    *_in(
        'solver/patches',
        'answers',
        ('test/solver/test_patches.py',),
        (
            'a placement outside the boxes of the call is proved',
            '[np.array(bounds) for bounds in self._within]',
            'None',
        ),
    ),
    *_in(
        'solver/place',
        'existence',
        ('test/solver/test_result.py',),
        (
            'a placement of another hypothesis is proved',
            'return positions, boxes is None or any(lies_in(box, positions) for box in boxes)',
            'return positions, True',
        ),
    ),
    *_in(
        'solver/place',
        'existence',
        ('test/solver/test_existence.py::test_every_equation_of_a_proof_counts',),
        (
            'of the equations of a proof only the first ones are looked at',
            'for first in range(0, n_pairs, at_once):',
            'for first in range(0, 1, at_once):',
        ),
    ),
    *_in(
        'solver/place',
        'hypotheses',
        ('test/solver/test_stopped_early.py::test_what_was_not_examined_counts_as_flexible',),
        (
            'what was not examined counts as rigid',
            'may_move = None if is_open else partial(_may_move, problem)',
            'may_move = partial(_may_move, problem)',
        ),
    ),
    *_in(
        'solver',
        'box',
        BOX,
        (
            'the part above a cut starts at its lower end',
            'above[LOWER, [i, j], [j, i]] = high_start',
            'above[LOWER, [i, j], [j, i]] = high_start + (high_start - low_end)',
        ),
        (
            'two gaps that do not touch are joined',
            'if gap_low < known_high and known_low < gap_high:',
            'if True:',
        ),
        (
            'a gap that reaches over the lower end takes the upper one along',
            'return narrow(box, i, j, gap_high, high) if gap_high > low else True',
            'return narrow(box, i, j, gap_high, gap_high) if gap_high > low else True',
        ),
    ),
    *_in(
        'interval',
        'pave',
        SEARCH,
        (
            'what the budget left open is not reported',
            'paving.pending = [box for *_, box in sorted(waiting)]',
            'paving.pending = []',
        ),
    ),
    *_in(
        'solver',
        'search/search',
        SEARCH,
        (
            'only the first part of a split is examined',
            'Examined(parts=parts) if parts',
            'Examined(parts=parts[:1]) if parts',
        ),
        (
            'an unfinished box is dropped',
            'return Examined(rest=[pruned.box])',
            'return Examined()',
        ),
    ),
    *_in(
        'solver',
        'search/search',
        ('test/solver/test_result.py',),
        (
            'a box is tightened when its time is over',
            'if stopped():\n        return box',
            'if False:\n        return box',
        ),
    ),
    *_in(
        'solver',
        'contract/fixed_point',
        (
            'test/solver/test_result.py::test_three_points_on_a_line_are_told_apart',
            'test/solver/test_never_loses.py',
        ),
        (
            'three points on a line count as convex',
            'most_points = 2 if problem.dimension == 1 else 3',
            'most_points = 3',
        ),
    ),
    *_in(
        'solver',
        'assemble/pieces',
        ('test/solver/test_patches.py',),
        (
            'patches that were not examined take the boxes of other pieces',
            'budget.go_on_from(solved.n_boxes() - solved.n_pending())',
            'budget.go_on_from(solved.n_boxes())',
        ),
    ),
    *_in(
        'solver',
        'assemble/solved_pieces',
        ('test/solver/test_stopped_early.py',),
        ('what was not examined counts as examined', 'return 1, 1', 'return 1, 0'),
    ),
    *_in(
        'solver',
        'assemble/solved_pieces',
        ('test/solver/test_pieces.py',),
        (
            'what was not examined beside patches counts as examined',
            'n_pending = len(keys) + sum(',
            'n_pending = sum(',
        ),
    ),
    *_in(
        'solver',
        'assemble/pieces',
        ('test/solver/test_stopped_early.py',),
        (
            'the points of pieces that were not begun are left out',
            'if not_begun:',
            'if not self._solved:',
        ),
    ),
    *_in(
        'solver',
        'place/hypotheses',
        ('test/solver/test_stopped_early.py',),
        (
            'points that nothing is known of count as rigid',
            'return self._may_move is None or',
            'return self._may_move is not None and',
        ),
    ),
    *_in(
        'solver',
        'assemble/combinations',
        ('test/solver/test_pieces.py', 'test/solver/test_counts.py'),
        (
            'only one side of a reflection is tried',
            'EITHER = (Side.SAME, Side.OPPOSITE)',
            'EITHER = (Side.SAME,)',
        ),
    ),
]

MODELS = ('test/fleet/test_fleet_config.py',)
MOMENTS = ('test/fleet/test_histories.py::test_no_truth_of_a_moment_is_lost',)

FLEET = [
    *_in(
        'fleet',
        'error_models',
        MODELS,
        (
            'the bounds of the error are exchanged',
            'max(0.0, sum_down(range_m, -high_m)), sum_up(range_m, -low_m)',
            'max(0.0, sum_down(range_m, low_m)), sum_up(range_m, high_m)',
        ),
        (
            'nothing in range proves a distance',
            'if model.beyond_max_is_far and math.isfinite(maximum):',
            'if math.isfinite(maximum):',
        ),
        (
            'the reported deviation narrows',
            'product_down(share, range_m), -spread_m)',
            'product_down(share, range_m), spread_m)',
        ),
    ),
    *_in(
        'fleet',
        'snapshot',
        ('test/fleet/test_fleet_inputs.py', 'test/fleet/test_odometry.py'),
        (
            'lower bounds do not age',
            'lower_m = max(lower_m, sum_down(reading.lower_m, -moved_m))',
            'lower_m = max(lower_m, reading.lower_m)',
        ),
        (
            'only the observer moves',
            'return sum_up(*moves_m) if any(moves_m) else 0.0',
            'return moves_m[0]',
        ),
    ),
    *_in(
        'fleet',
        'localizer',
        ('test/fleet/test_window.py',),
        (
            'answers are for a time beyond the odometry',
            'before_s = min([now_s, *known_s])',
            'before_s = now_s',
        ),
    ),
    *_in(
        'fleet',
        'localizer',
        (
            'test/fleet/test_histories.py::test_an_estimate_that_was_overtaken_changes_nothing',
            'test/fleet/test_histories.py'
            '::test_the_estimate_of_a_snapshot_from_before_a_reset_changes_nothing',
        ),
        (
            'an estimate that was overtaken changes what later ones know',
            'if self._newest is follower:',
            'if True:',
        ),
        (
            'an estimate goes on although a reset came after its snapshot',
            'if snapshot.number < self._first:',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'frames/finders',
        ('test/fleet/test_window.py',),
        (
            'a point may be that of another hypothesis',
            'not (best.proved or _within(among, best.positions_m))',
            'False',
        ),
    ),
    *_in(
        'fleet',
        'motion',
        ('test/fleet/test_fleet_inputs.py::test_odometry_says_how_far_a_robot_really_moved',),
        (
            'constant errors of odometry make no way longer as the track turns',
            'error_m = sum_up(error_m, product_up(swing_rad, error.constant_m))',
            'error_m = sum_up(error_m)',
        ),
    ),
    *_in(
        'fleet',
        'motion',
        ('test/fleet/test_odometry.py',),
        (
            'odometry counts as exact',
            'error_m = greatest_errors(error, way_m, turned_rad)[0]',
            'error_m = 0.0',
        ),
        (
            'the time before the first odometry is forgotten',
            '        elapsed_up(start.stamp_s, first_s),\n',
            '',
        ),
        (
            'a turn is taken the wrong way round',
            'return after.T @ before, error_rad',
            'return before.T @ after, error_rad',
        ),
        (
            'the heading of a body that pitches turns no more than the body',
            'if self._in_plane:',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'motion',
        ('test/fleet/test_constraints.py',),
        (
            'pitch bends the rays of the plane',
            'if config.dimension == 2:',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'error_models',
        ('test/fleet/test_fleet_config.py',),
        (
            'the projection of a steep ray errs no more than the ray',
            'quotient_up(angle_up(math.sin(half_width_rad)), horizontal)',
            'quotient_up(angle_up(math.sin(half_width_rad)), 1.0)',
        ),
    ),
    *_in(
        'fleet',
        'window/carry',
        ('test/fleet/test_mounts.py',),
        (
            'what sensors measure is trusted although readings may be wrong',
            'return WORLD if robot == point else None\n',
            'return WORLD if robot == point else None\n'
            '        if robot != point and config.window_outliers:\n'
            '            return None\n',
        ),
    ),
    *_in(
        'fleet',
        'snapshot',
        ('test/fleet/test_mounts.py',),
        (
            'parked robots do not turn',
            'if point not in mounts.reach_m:',
            'if point not in mounts.reach_m or config.robot_of(point) in config.anchors:',
        ),
    ),
    *_in(
        'fleet',
        'elevations',
        ('test/fleet/test_other_measures.py',),
        (
            'robots that climb stay at the elevation that was read',
            'climb_m = most_between(speed_m_s, *times_s)',
            'climb_m = 0.0',
        ),
        (
            'elevations that were read long ago count',
            'if is_young(config, reading.stamp_s, now_s):',
            'if True:',
        ),
        (
            'what was read before a contradiction counts',
            '            readings.clear()\n',
            '',
        ),
        (
            'the upper bound of an elevation takes the greatest error, not the least',
            'sum_up(elevation_m, -error.min_error_m)',
            'sum_up(elevation_m, -error.max_error_m)',
        ),
        (
            'a distance in the plane is shorter by the greatest rise, not the least',
            's_upper_m2 = sum_up(s_upper_m2, -rise_m2[0])',
            's_upper_m2 = sum_up(s_upper_m2, -rise_m2[1])',
        ),
    ),
    *_in(
        'fleet',
        'window/pose_sets',
        ('test/fleet/test_window.py',),
        (
            'what a robot in doubt measured of others counts',
            'in_doubt |= {pair[1]} if pair[0] == WORLD else set()',
            'in_doubt |= set()',
        ),
    ),
    *_in(
        'fleet',
        'snapshot',
        ('test/fleet/test_window.py',),
        (
            'what contradicts the memory counts at the moment',
            'return key.ends not in left_out and key.ends[::-1] not in left_out',
            'return True',
        ),
    ),
    *_in(
        'fleet',
        'window/forgetting',
        (
            'test/fleet/test_window.py::test_measurements_that_agree_again_end_a_doubt',
            'test/fleet/test_window.py'
            '::test_a_robot_that_was_carried_away_is_forgotten_and_found_again',
        ),
        (
            'one measurement that agrees ends a doubt',
            'if newer < CONFIRMING or not tried:',
            'if newer < 1 or not tried:',
        ),
        (
            'a doubt lasts for ever',
            'if agreed_s >= now_s or now_s - doubt.since_s > LONGEST_DOUBT_S:',
            'if agreed_s >= now_s:',
        ),
    ),
    *_in(
        'fleet',
        'window/carry',
        ('test/fleet/test_histories.py::test_no_pose_is_lost_by_rays_of_tilted_cameras',),
        (
            'rays of a robot that is tilted count as level',
            'return self.path(robot).leveled_rays(seen.stamps_s, seen.rays, seen.errors_rad)',
            'return seen.rays, seen.errors_rad',
        ),
    ),
    *_in(
        'ros/node',
        'clock',
        ('test/ros/test_node_parts.py',),
        (
            'what has waited looks new',
            'return self._last_s if self._is_simulated else self._last_s - waited_s',
            'return self._last_s',
        ),
        (
            'what arrived before a jump back of the clock looks new',
            'if self._steady_s() - waited_s < self._begun_at_s:',
            'if False:',
        ),
        (
            'a clock that was set back by less than since the last call goes on',
            'if back_s == 0.0 and missing_s > LEAST_SET_BACK_S and not self._is_simulated:',
            'if False:',
        ),
    ),
    *_in(
        'ros/node',
        'localizer',
        (
            'test/ros/test_localizer_node.py'
            '::test_answer_that_ends_after_the_clock_went_back_is_not_published',
        ),
        (
            'an answer that ends after the clock went back is published',
            'self._now_s()\n        took_s',
            'took_s',
        ),
    ),
    *_in(
        'ros/node',
        'localizer',
        ('test/ros/test_localizer_node.py::test_what_waits_at_a_reset_does_not_count_after_it',),
        (
            'what arrived before a reset counts after it',
            'self._inputs.drop_waiting()',
            'pass',
        ),
    ),
    *_in(
        'ros',
        'interface/links',
        ('test/ros/test_parameters.py::test_links_have_bounds_and_stamps_of_their_own',),
        (
            'the ranges of peers have the bounds of all',
            'if name in self.overrides:',
            'if name in self.overrides and self.key.kind is not LinkKind.PEERS:',
        ),
    ),
    *_in(
        'fleet',
        'constraints/rays',
        ('test/fleet/test_constraints.py', *MOMENTS),
        (
            'the turn of a line by a displacement is halved',
            'return arcsine_up(quotient_up(displacement_m, d_lower_m))',
            'return 0.5 * arcsine_up(quotient_up(displacement_m, d_lower_m))',
        ),
        (
            'the angle of two rays has the error of one',
            'np.array([a.half_width_rad + b.half_width_rad for a, b in chosen])',
            'np.array([a.half_width_rad for a, b in chosen])',
        ),
    ),
    *_in(
        'fleet',
        'constraints/distances',
        ('test/fleet/test_constraints.py',),
        (
            'the law of sines takes the other angle',
            'sine_b_low, sine_b_high = sine_bounds(*at_b)',
            'sine_b_low, sine_b_high = sine_bounds(*at_a)',
        ),
        (
            'the maximum of the sine is forgotten in triangulation',
            'sine_c_low, sine_c_high = sine_bounds(min(low_sum, math.pi), high_sum)',
            'sine_c_low, sine_c_high = sorted(map(math.sin, (min(low_sum, math.pi), high_sum)))',
        ),
    ),
    *_in(
        'fleet',
        'constraints/rays',
        ('test/fleet/test_constraints.py', *MOMENTS),
        (
            'a sign counts although it is in doubt',
            '(self.half_widths_rad < low) & (high < math.pi)',
            'self.half_widths_rad < low',
        ),
        (
            'left and right are exchanged',
            'sign = 1 if self.angles_rad[row] > 0.0 else -1',
            'sign = -1 if self.angles_rad[row] > 0.0 else 1',
        ),
        (
            'in space the error of the third ray is forgotten',
            '\n        + 2.0 * math.sin(e_w / 2.0) * _greatest_sine(uv, e_u + e_v)',
            '',
        ),
        (
            'the greatest sine at a right angle is forgotten',
            'if abs(angle_rad - math.pi / 2) <= half_width_rad:',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'constraints/rays',
        ('test/fleet/test_constraints.py',),
        (
            'an angle is at least what was seen',
            'np.maximum(sizes - widths, 0.0)',
            'sizes',
        ),
    ),
    *_in(
        'fleet',
        'rotations',
        MOMENTS,
        (
            'the half width of a heading leaves out one side',
            'angle_up(half_rad + abs(off_rad))',
            'angle_up(half_rad - abs(off_rad))',
        ),
    ),
    *_in(
        'fleet',
        'frames/headings',
        MOMENTS,
        (
            'the spread of the directions is forgotten in a heading',
            'widths = angle_up(spreads + np.array([ray.half_width_rad for ray in rays]))',
            'widths = angle_up(np.array([ray.half_width_rad for ray in rays]))',
        ),
        (
            'in space the lever of two rays is too long',
            'np.minimum(np.sin(alphas / 2.0), np.cos(alphas / 2.0))',
            'np.sin(alphas / 2.0)',
        ),
    ),
    *_in(
        'fleet',
        'frames/enclosure',
        MOMENTS,
        (
            'only one box of a hypothesis is enclosed',
            'found.append((image, reduce(Interval.hull, enclosures)))',
            'found.append((image, enclosures[-1]))',
        ),
    ),
    *_in(
        'fleet',
        'frames/odometry_frame',
        ('test/fleet/test_frames.py',),
        (
            'the turn since the newest odometry is forgotten',
            'float(placement.heading_half_width_rad[row]) + pose.error_rad',
            'float(placement.heading_half_width_rad[row])',
        ),
        (
            'the way since the newest odometry is forgotten',
            'Interval.around(pose.position_m[None, :], pose.error_m)',
            'Interval.around(pose.position_m[None, :], 0.0)',
        ),
        (
            'in its odometry frame a robot is where it was at the stamp of its odometry',
            'sum_up(moved_m, product_up(config.speed_m_s(robot), latency_s))',
            'moved_m',
        ),
        (
            'headings in the odometry frame are as sharp as those in the body frame',
            'angle_up(placement.heading_half_width_rad + turn.half_width_rad)',
            'angle_up(placement.heading_half_width_rad)',
        ),
    ),
    *_in(
        'fleet',
        'frames/odometry_frame',
        ('test/fleet/test_frames.py',),
        (
            'a frame that was left is taken up again at once',
            'self._wait_s = HOLD_S',
            'self._wait_s = 0.0',
        ),
    ),
    *_in(
        'fleet',
        'frames/registration',
        ('test/fleet/test_frames.py',),
        (
            'the heading of the frame counts as exact',
            'rotation_2d(math.atan2(y, x), chosen[0].half_width_rad)',
            'rotation_2d(math.atan2(y, x), 0.0)',
        ),
    ),
    *_in(
        'fleet',
        'admission',
        ('test/fleet/test_fleet_inputs.py',),
        (
            'measurements never become too old',
            'return -config.max_future_s <= now_s - stamp_s <= config.max_age_s',
            'return -config.max_future_s <= now_s - stamp_s',
        ),
    ),
    *_in(
        'fleet',
        'config',
        (
            'test/ros/test_parameters.py'
            '::test_a_robot_and_an_anchor_have_values_of_their_own_or_the_common_ones',
        ),
        (
            'the odometry of a robot errs as that of all does',
            'error = self.robot_odometry_error.get(robot, self.odometry_error)',
            'error = self.odometry_error',
        ),
    ),
    *_in(
        'fleet',
        'odometry_error',
        ('test/fleet/test_window.py',),
        (
            'the scale of odometry is ignored',
            'np.asarray(self.translation_scale * position_m)',
            'np.asarray(position_m)',
        ),
    ),
    *_in(
        'fleet',
        'odometry_error',
        ('test/fleet/test_odometry.py',),
        (
            'the drift of odometry is halved',
            'of_way_m = most_up(error.translation_per_m, lengths_m)',
            'of_way_m = 0.5 * most_up(error.translation_per_m, lengths_m)',
        ),
        (
            'constant errors of odometry do not turn with the track',
            'return up(way_m + most_up(error.centered_m, turn_rad)), turn_rad',
            'return way_m, turn_rad',
        ),
    ),
    *_in(
        'fleet',
        'odometry',
        ('test/fleet/test_odometry.py',),
        (
            'headings err by half of their constant on tracks',
            'up(near.offset_rad + self._error.constant_rad)',
            'up(near.offset_rad + 0.5 * self._error.constant_rad)',
        ),
        (
            'in the plane what a robot rises is no way on which its odometry errs',
            'self._rotations = rotations_about_z(self._yaws_rad)',
            'self._positions_m[:, 2] = 0.0',
        ),
    ),
    *_in(
        'fleet',
        'rotations',
        ('test/fleet/test_odometry.py',),
        (
            'the yaw of a steep body changes no faster than the body turns',
            'return np.where(below, up(1.0 / cosines), UNBOUNDED)',
            'return np.ones(len(below))',
        ),
    ),
    *_in(
        'fleet',
        'odometry',
        ('test/fleet/test_odometry.py',),
        (
            'beyond the last sample a robot stands still',
            'return np.where(by_limit, limited, np.minimum(spans, limited))',
            'return np.minimum(spans, limited)',
        ),
        (
            'the latency of the odometry is ignored',
            'reach_s = up(elapsed_up(times_s, stamps_s[index]) + latency_s)',
            'reach_s = elapsed_up(times_s, stamps_s[index])',
        ),
    ),
    *_in(
        'fleet',
        'odometry_kernels',
        ('test/fleet/test_odometry.py',),
        (
            'between two samples a robot is as near as the nearer one',
            'span = up(min(before[kind], after[kind]) + step[kind])',
            'span = min(before[kind], after[kind])',
        ),
        (
            'between two samples a robot does not err',
            'up(off_m + steps[0, sample]), up(off_rad + steps[1, sample])',
            '0.0, 0.0',
        ),
        (
            'where samples are missing the robot is between its neighbours',
            'missing = missing or steps[2, sample] > 0.0',
            'missing = False',
        ),
    ),
    *_in(
        'fleet',
        'odometry',
        ('test/fleet/test_odometry.py',),
        (
            'where samples are missing the way is straight',
            'np.maximum(lengths, most_up(self._limits.speed_m_s, missing_s))',
            'lengths',
        ),
    ),
    *_in(
        'fleet',
        'odometry',
        ('test/fleet/test_odometry.py',),
        (
            'where samples are missing an error of a turn swings nothing',
            'up(errors_m + swings_m)',
            'errors_m',
        ),
    ),
    *_in(
        'fleet',
        'motion',
        ('test/fleet/test_odometry.py',),
        (
            'where odometry is missing the robot goes straight',
            'return max(step_m, by_speed_m), max(turn_rad, by_rate_rad)',
            'return step_m, turn_rad',
        ),
    ),
    *_in(
        'fleet/window',
        'carry',
        ('test/fleet/test_mounts.py',),
        (
            'remembered sensors are at the center of their robots',
            'return poses.points_now(arms_m)',
            'return poses.position_m',
        ),
    ),
    *_in(
        'fleet/window',
        'forgetting',
        ('test/fleet/test_histories.py::test_after_a_broken_bound_the_window_recovers[2-3-2-1]',),
        (
            'what sensors measured is not forgotten',
            'return frozenset(product(config.points_on(body), theirs))',
            'return frozenset(product([body], others))',
        ),
    ),
    *_in(
        'fleet',
        'config',
        ('test/fleet/test_broken_settings.py',),
        (
            'stamps of odometry are right',
            'replace(error, latency_s=latency_s) if self.stamp_error_s else error',
            'error',
        ),
    ),
    *_in(
        'fleet',
        'checks',
        ('test/fleet/test_fleet_config.py',),
        (
            'a bound that no double holds is rounded',
            'return number if number == exact else math.nan',
            'return number',
        ),
        (
            'bounds of single precision are reckoned with in single precision',
            'or not finite):\n        return number',
            'or not finite):\n        return value',
        ),
    ),
    *_in(
        'fleet',
        'constraints/rays',
        ('test/fleet/test_broken_settings.py',),
        (
            'equal stamps of a robot and of an answer are one time',
            'replace(ray, half_width_rad=sum_up(ray.half_width_rad, error_rad))',
            'ray',
        ),
    ),
    *_in(
        'fleet',
        'contradictions/explanation',
        (
            'test/fleet/test_contradictions.py::test_settings_that_contradict_each_other_are_no_fault_of_measurements',
        ),
        (
            'measurements are blamed for the settings',
            'if frozenset() in explanation.conflicts:',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'best_point/best_point',
        (
            'test/fleet/test_best_point.py::test_robots_that_hardly_anything_ties_to_the_rest_have_points',
        ),
        (
            'a covariance is made of rounding errors',
            'np.where(values > spread / MOST_SPREAD, values, 1.0)',
            'np.abs(values)',
        ),
    ),
    *_in(
        'fleet',
        'answers',
        ('test/fleet/test_frames.py',),
        (
            'what a limit left open in a group counts as covered',
            'Answer(worst_of(verdicts), statistics',
            'Answer(found.verdict, statistics',
        ),
    ),
    *_in(
        'fleet',
        'motion',
        ('test/fleet/test_broken_settings.py',),
        (
            'stamps of readings are right',
            'sum_up(elapsed_s, more_s) if more_s else elapsed_s',
            'elapsed_s',
        ),
    ),
    *_in(
        'fleet/window',
        'recollection',
        ('test/fleet/test_contradictions.py',),
        (
            'the first readings of a fleet are trusted where some may be wrong',
            'return Recollection(snapshot, budget, clock, pose_sets=pose_sets, replaced=replaced)',
            'return Recollection(snapshot, budget, clock, pose_sets=pose_sets)',
        ),
    ),
    *_in(
        'fleet/window',
        'carry',
        ('test/fleet/test_contradictions.py',),
        (
            'the first readings of a pair are trusted where some may be wrong',
            'if self._pair_of(*key.ends) is not None)',
            'if self._pair_of(*key.ends) in self._rows)',
        ),
    ),
    *_in(
        'fleet/window',
        'recollection',
        ('test/fleet/test_window.py',),
        (
            'what rests on all of the memory is carried on',
            'if recalled.pose_sets.of_whole_memory:',
            'if False:',
        ),
        (
            'placements that are not listed are impossible',
            'if any(len(part.placements) < part.n_hypotheses for part in emptied):',
            'if False:',
        ),
    ),
    *_in(
        'fleet',
        'estimation',
        ('test/fleet/test_window.py',),
        (
            'a memory that contradicts itself contradicts the moment',
            'if found.verdict is Verdict.INFEASIBLE and recalled.pose_sets.sets:',
            'if found.verdict is Verdict.INFEASIBLE and recalled.pose_sets.covers:',
        ),
    ),
]

CUTS = ('test/poses/test_cuts.py',)
NEVER = ('test/poses/test_covers.py',)

PAIRS = [
    *_in(
        'poses',
        'half_spaces',
        CUTS,
        (
            'the second order of a turn is forgotten',
            'return half_yaw * half_yaw * (0.5 * max(value, 0.0) + abs(slope) * half_yaw / 6.0)',
            'return 0.0',
        ),
        (
            'the wrong face of a box is cut',
            'if slope > 0.0:',
            'if slope < 0.0:',
        ),
    ),
    *_in(
        'poses',
        'cuts',
        CUTS,
        (
            'the nearest distance is not shortened by the errors',
            'least = sqrt_down(down(square_down(nearest) - square_up(stray)))',
            'least = nearest',
        ),
        (
            'a range difference is that of the center of a box',
            'most - along + below + bent_reference,',
            'most - along + below,',
        ),
        (
            'a range difference is not turned with the reference',
            'slope_far = uy * w[turned_target] - ux * w[turned_target + 1] - vy * x + vx * y',
            'slope_far = uy * w[turned_target] - ux * w[turned_target + 1]',
        ),
    ),
    *_in(
        'poses',
        'differences',
        ('test/poses/test_covers.py::test_no_truth_is_lost_by_range_differences_alone',),
        (
            'nothing is farther away than the beacons',
            'far_m = sum_up(e_m, quotient_up(square_up(e_m), float(off_m.min())))',
            'far_m = e_m',
        ),
    ),
    *_in(
        'poses',
        'inversion',
        (
            'test/poses/test_covers.py::test_a_ring',
            'test/poses/test_covers.py::test_no_truth_is_lost_among_liars',
        ),
        (
            'only the lower half of a box is examined further',
            'for half in range(halves):',
            'for half in range(1):',
        ),
        (
            'one wrong reading fewer than is tolerated rules a box out',
            'if spare[group] < 0:',
            'if spare[group] <= 0:',
        ),
    ),
    *_in(
        'poses',
        'readings',
        NEVER,
        (
            'the turn since a ray was measured does not widen it',
            'errors = angle_up(up(np.asarray(errors_rad, dtype=float) + half))',
            'errors = angle_up(np.asarray(errors_rad, dtype=float))',
        ),
    ),
]

MUTATIONS = (*INTERVAL, *CONTRACT, *SEARCHING, *FLEET, *PAIRS)
