# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Rounding on the way to the line (Section 4.2) and back; that nothing is lost hunts show."""

from fractions import Fraction

import numpy as np

from dg_localization.solver.contract.line import _narrow_to_distances, _set_roots
from dg_localization.solver.contract.projection import whole_lanes


def test_gaps_are_rounded_inward_on_the_way_to_the_line_and_on_the_way_back():
    """An end of a gap belongs to the box: its root, and its square, may not lie in the gap."""
    rng = np.random.default_rng(3)
    shape = (4, 2, whole_lanes(2))
    for ends in np.sort(rng.uniform(0.1, 9.9, (200, 2))):
        box, distance = np.zeros(shape), np.zeros(shape)
        box[:, [0, 1], [1, 0]] = np.array([0.0, 10.0, *ends])[:, None]
        _set_roots(box, distance, 2)
        low_m, high_m = map(Fraction, distance[2:, 0, 1].tolist())
        assert low_m**2 >= Fraction(float(ends[0])) and high_m**2 <= Fraction(float(ends[1]))
        box[2:] = 0.0
        assert _narrow_to_distances(box, distance, 2)
        low_m2, high_m2 = map(Fraction, box[2:, 0, 1].tolist())
        assert low_m2 >= low_m**2 and high_m2 <= high_m**2
