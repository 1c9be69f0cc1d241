# Copyright 2026 dg_localization contributors
# SPDX-License-Identifier: Apache-2.0

"""Angles of which whole turns do not count."""

import numpy as np
from numpy.typing import NDArray


def without_turns(angles_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return angles less their whole turns, half a turn to either side at most."""
    return np.remainder(angles_rad + np.pi, 2.0 * np.pi) - np.pi
